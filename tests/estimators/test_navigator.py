"""The navigator with calibration states, and its smoother."""

import dataclasses

import numba
import numpy as np
import pytest
from synthetic import SITE, coordinated_turn, error_deg, matrix_bn

from estimators import Estimates, SampleError, Samples, SensorInfo, Status, create, jit, native
from estimators.native import argument
from estimators.navigator import covariance
from estimators.navigator.layout import (
    ACCEL_MATRIX,
    COUPLED,
    GYRO_MATRIX,
    LATE,
    MAG_MATRIX,
    MOVING,
    PHI,
    SMOOTHED,
    N,
    Work,
    tape,
)
from estimators.navigator.smoother import Behind, Smoothed, backwards, smooth

SENSORS = SensorInfo(
    gyro_noise=3.7e-3 / 50**0.5, accel_noise=0.02 / 50**0.5, gyro_instability=1e-5, gyro_drift=1e-5, accel_drift=1e-3,
    accel_instability=1e-4, gyro_scale_factor=0.01, gyro_misalignment=5e-3, accel_scale_factor=5e-3,
    accel_misalignment=5e-3, mag_scale_factor=5e-3, mag_misalignment=5e-3, soft_iron=5e-3, mag_bias=5e-7,
)  # fmt: skip


def turning(seed=3, late=0.0, turn_s=60.0):
    """A turn measured by sensors that are off by what `SENSORS` says; truth, and rows of the turn."""
    samples, q, turn = coordinated_turn(seed=seed, turn_s=turn_s, gyro_bias=(0.002, -0.003, 0.001))
    rng = np.random.default_rng(seed)

    def off(scale, beside):
        return np.eye(3) + np.where(np.eye(3) > 0, scale, beside) * rng.standard_normal((3, 3))

    s = SENSORS
    gyro, accel = off(s.gyro_scale_factor, s.gyro_misalignment), off(s.accel_scale_factor, s.accel_misalignment)
    mag = off(np.hypot(s.mag_scale_factor, s.soft_iron), np.hypot(s.mag_misalignment, s.soft_iron / 2**0.5))
    n = len(samples)
    columns = {f.name: getattr(samples, f.name) for f in dataclasses.fields(Samples)}
    columns |= {"gyro_b": samples.gyro_b @ gyro.T, "accel_b": samples.accel_b @ accel.T + 0.03 * rng.standard_normal(3)}
    columns["mag_b"] = samples.mag_b @ mag.T + s.mag_bias * rng.standard_normal(3)
    fix = np.cumsum(samples.gnss_new) - 1
    columns["vel_n"] = samples.vel_n + (0.1 * rng.standard_normal((fix[-1] + 1, 3)))[fix]
    back = round(100 * late)
    for name in ("vel_n", "gnss_t", "gnss_new"):
        moved = np.roll(columns[name], back, axis=0)
        moved[:back] = False if name == "gnss_new" else np.nan
        columns[name] = moved
    return Samples(**columns), q, turn & (np.arange(n) > 0)


def navigator(**settings):
    return create("ins-cal", site=SITE, sensors=SENSORS, **settings)


def tilt(estimates, q, rows):
    return float(np.sqrt(np.mean(error_deg(estimates.q_nb, q)[1][rows] ** 2)))


def test_blocks_of_any_size_and_a_restored_state_give_the_same_numbers():
    samples = turning()[0]
    whole = navigator().process(samples)
    other = navigator()
    parts, k = [], 0
    for size in (1, 2500, 1, 1, 7, 333, 2, len(samples)):
        parts.append(other.process(samples[k : k + size]))
        k += size
        kept = other.state()
        other = navigator()
        other.restore(kept)
    joined = Estimates.concatenate(parts)
    for name in Estimates.__match_args__:
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name), err_msg=name)


def test_sensors_that_are_off_are_calibrated_in_a_turn():
    """Five draws: nearer than without these states, and by as much as the covariance says."""
    mine, other, nees = [], [], []
    for seed in range(5):
        samples, q, rows = turning(seed)
        estimates = navigator().process(samples)
        mine.append(tilt(estimates, q, rows))
        other.append(tilt(create("ins21", site=SITE, sensors=SENSORS).process(samples), q, rows))
        R = matrix_bn(estimates.q_nb[rows]) @ np.swapaxes(matrix_bn(q[rows]), 1, 2)
        error = 0.5 * np.stack([R[:, 1, 2] - R[:, 2, 1], R[:, 2, 0] - R[:, 0, 2], R[:, 0, 1] - R[:, 1, 0]], -1)
        nees.append(np.einsum("ki,kij,kj->k", error, np.linalg.inv(estimates.att_cov[rows]), error).mean() / 3)
        assert (estimates.status[rows] == Status.RUNNING).all()
    assert np.mean(np.square(mine)) < 0.75 * np.mean(np.square(other))
    assert 0.2 < np.mean(nees) < 2.0


def test_a_rotation_of_all_sensors_is_not_taken_for_seen():
    """No reading shows it: the information along it stays that of the data sheet (and the wide one of the start)."""
    estimator = navigator()
    estimator.process(turning(turn_s=120.0)[0])
    carry = estimator._carry
    C = matrix_bn(carry.nominal.q)
    for axis in range(3):
        d, unit = np.zeros(N), np.eye(3)[axis]
        d[PHI : PHI + 3] = -C.T @ unit
        cross = np.cross(np.eye(3), unit)  # rows e_i x unit: [unit x]
        prior = 0.0
        for at, sigma in (
            (GYRO_MATRIX, SENSORS.gyro_misalignment),
            (ACCEL_MATRIX, SENSORS.accel_misalignment),
            (MAG_MATRIX, np.hypot(SENSORS.mag_misalignment, SENSORS.soft_iron / 2**0.5)),
        ):
            d[at : at + 9] = -cross.T.ravel()
            prior += 2.0 / sigma**2
        seen = min(d @ np.linalg.solve(carry.P, d), flipped(d) @ np.linalg.solve(carry.P, flipped(d)))
        assert seen < 1.15 * prior + 1.0 / np.radians(0.5) ** 2


def flipped(d):
    """The same rotation of the sensors with the other sign of the attitude's."""
    d = d.copy()
    d[PHI : PHI + 3] *= -1.0
    return d


def test_a_late_fix_says_the_same_as_one_in_time():
    samples, q, rows = turning()
    late = turning(late=0.1)[0]
    assert tilt(navigator().process(late), q, rows) < 1.2 * tilt(navigator().process(samples), q, rows) + 0.03


def test_a_delay_that_nobody_declared_is_learnt():
    samples, q, rows = turning(late=0.3)
    columns = {f.name: getattr(samples, f.name) for f in dataclasses.fields(Samples)}
    columns["gnss_t"] = samples.gnss_t + 0.3  # stamped on arrival
    estimator = navigator(late_sigma=0.2)
    estimates = estimator.process(Samples(**columns))
    assert abs(estimator._carry.nominal.c[LATE] - 0.3) < 0.02
    assert tilt(estimates, q, rows) < 1.2 * tilt(navigator().process(samples), q, rows) + 0.1


def test_a_wrong_ambiguity_of_the_baseline_is_left_out():
    """Eleven degrees off for eight seconds, as its own sigma never says: believed, it cost 2.5 deg of heading."""
    samples, q, _rows = turning()
    yaw = np.arctan2(2 * (q[:, 0] * q[:, 3] + q[:, 1] * q[:, 2]), 1 - 2 * (q[:, 2] ** 2 + q[:, 3] ** 2))
    wrong = (samples.t > 60.0) & (samples.t < 68.0)
    columns = {f.name: getattr(samples, f.name) for f in dataclasses.fields(Samples)}
    columns |= {"heading_new": samples.gnss_new, "heading_t": samples.t, "heading_sigma": np.full(len(q), 0.0035)}
    headings = []
    for off in (0.0, np.radians(11.0)):
        columns["heading"] = yaw + np.where(wrong, off, 0.0)
        estimates = navigator().process(Samples(**columns))
        headings.append(error_deg(estimates.q_nb, q)[2][wrong])
    assert np.abs(headings[1] - headings[0]).max() < 0.3


def test_without_field_or_fixes_it_coasts_and_says_so():
    samples, q, rows = turning()
    columns = {f.name: getattr(samples, f.name).copy() for f in dataclasses.fields(Samples)}
    gone = samples.t > 60.0
    columns["mag_b"][gone] = 0.0  # a dead magnetometer
    dead = navigator().process(Samples(**columns))
    assert (dead.status[samples.t > 63.0] == Status.COASTING).all()
    assert tilt(dead, q, rows) < 1.0
    columns["gnss_new"] = samples.gnss_new & ~gone
    blind = navigator().process(Samples(**columns))
    assert np.isfinite(blind.q_nb[rows]).all()
    assert tilt(blind, q, rows) < 5.0


def test_a_column_of_a_wrong_shape_is_an_error():
    samples = turning()[0]
    with pytest.raises(SampleError, match="vel_n"):
        navigator().process(dataclasses.replace(samples, vel_n=samples.vel_n[:-1]))


def _batch(model, c, P, batch, work):
    """A batch of the filter: `batch` holds its motion, `work` three numbers."""
    covariance.move(model, c, P, batch, work)
    covariance.note_motion(work, batch)
    for i in range(N):
        work.dx[i] = 0.0
    for row in range(3):
        covariance.absorb(P, work, row)
    covariance.symmetric(P)
    covariance.note_end(work, P, False, 0)


def _move(model, c, P, batch, work):
    covariance.move(model, c, P, batch, work)


def compiled(kernel):
    """A function of kernels that can be called from here."""
    return numba.njit(kernel)


@pytest.mark.long
def test_smoother_of_a_linear_model_is_that_of_rauch_tung_and_striebel():
    """Random transitions and measurements through the filter's own kernels; dense matrices and inverses beside them."""
    rng = np.random.default_rng(5)
    batches, noted = 7, tape(7)
    estimator = navigator()
    estimator._bind()
    estimator._start(*estimator._own)
    work, model, batch = Work.make(noted[0]), estimator._parts["parameters"], estimator._carry.batch
    work.keep[:] = 1.0
    run, move = compiled(_batch), compiled(_move)
    root = rng.standard_normal((N, N)) * 0.1
    P = root @ root.T + np.diag(rng.uniform(0.1, 1.0, N))
    prior, posterior, moves, corrections = [], [], [], []
    for _ in range(batches):
        batch.F[:] = np.eye(MOVING, COUPLED) + 0.1 * rng.standard_normal((MOVING, COUPLED))
        batch.gyro_variance, batch.force_variance, batch.seconds = 0.01, 0.02, 3.0
        for row in range(3):
            work.terms[row] = 4
            work.at[row, :4] = rng.choice(N, 4, replace=False)
            work.by[row, :4] = rng.standard_normal(4)
            work.residual[row], work.variance[row] = rng.standard_normal(), 0.3
        before = P.copy()
        given = [argument(one) for one in (model, batch, work)]
        move(given[0], np.zeros(N), before, *given[1:])
        prior.append(before)
        run(given[0], np.zeros(N), P, *given[1:])
        Phi = np.diag(work.keep)
        Phi[:MOVING] = 0.0
        Phi[:MOVING, :COUPLED] = batch.F
        moves.append(Phi)
        posterior.append(P.copy())
        corrections.append(work.dx.copy())
    out = Smoothed(
        noted[1]["row"], *(np.zeros((batches, *shape)) for shape in ((SMOOTHED,), (SMOOTHED,), (3, 3, 3), (6,)))
    )
    backwards(argument(noted[0]), Behind(np.zeros(N), np.zeros((N, N))), out, np.zeros((N, N)))
    delta, smoothed = np.zeros(N), posterior[-1]
    for k in range(batches - 1, -1, -1):
        if k < batches - 1:
            G = np.linalg.solve(prior[k + 1], moves[k + 1] @ posterior[k]).T
            delta = G @ (delta + corrections[k + 1])
            smoothed = posterior[k] + G @ (smoothed - prior[k + 1]) @ G.T
        np.testing.assert_allclose(out.delta[k], delta[:SMOOTHED], rtol=1e-9, atol=1e-9 * np.abs(delta).max())
        for kind in range(3):
            of = slice(3 * kind, 3 * kind + 3)
            np.testing.assert_allclose(out.cov[k, kind], smoothed[of, of], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(out.bias_var[k, 3:], np.diag(smoothed)[18:21], rtol=1e-9)


def test_smoothed_is_nearer_and_surer_than_filtered():
    samples, q, rows = turning()
    estimator = navigator()
    filtered = estimator.process(samples)
    smoothed = smooth(estimator, samples)
    assert tilt(smoothed, q, rows) < tilt(filtered, q, rows)
    known = np.isfinite(filtered.q_nb[:, 0])
    np.testing.assert_array_equal(np.isfinite(smoothed.q_nb[:, 0]), known)
    surer = np.trace(smoothed.att_cov, axis1=1, axis2=2) <= np.trace(filtered.att_cov, axis1=1, axis2=2)
    assert surer[known].mean() > 0.99  # between the ends of batches it is that of the next end
    np.testing.assert_allclose(smoothed.q_nb[-1], filtered.q_nb[-1], atol=1e-12)
    np.testing.assert_array_equal(smoothed.status, filtered.status)
    again = navigator().process(samples)  # the estimator is left as a filter at the end
    np.testing.assert_array_equal(estimator._carry.P, navigator_state(samples).P)
    assert np.array_equal(again.q_nb, filtered.q_nb, equal_nan=True)


def navigator_state(samples):
    estimator = navigator()
    estimator.process(samples)
    return estimator._carry


def test_after_a_long_gap_it_aligns_anew_filtered_and_smoothed():
    """As the other estimators do: what turned meanwhile is not known; the smoother bridges no gap either."""
    samples, q, _ = turning(turn_s=100.0)
    n = len(samples)
    keep = np.r_[0:5000, 9000 : min(n, 12500)]  # forty seconds are missing
    cut = Samples(**{f.name: getattr(samples, f.name)[keep] for f in dataclasses.fields(Samples)})
    e = navigator(align_s=5.0).process(cut)
    known = np.isfinite(e.q_nb).all(axis=1)
    assert not known[5000:5400].any()
    assert known[5600:].all()
    assert (e.status[5000:5400] == Status.ALIGNING).all()
    assert tilt(e, q[keep], np.arange(len(keep)) > 7000) < 2.0
    other, parts = navigator(align_s=5.0), []
    for first in range(0, len(cut), 777):  # blocks end where they may
        parts.append(other.process(cut[first : first + 777]))
    np.testing.assert_array_equal(Estimates.concatenate(parts).q_nb, e.q_nb)
    smoothed = smooth(navigator(align_s=5.0), cut)
    alone = smooth(navigator(align_s=5.0), cut[:5000])
    np.testing.assert_array_equal(smoothed.q_nb[:5000], alone.q_nb)
    assert tilt(smoothed, q[keep], np.arange(len(keep)) > 5600) < tilt(e, q[keep], np.arange(len(keep)) > 5600)


@pytest.mark.skipif(not jit.JIT, reason="compiles nothing")
def test_prepare_compiles_what_process_needs_and_announces_it(monkeypatch, tmp_path):
    called = []
    monkeypatch.setattr(native, "listeners", [lambda: called.append(None)])
    estimator = create("ins-cal", site=SITE, sensors=SENSORS, align_s=3.0)
    estimator.prepare()
    announced = len(called)
    samples, _, _ = turning(turn_s=1.0)
    fresh = create("ins-cal", site=SITE, sensors=SENSORS, align_s=3.0).process(samples)
    np.testing.assert_array_equal(estimator.process(samples).q_nb, fresh.q_nb)
    assert len(called) == announced, "nothing is left to compile"
    with monkeypatch.context() as patch:
        patch.setattr(native, "FOLDER", tmp_path)
        patch.setattr(native, "_LOADED", {})
        with native.planning() as listed:
            create("ins-cal").assemble()
    assert {path.name.split(".")[1] for path in listed} == {"process", "forget", "begin"}
