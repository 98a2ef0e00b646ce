"""Six hours on the bench: every grade shows the densities and floors that it states, at any rate."""

import numpy as np
import pytest
from sensor_helpers import EPOCH, START, component

from ahrs_sim.review.allan import allan_table
from ahrs_sim.sensors.faults import Faults
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import load
from ahrs_sim.sensors.magnetometer import MagFigures
from ahrs_sim.sensors.suite import SECTIONS
from ahrs_sim.sensors.triad import GyroFigures, InertialFigures, Triad, TriadFigures

HOURS = 6.0
SENSORS: dict[str, type[TriadFigures]] = {
    "gyro": GyroFigures,
    "accelerometer": InertialFigures,
    "magnetometer": MagFigures,
}


def standing(grade: str, sensor: str, rate: float, hours: float = HOURS) -> tuple[TriadFigures, np.ndarray]:
    """Samples (n, 3) of a sensor that does not move, at constant temperature, in blocks of 10 s."""
    loaded = load(grade, SECTIONS)
    fitting = Fitting(
        suite="bench",
        grade=loaded,
        faults=Faults([], "bench"),
        seed=4,
        unit_seed=4,
        dt=1.0 / rate,
        epoch=EPOCH,
        start_lla=START,
        position=np.zeros(3),
        mount=np.eye(3),
        mounting_error=np.eye(3),
        where=component(grade).where,
    )
    figures = loaded.figures(sensor, SENSORS[sensor])
    triad = Triad(sensor, figures, fitting, 1)
    truth = {"gyro": [0.0, 0.0, 0.0], "accelerometer": [0.0, 0.0, -9.81], "magnetometer": [2.2e-5, 0.0, 4.2e-5]}
    size = int(10 * rate)
    u, t, extra = np.tile(truth[sensor], (size, 1)), np.arange(size) / rate, np.zeros(size)
    blocks = [triad.measure(u, slice(0, size, 1), t, extra)[0] for _ in range(int(hours * 360))]
    return figures, np.vstack(blocks)


# Every grade at one rate, every rate with one grade: no code knows the two together, so that 15 of the 27 pairs find
# what all would.
PAIRS = [("chr_6dm", 50.0), ("chr_6dm", 100.0), ("chr_6dm", 400.0), ("sbg_ig500", 100.0), ("road_mems", 100.0)]


@pytest.mark.long
@pytest.mark.parametrize("sensor", list(SENSORS))
@pytest.mark.parametrize(("grade", "rate"), PAIRS)
def test_six_hours_give_the_grade_back(grade: str, sensor: str, rate: float) -> None:
    figures, series = standing(grade, sensor, rate)
    table = allan_table(series, rate)
    np.testing.assert_allclose(table.density.value, figures.noise_density, rtol=0.05)
    if figures.bias_floor.any():
        np.testing.assert_allclose(table.floor.value, figures.bias_floor, rtol=0.15)
    # Rate invariance: the whole curve, not only what is fitted to it.
    model = figures.noise_density**2 / 2.0 / table.tau[:, None] + figures.bias_floor**2
    seen = (table.tau > 1.0) & (table.tau < 300.0)
    ratio = (table.deviation[seen] / np.sqrt(model[seen])).mean(axis=1)
    assert np.abs(ratio - 1.0).max() < 0.12


SHOP = (
    "adis16470", "adis16505_2", "bmi088", "bmi270", "hg4930", "icm42688p", "lsm6dsv", "mti_3", "sbg_ellipse",
    "sbg_pulse_40", "stim300", "vn_100",
)  # fmt: skip
CASES = [(grade, sensor) for grade in SHOP for sensor in ("gyro", "accelerometer")]


@pytest.mark.long
@pytest.mark.parametrize(("grade", "sensor"), CASES)
def test_sixty_hours_give_the_data_sheet_back(grade: str, sensor: str) -> None:
    """At 10 Hz, so that the floor of a tactical unit, which shows after minutes, is seen often enough."""
    rate = 10.0
    figures, series = standing(grade, sensor, rate, hours=60.0)
    table = allan_table(series, rate)
    np.testing.assert_allclose(table.density.value, _with_rounding(figures, rate), rtol=0.05)
    np.testing.assert_allclose(table.floor.value, figures.bias_floor, rtol=0.15)


def _with_rounding(figures: TriadFigures, rate: float) -> np.ndarray:
    """Density of the noise and of rounding, uniform over a step: sigma^2 = q^2 / 12."""
    return np.asarray(np.sqrt(figures.noise_density**2 + figures.quantum**2 / 6.0 / rate))


@pytest.mark.long
@pytest.mark.parametrize("grade", ["ist8310", "mmc5983ma", "qmc5883l", "rm3100", "mti_3", "vn_100"])
def test_an_hour_gives_the_noise_of_a_magnetometer_back(grade: str) -> None:
    """At its own rate: a field that stands still is rounded evenly only where the noise of a sample is about a step."""
    rate = load(grade, SECTIONS).figures("magnetometer", MagFigures).rate
    figures, series = standing(grade, "magnetometer", rate, hours=1.0)
    np.testing.assert_allclose(allan_table(series, rate).density.value, _with_rounding(figures, rate), rtol=0.05)
