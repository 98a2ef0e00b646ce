"""Attitude errors against rotations built by scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from ahrs_sim import attitude
from ahrs_sim.evaluation import accuracy, metrics
from ahrs_sim.review.compare import table

ANGLE = st.floats(-3.1, 3.1)
PITCH = st.floats(-1.4, 1.4)


def quaternion(roll: float, pitch: float, heading: float) -> np.ndarray:
    return Rotation.from_euler("ZYX", [heading, pitch, roll]).as_quat(scalar_first=True)[None]


@given(ANGLE, PITCH, ANGLE)
def test_euler_inverts_scipy(roll: float, pitch: float, heading: float) -> None:
    assert attitude.euler(quaternion(roll, pitch, heading))[0] == pytest.approx([roll, pitch, heading], abs=1e-7)


@given(ANGLE, PITCH, ANGLE, st.tuples(*[st.floats(-1, 1)] * 3))
def test_total_and_tilt_match_scipy(roll: float, pitch: float, heading: float, vector: tuple[float, ...]) -> None:
    truth = Rotation.from_euler("ZYX", [heading, pitch, roll])
    wrong = truth * Rotation.from_rotvec(vector)
    q, r = wrong.as_quat(scalar_first=True)[None], truth.as_quat(scalar_first=True)[None]
    error = metrics.attitude_errors(q, attitude.down(q), r)[0]
    assert error[4] == pytest.approx(np.linalg.norm(vector), abs=1e-7)
    downs = truth.inv().apply([0, 0, 1]), wrong.inv().apply([0, 0, 1])
    assert error[3] == pytest.approx(np.arctan2(np.linalg.norm(np.cross(*downs)), np.dot(*downs)), abs=1e-7)


def test_heading_error_wraps() -> None:
    q, r = quaternion(0, 0, np.radians(179.5)), quaternion(0, 0, np.radians(-179.0))
    assert np.degrees(metrics.attitude_errors(q, attitude.down(q), r)[0, 2]) == pytest.approx(-1.5)


def test_total_is_exact_for_tiny_rotations() -> None:
    truth = Rotation.from_euler("ZYX", [2.0, 0.3, -1.0])
    wrong = truth * Rotation.from_rotvec([0, 3e-9, 0])
    q, r = wrong.as_quat(scalar_first=True)[None], truth.as_quat(scalar_first=True)[None]
    assert metrics.attitude_errors(q, attitude.down(q), r)[0, 4] == pytest.approx(3e-9, rel=1e-5)


def test_without_heading_tilt_still_counts() -> None:
    q = quaternion(0.2, 0.1, 0.0)
    nothing = np.full((1, 4), np.nan)
    error = metrics.attitude_errors(nothing, attitude.down(q), quaternion(0.25, 0.1, 1.0))[0]
    assert error[0] == pytest.approx(-0.05)
    assert np.isnan(error[[2, 4]]).all()
    values = metrics.statistics(error[None])
    assert values["roll_rmse_deg"] == pytest.approx(np.degrees(0.05))
    assert np.isnan(values["heading_rmse_deg"])


def test_interpolation_follows_slerp_and_refuses_to_extrapolate() -> None:
    t = np.arange(0, 1.001, 0.01)
    spin = Rotation.from_rotvec(np.outer(t, [0.3, -2.0, 0.5]))
    at = np.linspace(0.001, 0.999, 77)
    q = attitude.interpolate(t, spin.as_quat(scalar_first=True), at)
    expected = Slerp(t, spin)(at).as_quat(scalar_first=True)
    assert np.abs(np.sum(q * expected, axis=1)).min() > 1 - 1e-13
    assert np.isnan(attitude.interpolate(t, spin.as_quat(scalar_first=True), np.array([-0.1, 1.1]))).all()


def test_a_gap_of_the_reference_is_not_bridged() -> None:
    """Jitter and a few lost samples are, and the samples at both ends of a gap count."""
    t = np.r_[np.arange(0, 1, 0.01), 1.03, np.arange(1.07, 1.995, 0.01), np.arange(2.5, 3, 0.01)]
    t[20:60] += 0.004 * np.random.default_rng(1).uniform(-1, 1, 40)
    spin = Rotation.from_rotvec(np.outer(t, [0.3, -2.0, 0.5])).as_quat(scalar_first=True)
    gap = [2.0, 2.25, 2.499]
    at = np.sort(np.r_[np.linspace(0, 1.98, 100), t, gap])
    assert at[np.isnan(attitude.interpolate(t, spin, at)).any(axis=1)].tolist() == gap


def test_statistics_of_known_errors() -> None:
    errors = np.radians(np.arange(1.0, 101.0))[:, None] * np.ones(5)
    values = metrics.statistics(errors)
    assert values["tilt_rmse_deg"] == pytest.approx(np.sqrt(np.mean(np.arange(1, 101) ** 2)))
    assert values["tilt_p95_deg"] == pytest.approx(95.05)
    assert values["tilt_max_deg"] == pytest.approx(100)


def test_the_table_says_how_much_of_the_time_an_estimate_covers() -> None:
    figures = {f"{m}_{s}_deg": 1.0 for m in metrics.MEASURES for s in ("rmse", "p95", "max")}
    whole, partial = ({**figures, "availability": share, "phases": {}} for share in (0.996, 0.798))
    result = {"reference": "truth", "from_s": 0.0, "to_s": 10.0, "estimators": {"a": whole, "b": partial}}
    lines = table(result).splitlines()
    assert lines[1].endswith("avail") and lines[2].endswith("99.6%") and lines[3].endswith("79.8%")
    assert "avail" not in table({**result, "estimators": {"a": whole}})


def test_the_table_is_sorted_by_tilt_and_fits_eighty_columns() -> None:
    figures = {f"{m}_{s}_deg": 100.0 for m in metrics.MEASURES for s in ("rmse", "p95", "max")}
    phases = dict.fromkeys(("ground", "straight", "turning", "transient"), figures)
    rows = {
        name: {**figures, "tilt_rmse_deg": tilt, "availability": 0.5, "nees": 4e5, "phases": phases}
        for name, tilt in (("ckf-air-chr", 5.0), ("never", None), ("ins21-sbg", 0.2))
    }
    lines = table({"reference": "truth", "from_s": 0.0, "to_s": 662.0, "estimators": rows}).splitlines()
    assert [line.split()[0] for line in lines[2:5]] == ["ins21-sbg", "ckf-air-chr", "never"]
    assert lines[5].startswith("no attitude in these 662 s: never;")  # a dash has its reason
    assert max(map(len, lines)) <= 80


def test_roll_and_heading_are_left_out_where_the_nose_is_near_the_vertical() -> None:
    """Half a degree about the nose of a tail-sitter is half a degree, not tens of heading and roll."""
    pitch = np.radians(np.array([0.0, 80.0, 84.0, 84.4, 89.0, 90.0, -85.0]))
    reference = attitude.from_euler(np.column_stack([np.full(7, 0.1), pitch, np.full(7, 1.0)]))
    small = attitude.from_euler(np.tile([[0.004, 0.003, -0.004]], (7, 1)))
    q = attitude.product(reference, small)
    errors = metrics.attitude_errors(q, attitude.down(q), reference)
    steep = np.array([False, False, False, True, True, True, True])
    np.testing.assert_array_equal(np.isnan(errors[:, 0]), steep)
    np.testing.assert_array_equal(np.isnan(errors[:, 2]), steep)
    assert np.isfinite(errors[:, [1, 3, 4]]).all()
    assert np.nanmax(np.abs(errors[:, [0, 2]])) < 0.06
    assert errors[:, 4] == pytest.approx(np.full(7, errors[0, 4]), rel=1e-6)
    found = accuracy.summary([errors.astype(np.float32)], np.full(7, -1))
    assert found["steep"] == pytest.approx(4 / 7)
    assert found["availability"] == 1.0
    assert "steep" not in accuracy.summary([errors[:3].astype(np.float32)], np.full(3, -1))
