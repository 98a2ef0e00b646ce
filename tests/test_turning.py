"""Turn rate and slip: what an indicator would show in known motion, whatever the blocks, and of a flight in its log."""

from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import attitude, pipeline
from ahrs_sim import scenario as scenarios
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.turning import TurnAndSlip, Turning

G = 9.80665


def motion(bank_deg: float, pitch_deg: float, rate_dps: float, side: float = 0.0) -> tuple[np.ndarray, ...]:
    """A steady turn for 5 s at 100 Hz with `side` m/s2 of specific force to the right, coordinated but for that."""
    t = np.arange(500) * 0.01
    roll, pitch, rate = np.radians([bank_deg, pitch_deg, rate_dps])
    yaw = rate * t
    half = 0.5 * np.column_stack([np.full(500, roll), np.full(500, pitch), yaw])
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    q_nb = np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
    down_b = attitude.down(q_nb)
    force = np.tile([0.0, side, -G / np.cos(roll)], (500, 1))
    return t, rate * down_b, force, down_b


@pytest.mark.parametrize(("bank", "pitch", "rate"), [(0.0, 0.0, 3.0), (45.0, 0.0, -12.0), (30.0, 20.0, 6.0)])
def test_the_turn_rate_is_that_of_the_heading_at_any_attitude(bank: float, pitch: float, rate: float) -> None:
    found = TurnAndSlip().add(*motion(bank, pitch, rate))
    assert len(found) == 50
    assert np.degrees(found.turn_rate) == pytest.approx(rate, abs=1e-9)
    assert found.slip == pytest.approx(0.0, abs=1e-12)


def test_the_ball_is_on_the_side_to_which_the_occupants_are_thrown() -> None:
    found = TurnAndSlip().add(*motion(0.0, 0.0, 0.0, side=-G * np.tan(np.radians(5.0))))
    assert np.degrees(found.slip) == pytest.approx(5.0)
    level = np.tile([0.0, 0.0, -1.0], (500, 1)) * G
    banked = np.radians(10.0)  # wings held 10 deg to the right without turning: the ball is on the low side
    t, rate, _, down_b = motion(10.0, 0.0, 0.0)
    force = np.column_stack([level[:, 0], -G * np.sin(banked) * np.ones(500), -G * np.cos(banked) * np.ones(500)])
    assert np.degrees(TurnAndSlip().add(t, rate, force, down_b).slip) == pytest.approx(10.0)


def test_the_bits_do_not_depend_on_the_blocks() -> None:
    rng = np.random.default_rng(1)
    t, rate, force, down_b = motion(20.0, 3.0, 5.0)
    rate, force = rate + rng.normal(0.0, 0.1, rate.shape), force + rng.normal(0.0, 2.0, force.shape)
    force[120:130] = np.nan
    whole = TurnAndSlip().add(t, rate, force, down_b)
    for size in (1, 7, 499):
        cut = TurnAndSlip()
        rows = [slice(k, k + size) for k in range(0, len(t), size)]
        parts = Turning.concatenate([cut.add(t[r], rate[r], force[r], down_b[r]) for r in rows])
        for name in ("t", "turn_rate", "slip"):
            assert getattr(parts, name).tobytes() == getattr(whole, name).tobytes()


def test_what_is_not_known_is_nan() -> None:
    t, rate, force, down_b = motion(20.0, 0.0, 5.0)
    down_b[:200] = np.nan  # aligning
    found = TurnAndSlip().add(t, rate, force, down_b)
    assert np.isnan(found.turn_rate[:20]).all()
    assert np.isfinite(found.turn_rate[26:]).all()
    assert np.isfinite(found.slip).all()
    assert np.isnan(TurnAndSlip().add(*motion(0.0, 89.0, 5.0)).turn_rate).all()  # on its tail
    t, rate, force, down_b = motion(0.0, 0.0, 0.0)
    assert np.isnan(TurnAndSlip().add(t, rate, 0.05 * force, down_b).slip).all()  # free fall: the ball floats


def test_a_part_of_a_flight_has_the_errors_of_turn_rate_and_slip() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    accuracy = Accuracy(["a", "b"])
    accuracy.add_turning(None, t, np.full(200, 0.05), np.zeros(200))
    accuracy.add_turning("a", t, 0.05 + np.where(t > 10.0, 0.02, 0.0), np.radians(np.where(t > 15.0, -2.0, 0.5)))
    early, late = accuracy.part(0.0, 9.0), accuracy.part(11.0, 20.0)
    assert early["a"]["turn_rate_max_dps"] == pytest.approx(0.0, abs=1e-9)
    assert late["a"]["turn_rate_p95_dps"] == pytest.approx(np.degrees(0.02))
    assert late["a"]["slip_max_deg"] == pytest.approx(2.0)
    assert late["a"]["slip_worst_s"] > 15.0
    assert "slip_max_deg" not in late["b"]  # never said


FLIGHT = """
duration_s = 55.0
rate_hz = 200.0
aircraft = "trainer"
start = {on_ground = false, height_m = 150.0, airspeed_mps = 22.0}
step = [
    {do = "straight", for_s = 20.0},
    {do = "turn", rate_dps = 6.0, for_s = 20.0},
    {do = "doublet", surface = "rudder", size = 0.3, for_s = 20.0},
]
suite = {sbg = {grade = "sbg_ig500"}}
estimator = {tilt = {method = "tilt-ekf", suite = "sbg"}}
"""


def test_a_flight_logs_turn_rate_and_slip_of_truth_and_estimator(tmp_path: Path) -> None:
    """A turn of 6 deg/s is seen as such by a method without a heading; a rudder moves the ball, and both agree."""
    path = tmp_path / "flight.toml"
    path.write_text(FLIGHT)
    accuracy = Accuracy(["tilt"])
    pipeline.fly(scenarios.load(str(path)), tmp_path / "flight.mcap", accuracy=accuracy)
    with FlightReader(tmp_path / "flight.mcap") as log:
        truth, found = log.read("/truth/turn"), log.read("/est/tilt/turn")
    t = np.arange(len(truth)) * 0.1
    turning, skidding = (t > 28.0) & (t < 39.0), t > 42.0
    assert np.degrees(truth["turn_rate"][turning]) == pytest.approx(6.0, abs=0.5)
    assert np.degrees(np.abs(truth["slip"][turning])).max() < 1.0
    assert np.degrees(np.abs(truth["slip"][skidding])).max() > 3.0
    assert abs(len(found) - len(truth)) <= 2
    part = accuracy.part(20.0, 54.0)["tilt"]
    assert part["turn_rate_p95_dps"] < 0.5
    assert part["slip_p95_deg"] < 1.0
