"""What the motor does to a sample, from idle to a piston engine, and to an estimate."""

import numpy as np
import pytest
from sensor_helpers import run, suite, truth

from ahrs_sim import scenario
from ahrs_sim.papers import bench

CALM = {
    "accelerometer": {"vibration_line_mps2": 0.0, "vibration_band_mps2": 0.0},
    "gyro": {"vibration_line_dps": 0.0, "vibration_band_dps": 0.0},
}
PISTON = {key: value for key, value in scenario.load("piston").data["suite"]["chr"].items() if key != "grade"}


def shaken(rpm: float, **figures: object) -> np.ndarray:
    """RMS (3,) m/s2 that the motor adds to a sample of the accelerometer."""
    flight = truth(8000, rpm=rpm)
    with_motor, without = (run(suite("chr_6dm", **f), flight)["imu"].accel_b for f in (figures, CALM))
    return np.asarray(np.sqrt(np.mean((with_motor - without) ** 2, axis=0)))


def test_levels_at_cruise_and_idle() -> None:
    assert shaken(5668.0) == pytest.approx([0.56, 0.56, 0.68], rel=0.12)
    assert 0.02 < shaken(390.0).max() < 0.08, "an electric motor hardly shakes at idle"
    assert shaken(0.0).max() == 0.0
    assert shaken(5668.0, **PISTON) == pytest.approx([2.8, 2.8, 3.4], rel=0.12)
    assert 1.0 < shaken(390.0, **PISTON).max() < 2.5, "a piston engine does"


def test_the_levels_ahead_of_the_filters_are_those_of_the_source() -> None:
    """3 m/s2 RMS: a line with two harmonics, and a band that is flat to 800 Hz."""
    line = 3.0 / np.sqrt(2.0) * np.sqrt(1.0 + 0.5**2 + 0.25**2)
    band = 0.5 * np.sqrt(800.0 / 50.0)
    assert np.hypot(line, band) == pytest.approx(3.0, abs=0.2)


@pytest.mark.long
def test_ten_times_as_much_does_not_double_an_error() -> None:
    """Ten times 0.1 m/s2 in a sample, the level of a foam-mounted unit."""
    flown = bench.fly(scenario.load("turns", duration=240.0).data, "turns")
    figures: list[list[float]] = []
    for factor in (1.0, 10.0):
        motor = {
            "accelerometer": {
                "vibration_line_mps2": [0.3 * factor] * 2 + [0.5 * factor],
                "vibration_band_mps2": 0.1 * factor,
            },
            "gyro": {"vibration_line_dps": [0.5 * factor] * 2 + [0.3 * factor], "vibration_band_dps": 0.1 * factor},
        }
        errors = []
        for seed in (1, 2):
            unit = bench.measure(flown, {"grade": "chr_6dm", **motor}, seed)
            estimates = unit.estimate("ins21", heading_aid=False)
            errors.append(unit.errors(estimates)[estimates.t > 80.0][:, [3, 2]])
        figures.append([bench.rms(column) for column in np.concatenate(errors).T])
    assert np.all(np.array(figures[1]) < 2.0 * np.array(figures[0]))
