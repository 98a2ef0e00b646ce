"""What every estimator of the catalogue promises: blocks, checkpoints, bad input, convergence, turns."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest
from synthetic import SITE, coordinated_turn, error_deg, flight, still

import estimators
from estimators import Estimates, EstimationError, SampleError, Samples, SensorInfo, SettingError, Site, Status, create
from estimators.records import ESTIMATE, SAMPLE

MARG = ["marg-ekf", "marg-ckf", "marg-cdkf"]


def swinging(seconds=30.0, **options):
    """Still for five seconds, then slow swings about all axes."""
    t = np.arange(round(100 * seconds)) / 100.0
    grow = np.clip((t - 5.0) / 3.0, 0, 1)
    angles = (0.6 * np.sin(0.5 * t), 0.5 * np.sin(0.37 * t), 1.0 + 1.2 * np.sin(0.3 * t))
    roll, pitch, yaw = (grow * a + (1 - grow) * a[0] for a in angles)
    return flight(roll, pitch, yaw, np.zeros((len(t), 3)), gyro_bias=(0.005, -0.004, 0.003), **options)


def columns(estimates):
    return {name: getattr(estimates, name) for name in estimates.__slots__}


def assert_identical(a, b):
    for name, column in columns(a).items():
        np.testing.assert_array_equal(column, getattr(b, name), err_msg=name)


def in_blocks(estimator, samples, lengths):
    blocks, start = [], 0
    for length in lengths:
        blocks.append(estimator.process(samples[start : start + length]))
        start += length
    blocks.append(estimator.process(samples[start:]))
    return type(blocks[0]).concatenate(blocks)


@pytest.mark.parametrize("name", MARG)
def test_blocks_of_any_size_give_the_same_bits(name):
    samples, _ = swinging(20.0)
    settings = {"site": SITE, "align_s": 3.0}
    whole = create(name, **settings).process(samples)
    assert_identical(whole, in_blocks(create(name, **settings), samples, [1] * 450 + [7, 93, 0, 501]))


@pytest.mark.parametrize("aiding", ["airspeed", "gnss"])
def test_aided_blocks_give_the_same_bits(aiding):
    samples, _, _ = coordinated_turn(turn_s=5.0, ground_s=5.0)
    settings = {"site": SITE, "align_s": 2.0, "aiding": aiding}
    whole = create("marg-ekf", **settings).process(samples)
    assert_identical(whole, in_blocks(create("marg-ekf", **settings), samples, [1] * 300 + [700, 3, 411]))


@pytest.mark.parametrize("name", MARG)
@pytest.mark.parametrize("at", [150, 1100])
def test_a_restored_state_goes_on_identically(name, at):
    samples, _ = swinging(20.0)
    estimator = create(name, site=SITE, align_s=3.0)
    estimator.process(samples[:at])
    state = estimator.state()
    expected = estimator.process(samples[at:])
    other = create(name, site=SITE, align_s=3.0)
    other.restore(state)
    assert_identical(expected, other.process(samples[at:]))
    estimator.restore(state)  # a state can be used again, and the estimator it came from too
    assert_identical(expected, estimator.process(samples[at:]))
    estimator.reset()
    assert_identical(create(name, site=SITE, align_s=3.0).process(samples), estimator.process(samples))


def test_a_state_of_another_estimator_is_refused():
    with pytest.raises(EstimationError, match="marg-ckf"):
        create("marg-ekf").restore(create("marg-ckf").state())
    with pytest.raises(EstimationError, match="settings"):
        create("marg-ekf").restore(create("marg-ekf", accel_sigma=1.0).state())
    with pytest.raises(EstimationError, match="settings"):
        create("marg-ekf").restore(create("marg-ekf", site=SITE).state())
    with pytest.raises(EstimationError, match="version"):
        create("marg-ekf").restore({**create("marg-ekf").state(), "version": 99})


def _damaged(state):
    """(what is reported, a state that is not whole) of one that is."""
    kept = state["filter"]
    for name in ("x", "P", "P_restart", "u", "z", "used", "trust", "memory", "parameters"):
        yield name, {**state, "filter": {**kept, name: kept[name][:1] if kept[name].ndim else kept["x"]}}
        yield name, {**state, "filter": {key: value for key, value in kept.items() if key != name}}
    yield "x", {**state, "filter": {**kept, "x": kept["x"].astype(np.float32)}}
    yield "x", {**state, "filter": {**kept, "x": kept["x"].tolist()}}
    yield "stretch", {**state, "stretch": None}
    yield "parameters", {**state, "filter": 3.0}
    wrong = kept["parameters"].copy()
    wrong["states" if "states" in wrong.dtype.names else "aiding"] = 10**6  # would be a size of arrays
    yield "parameters", {**state, "filter": {**kept, "parameters": wrong}}


@pytest.mark.parametrize("name", ["marg-ekf", "ins21"])
def test_a_damaged_state_is_refused_before_any_kernel_sees_it(name):
    samples, _ = swinging(6.0)
    estimator = create(name, site=SITE, align_s=3.0)
    estimator.process(samples[:500])
    state = estimator.state()
    for what, damaged in _damaged(state):
        with pytest.raises(EstimationError, match=f"state's {what}"):
            estimator.restore(damaged)
    rest = samples[500:]
    expected = estimator.process(rest)  # it is as it was
    estimator.restore(state)
    assert_identical(expected, estimator.process(rest))


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("gyro_b", np.zeros((5, 3), complex)), ("accel_b", np.full((5, 3), "1.0")), ("t", np.array(list("01234"))),
        ("mag_b", np.ma.masked_array(np.zeros((5, 3)), mask=True)), ("airspeed", np.zeros(5, object)),
    ],
)  # fmt: skip
def test_columns_that_are_no_real_numbers_are_refused(column, value):
    columns = {"t": np.arange(5.0), "gyro_b": np.zeros((5, 3)), "accel_b": np.ones((5, 3))}
    with pytest.raises(SampleError, match=column):
        Samples.make(**{**columns, column: value})
    whole = Samples.make(**columns)
    with pytest.raises(SampleError, match=column):  # made by hand, without `make`
        create("marg-ekf").process(dataclasses.replace(whole, **{column: value}))


@pytest.mark.parametrize(
    "site",
    [
        Site((0,)), Site((0.0, 0.0, 0.0, 0.0)), Site((1e300, 0.0, 0.0)), Site((0.0, 7.0, 0.0)), Site((0.0, 0.0, 1e9)),
        Site((0.0, 0.0, 0.0), mag_n=(1e-5, 0.0)),
    ],
)  # fmt: skip
def test_an_impossible_site_is_refused(site):
    with pytest.raises(SettingError, match="site"):
        create("ins21", site=site)


@pytest.mark.parametrize(("name", "column"), [("marg-ekf", "accel_b"), ("marg-ekf", "mag_b"), ("ins21", "accel_b")])
def test_a_sensor_that_reads_zero_is_not_running(name, column):
    samples, _ = swinging(12.0)
    getattr(samples, column)[600:] = 0.0
    estimates = create(name, site=SITE, align_s=3.0).process(samples)
    assert estimates.status[550] == Status.RUNNING or name == "ins21"  # a navigator without GNSS is not, either
    assert (estimates.status[900:] == Status.COASTING).all()
    getattr(samples, column)[600:] = np.nan
    assert_identical(create(name, site=SITE, align_s=3.0).process(samples), estimates)


@pytest.mark.long
def test_prepare_reports_what_it_compiles(tmp_path):
    code = (
        "import estimators\n"
        "reported = []\n"
        "given = [('tilt-ekf', {}), ('somebody:Else', {}), ('sekf', {})]\n"
        "estimators.prepare(given, lambda *progress: reported.append(progress))\n"
        "print(reported)"
    )
    found = []
    for _ in range(2):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        found.append(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment))
        assert found[-1].returncode == 0, found[-1].stderr
    if not os.environ.get("NUMBA_DISABLE_JIT"):
        assert found[0].stdout.strip() == "[('tilt-ekf', 1, 2), ('sekf', 2, 2)]"
    assert found[1].stdout.strip() == "[]"


@pytest.mark.parametrize("name", MARG)
def test_it_converges_standing_and_swinging(name):
    samples, truth = swinging(60.0)
    estimates = create(name, site=SITE, align_s=3.0).process(samples)
    total, tilt, heading = error_deg(estimates.q_nb[2000:], truth[2000:])
    assert (estimates.status[400:] == Status.RUNNING).all()
    assert total.max() < 1.5
    assert np.sqrt(np.mean(tilt**2)) < 0.15
    assert np.sqrt(np.mean(heading**2)) < 0.5
    np.testing.assert_allclose(estimates.gyro_bias[-1], [0.005, -0.004, 0.003], atol=1e-3)
    np.testing.assert_allclose(estimates.down_b, _down(estimates.q_nb), atol=1e-12, equal_nan=True)


def _down(q):
    a, b, c, d = q.T
    return np.stack([2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d], -1)


def test_its_covariance_and_innovations_are_honest_standing_still():
    """Truth noise equals R: the innovations are white with their variances, the attitude error fits its covariance."""
    samples, truth = still(300.0, mag_every=1)
    estimates = create("marg-ckf", site=SITE, align_s=20.0).process(samples)
    rows = slice(6000, None)
    normalised = estimates.innovation[rows, :9] ** 2 / estimates.innovation_var[rows, :9]
    assert abs(normalised[:, :6].mean() - 1.0) < 0.05
    assert np.isnan(estimates.innovation[rows, 9:]).all()
    decorrelated = np.corrcoef((estimates.innovation / np.sqrt(estimates.innovation_var))[rows, :6].T) - np.eye(6)
    assert np.abs(decorrelated).max() < 0.05
    total = np.radians(error_deg(estimates.q_nb[-1:], truth[-1:])[0])
    sigma = np.sqrt(np.trace(estimates.att_cov[-1]))
    assert total < 4 * sigma
    assert np.allclose(estimates.att_cov[-1], estimates.att_cov[-1].T)


@pytest.mark.parametrize("name", MARG)
def test_a_sustained_turn_fools_it_unless_it_knows_the_airspeed(name):
    samples, truth, turning = coordinated_turn()
    tilt = {}
    for aiding in ("none", "airspeed", "gnss"):
        estimates = create(name, site=SITE, align_s=10.0, aiding=aiding).process(samples)
        tilt[aiding] = np.sqrt(np.mean(error_deg(estimates.q_nb[turning], truth[turning])[1] ** 2))
    assert tilt["none"] > 15.0
    assert tilt["airspeed"] < 0.5
    assert tilt["gnss"] < 2.0


@pytest.mark.long
def test_without_jit_the_numbers_are_the_same(tmp_path):
    code = (
        "import sys; sys.path[:0] = sys.argv[2:]\n"
        "import numpy as np, estimators, synthetic\n"
        "samples, q = synthetic.still(3.0)\n"
        "names = 'marg-ekf', 'marg-ckf', 'marg-cdkf'\n"
        "made = [estimators.create(name, site=synthetic.SITE, align_s=1.0) for name in names]\n"
        "out = [m.process(samples[:160]) for m in made]\n"
        "np.save(sys.argv[1], [np.hstack([o.q_nb, o.gyro_bias, o.innovation, o.gyro_bias_sigma]) for o in out])\n"
    )
    here = os.path.dirname(__file__)  # noqa: PTH120
    root = os.path.dirname(os.path.dirname(estimators.__file__))  # noqa: PTH120
    results = []
    for disabled in "01":
        path = tmp_path / f"{disabled}.npy"
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disabled}
        subprocess.run([sys.executable, "-c", code, str(path), here, root], env=environment, check=True)
        results.append(np.load(path))
    np.testing.assert_allclose(results[0], results[1], rtol=1e-9, atol=1e-12, equal_nan=True)


# Bad input


def test_missing_measurements_coast_and_never_make_nan():
    samples, truth = swinging(30.0)
    samples.accel_b[1200:1300] = np.nan
    samples.gyro_b[1400:1450] = np.nan
    samples.mag_b[1600:2000] = np.nan
    samples.gyro_b[2200] = np.inf
    for name in MARG:
        estimates = create(name, site=SITE, align_s=3.0).process(samples)
        running = estimates.status[400:]
        assert np.isfinite(estimates.q_nb[400:]).all()
        assert (running != Status.DIVERGED).all()
        assert (estimates.status[1200:1300] == Status.COASTING).all()
        assert (estimates.status[1400:1450] == Status.COASTING).all()
        assert estimates.status[1620] == Status.RUNNING  # a moment without magnetometer is normal
        assert (estimates.status[1710:2000] == Status.COASTING).all()
        assert np.isnan(estimates.innovation[1250, :3]).all()
        assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 2.0


def test_repeated_and_backward_stamps_are_left_out():
    samples, truth = swinging(20.0)
    samples.t[1000] = samples.t[999]
    samples.t[1100] = samples.t[1099] - 0.3
    estimates = create("marg-ckf", site=SITE, align_s=3.0).process(samples)
    assert estimates.status[1000] == estimates.status[1100] == Status.COASTING
    np.testing.assert_array_equal(estimates.q_nb[1100], estimates.q_nb[1099])
    assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 1.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -5.0])
@pytest.mark.parametrize("row", [100, 900])
def test_impossible_stamps_are_an_error_and_change_nothing(bad, row):
    samples, _ = swinging(12.0)
    estimator, other = (create("marg-ekf", site=SITE, align_s=3.0) for _ in range(2))
    estimator.process(samples[: row - 50])
    other.process(samples[: row - 50])
    broken = samples[row - 50 : row + 50]
    broken = Samples(broken.t.copy(), *(getattr(broken, name) for name in Samples.__slots__[1:]))
    broken.t[50] = bad
    with pytest.raises(SampleError, match="row 50"):
        estimator.process(broken)
    assert_identical(estimator.process(samples[row - 50 :]), other.process(samples[row - 50 :]))


def test_a_gap_is_bridged():
    samples, truth = still(40.0)
    keep = np.r_[0:1000, 1400:4000]
    gappy = Samples(*(getattr(samples, name)[keep] for name in Samples.__slots__))
    estimates = create("marg-ckf", site=SITE, align_s=3.0).process(gappy)
    assert estimates.status[1000] == Status.COASTING
    assert estimates.att_cov[1000].trace() > 2 * estimates.att_cov[999].trace()
    assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 1.0


def test_after_a_long_gap_it_aligns_anew():
    """No prediction stands for twenty seconds of unknown turning; any block length gives the same."""
    samples, truth = swinging(60.0)
    keep = np.r_[0:1500, 3500:6000]
    gappy = Samples(*(getattr(samples, name)[keep] for name in Samples.__slots__))
    estimates = create("marg-ckf", site=SITE, align_s=3.0).process(gappy)
    assert estimates.status[1499] == Status.RUNNING
    assert (estimates.status[1500:1550] == Status.ALIGNING).all()
    assert (estimates.status[2300:] != Status.ALIGNING).all()
    assert error_deg(estimates.q_nb[-1:], truth[keep][-1:])[0] < 3.0
    assert_identical(estimates, in_blocks(create("marg-ckf", site=SITE, align_s=3.0), gappy, [1500, 700, 1]))


@pytest.mark.parametrize("seconds", [1.0, 2.0, 4.0])
def test_a_short_standing_counts(seconds):
    """Motion ends the alignment at once, with the attitude it has turned to, and a sigma that covers its error."""
    samples, truth = swinging(25.0)
    first = round(100 * (5.0 - seconds))
    late = Samples(*(getattr(samples, name)[first:] for name in Samples.__slots__))
    estimates = create("marg-ckf", site=SITE, align_s=20.0).process(late)
    begun = int(np.flatnonzero(estimates.status != Status.ALIGNING)[0])
    assert begun <= 100 * seconds + 220
    total = error_deg(estimates.q_nb[begun : begun + 1], truth[first + begun][None])[0]
    assert total < np.degrees(3 * np.sqrt(np.trace(estimates.att_cov[begun])))
    assert total < 4.0
    assert np.sqrt(estimates.att_cov[begun, 0, 0]) < np.radians(3.0)


@pytest.mark.parametrize("bias_deg", [(0.0, 0.0, 5.0), (0.0, 14.0, 0.0), (-6.0, 5.0, 8.0), (0.0, 1.9, 0.0)])
def test_a_great_gyro_bias_is_learnt_standing(bias_deg):
    """The field stays where it is, so that nothing turns."""
    samples, truth = swinging(30.0)
    bias = np.radians(bias_deg)
    off = dataclasses.replace(samples, gyro_b=samples.gyro_b + bias)
    estimates = create("marg-ckf", site=SITE, align_s=3.0).process(off)
    begun = int(np.flatnonzero(estimates.status != Status.ALIGNING)[0])
    assert begun == 400  # the first second has none before it to compare with
    assert estimates.gyro_bias[begun] == pytest.approx(np.add(bias, (0.005, -0.004, 0.003)), abs=2e-3)
    assert error_deg(estimates.q_nb[begun:], truth[begun:])[0].max() < 8.0


@pytest.mark.parametrize("rate_deg", [1.6, 2.0, 5.0, 14.0])
def test_a_steady_turn_is_no_gyro_bias(rate_deg):
    """On a turntable the field turns along."""
    t = np.arange(1500) / 100.0
    samples, _ = flight(0.05 + 0 * t, 0.1 + 0 * t, np.radians(rate_deg) * t, np.zeros((len(t), 3)))
    estimates = create("marg-ckf", site=SITE, align_s=3.0).process(samples)
    begun = int(np.flatnonzero(estimates.status != Status.ALIGNING)[0])
    assert begun == 500
    assert np.abs(estimates.gyro_bias[begun]).max() < np.radians(0.5)


def test_wrong_shapes_are_named():
    n = 5
    with pytest.raises(SampleError, match="gyro_b"):
        Samples.make(np.zeros(n), np.zeros((n, 2)), np.zeros((n, 3)))
    good, _ = still(1.0)
    bad = Samples(good.t, good.gyro_b[:, :2], *(getattr(good, name) for name in Samples.__slots__[2:]))
    with pytest.raises(SampleError, match="gyro_b"):
        create("marg-ekf").process(bad)


def test_float32_and_strided_columns_are_taken():
    samples, _ = swinging(8.0)
    single = Samples(samples.t, *(
        getattr(samples, name).astype(np.float32) if name.endswith("_b") else getattr(samples, name)
        for name in Samples.__slots__[1:]
    ))  # fmt: skip
    estimates = create("marg-ekf", site=SITE, align_s=3.0).process(single[::2])
    assert np.isfinite(estimates.q_nb[200:]).all()
    assert len(create("marg-ekf").process(samples[:0])) == 0


@pytest.mark.parametrize("name", MARG)
def test_noiseless_sensors_do_not_break_it(name):
    """A ground phase without scatter gives zero variances: floors keep the filter alive."""
    samples, truth = still(20.0, noise=0.0, mag_every=1)
    estimates = create(name, site=SITE, align_s=3.0).process(samples)
    assert (estimates.status[400:] == Status.RUNNING).all()
    assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 0.01


@pytest.mark.parametrize("name", MARG)
def test_impossible_values_are_left_out(name):
    samples, truth = swinging(40.0)
    samples.accel_b[1500:1503] = 1e200
    samples.mag_b[1600:1602] = -1e250
    samples.gyro_b[1650:1660] = 1e6
    estimates = create(name, site=SITE, align_s=3.0).process(samples)
    assert np.isfinite(estimates.q_nb[400:]).all()
    assert (estimates.status[-500:] == Status.RUNNING).all()
    assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 3.0


# Alignment


def test_alignment_waits_for_stillness_and_a_shove_ends_it():
    """Of four still seconds before it the sigma is larger than of five without one."""
    samples, truth = still(30.0)
    begun = {}
    for shoved in (False, True):
        if shoved:
            samples.accel_b[400:440] += 2.0 * np.sin(np.arange(40))[:, None]
        estimates = create("marg-ekf", site=SITE, align_s=5.0).process(samples)
        running = np.flatnonzero(estimates.status == Status.RUNNING)
        assert 500 <= running[0] <= 600
        assert np.isnan(estimates.q_nb[: running[0]]).all()
        assert (estimates.status[: running[0]] == Status.ALIGNING).all()
        begun[shoved] = np.trace(estimates.att_cov[running[0]])
        assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 1.5
    assert begun[True] > begun[False]


def test_a_start_in_the_air_aligns_coarsely():
    t = np.arange(3000) / 100.0
    samples, _ = flight(0.3 * np.sin(t), 0.2 * np.sin(1.3 * t), 0.5 * t, np.zeros((3000, 3)))
    estimates = create("marg-ekf", site=SITE).process(samples)
    running = np.flatnonzero(estimates.status == Status.RUNNING)
    assert 500 <= running[0] <= 620
    assert np.sqrt(estimates.att_cov[running[0], 2, 2]) > np.radians(1.0)


def test_without_magnetometer_the_heading_is_unknown_but_the_tilt_is_not():
    samples, truth = still(20.0)
    samples.mag_b[:] = np.nan
    estimates = create("marg-ekf", site=SITE, align_s=3.0).process(samples)
    assert (estimates.status[400:] == Status.COASTING)[100:].all()
    assert error_deg(estimates.q_nb[-1:], truth[-1:])[1] < 0.5
    assert np.isnan(estimates.innovation[:, 3:6]).all()


def test_the_paper_starts_without_alignment():
    samples, _ = still(3.0)
    estimates = create("marg-ckf", site=SITE, initialisation="paper", noise="practical").process(samples)
    assert (estimates.status == Status.RUNNING).all()


# Catalogue


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "marg-ekv"}, "did you mean 'marg-ekf'"),
        ({"name": "marg-ekf", "aidin": "none"}, "did you mean 'aiding'"),
        ({"name": "marg-ekf", "aiding": "airsped"}, "did you mean 'airspeed'"),
        ({"name": "marg-ekf", "accel_sigma": 0.0}, "accel_sigma"),
        ({"name": "marg-ekf", "accel_sigma": "big"}, "accel_sigma"),
        ({"name": "marg-ekf", "align_s": float("nan")}, "align_s"),
        ({"name": "marg-ekf", "align_s": True}, "align_s"),
        ({"name": "marg-ekf", "site": Site((0, 0, 0), gravity=-1.0)}, "gravity"),
        ({"name": "marg-ekf", "site": Site((0, 0, 0), mag_n=(0.0, 0.0, 4e-5))}, "vertical"),
        ({"name": "marg-ekf", "sensors": SensorInfo(gyro_noise=float("nan"))}, "gyro_noise"),
        ({"name": "marg-ekf", "sensors": SensorInfo(rate=0.0)}, "rate"),
        ({"name": "marg-ekf", "sensors": SensorInfo(mag_bias=-1.0)}, "mag_bias"),
        ({"name": "no.such.module:Class"}, "cannot be loaded"),
        ({"name": "estimators.types:Nothing"}, "cannot be loaded"),
        ({"name": "estimators.types:Status"}, "estimators.types:Status"),
    ],
)
def test_wrong_names_and_settings_are_one_clear_line(arguments, words):
    with pytest.raises(SettingError, match=words) as caught:
        create(**arguments)
    assert "\n" not in str(caught.value)


class Constant:
    """A user's own estimator."""

    def __init__(self, site, sensors, answer=1.0):
        self.answer = answer

    def process(self, samples):
        return self.answer


def test_a_users_class_joins_by_name():
    assert create("test_behaviour:Constant", answer=3.0).process(None) == 3.0
    with pytest.raises(SettingError, match="anser"):
        create("test_behaviour:Constant", anser=3.0)


def test_the_catalogue_describes_itself():
    assert {method.name for method in estimators.describe()} <= set(estimators.names())
    for method in estimators.describe():
        assert method.text
        assert method.source
        for name, setting in method.settings.items():
            assert setting.text
            assert setting.check(name, setting.default) == setting.default


def test_importing_the_package_is_cheap():
    code = "import sys, estimators; sys.exit(any(m in sys.modules for m in ('numba', 'numpy', 'scipy')))"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=os.path.dirname(os.path.dirname(estimators.__file__)))  # noqa: PTH120


@pytest.mark.parametrize(("record", "block"), [(SAMPLE, Samples), (ESTIMATE, Estimates)])
def test_records_have_the_columns_of_their_blocks(record, block):
    assert set(record.names) - {"reserved"} == set(block.__match_args__)
    for field in dataclasses.fields(block):
        assert record[field.name].shape == field.metadata["shape"], field.name
        assert record[field.name].base == np.dtype(field.metadata["dtype"]), field.name


@pytest.mark.parametrize("name", MARG)
def test_a_lost_filter_says_so_and_starts_again(name):
    """A state that is no longer finite, and a covariance that is no longer positive."""
    samples, truth = swinging(60.0)
    for spoil in ("x", "P"):
        estimator = create(name, site=SITE, align_s=3.0)
        estimator.process(samples[:1500])
        state = estimator.state()
        if spoil == "x":
            state["filter"]["z"][:] = state["filter"]["P"][:] = np.nan
        else:
            state["filter"]["P"][:] = -np.eye(10)
        estimator.restore(state)
        estimates = estimator.process(samples[1500:])
        assert estimates.status[0] == Status.DIVERGED
        assert np.isfinite(estimates.q_nb).all()
        assert (estimates.status[1:] == Status.RUNNING).all()
        assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 1.5
