"""Hard and soft iron: kept where the part not fitted to agrees, refused where there is none, sigmas that hold."""

import dataclasses

import numpy as np
import pytest
from bag_helpers import motion, write_bag
from flights import FIELD_N, Path, Planted, flown

from ahrs_sim.recordings import calibration, inertial
from ahrs_sim.recordings.recording import open_bag
from ahrs_sim.world.gravity import STANDARD as G

FIELD = float(np.linalg.norm(FIELD_N))


def tried(seed: int, hard: tuple[float, float, float]) -> calibration.Trial:
    s = flown(Path(seed), Planted(hard_iron=np.array(hard)), seed=seed)
    return calibration.try_mag(s, np.eye(3), FIELD, inertial.track(s, G))


@pytest.mark.parametrize("seed", range(3))
def test_iron_is_kept_and_within_its_sigma(seed: int) -> None:
    hard = (1e-5, 2e-5, -1e-5)
    trial = tried(seed, hard)
    assert trial.fit is not None
    assert trial.line.startswith("kept: on what it was not fitted to, norm ")
    assert np.all(np.abs(trial.fit.hard_iron - hard) < 3 * trial.fit.hard_sigma)
    assert trial.fit.hard_sigma.max() < 1e-6
    assert trial.left == trial.fit.hard_sigma.max()


@pytest.mark.parametrize("seed", range(3))
def test_a_calibrated_magnetometer_is_left_alone(seed: int) -> None:
    trial = tried(seed, (0.0, 0.0, 0.0))
    assert trial.fit is None
    assert "refused, because no iron stands out" in trial.line


@pytest.mark.parametrize(
    "axes", [np.diag([1.0, -1.0, -1.0]), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])]
)
def test_a_magnetometer_mounted_another_way_round_is_no_iron(axes: np.ndarray) -> None:
    """Or the check of its axes, which comes after, would look at what the calibration has made of them."""
    s = flown(Path(1), Planted(), seed=1)
    trial = calibration.try_mag(dataclasses.replace(s, mag=s.mag @ axes.T), np.eye(3), FIELD, inertial.track(s, G))
    assert trial.fit is None
    assert trial.line == "refused, because its axes are not those of the IMU"


def test_an_axis_that_is_not_excited_gets_no_iron() -> None:
    """Level circles show nothing along down."""
    s = flown(Path(circles=True, wind_n=(0.0, 0.0)), Planted(hard_iron=np.array([8e-6, 0.0, 0.0])))
    fit = calibration.fit_mag(s.mag, calibration.turns(s, np.eye(3)), None)
    assert fit is None or abs(fit.hard_iron[2]) < 3 * fit.hard_sigma[2]


def test_what_is_printed_goes_into_a_map(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    import tomllib

    hard = np.array([2e-5, -1e-5, 3e-5])
    write_bag(tmp_path / "a.mcap", motion(60.0, still=5.0), hard_iron=hard)
    with open_bag(tmp_path / "a.mcap", map_file=None, calibrate=["auto"]) as bag:
        assert any("magnetometer calibration kept" in note for note in bag.notes)
        start = next(i for i, note in enumerate(bag.notes) if note.endswith("lines for a map:"))
        text = "\n".join(bag.notes[start + 1 : start + 3])
        found = tomllib.loads(text)["magnetometer"]
        assert found["hard_iron"] == pytest.approx(hard, abs=5e-7)
        assert len(found["soft_iron"]) == 9
        assert bag.sensors.mag_bias > 1e-6
    (tmp_path / "m.toml").write_text(text)
    with open_bag(tmp_path / "a.mcap", map_file=tmp_path / "m.toml", calibrate=["auto"]) as bag:
        assert not any("calibration" in note for note in bag.notes)
        assert not any(note.startswith("check") for note in bag.notes)


def test_a_correction_is_taken_off_the_readings_in_the_vehicles_axes(tmp_path) -> None:  # type: ignore[no-untyped-def]
    from ahrs_sim.sensors import correction

    write_bag(tmp_path / "a.mcap", motion(20.0, still=5.0))
    (tmp_path / "unit.toml").write_text(
        "[gyro]\nmatrix = [1.01, 0.02, 0, 0, 1, -0.01, 0, 0, 0.99]\nmatrix_sigma = [0,0,0, 0,0,0, 0,0,0]\n"
        "[accelerometer]\nmatrix = [1, 0.02, 0, 0, 1.02, 0, 0.03, 0, 1]\nbias = [0.1, 0, 0]\n"
        "[magnetometer]\nmatrix = [1, 0, 0.02, 0, 1, 0, 0, 0.03, 0.98]\nbias = [1e-6, 0, -2e-6]\n"
    )
    (tmp_path / "m.toml").write_text("correction = 'unit.toml'\n")
    (tmp_path / "as_is.toml").write_text("[magnetometer]\nhard_iron = [0, 0, 0]\n")
    found = []
    for name in ("as_is.toml", "m.toml"):
        with open_bag(tmp_path / "a.mcap", map_file=tmp_path / name, calibrate=["auto"]) as bag:
            blocks = [block["bag"] for block in bag.blocks()]
            found.append({k: np.concatenate([getattr(b[r], k) for b in blocks])
                          for r, k in (("imu", "gyro_b"), ("imu", "accel_b"), ("mag", "mag_b"))})  # fmt: skip
            assert (bag.sensors.gyro_misalignment == 0.0) == (name == "m.toml")
    unit = correction.load("unit.toml", str(tmp_path / "m.toml"))
    for triad, column in ((unit.gyro, "gyro_b"), (unit.accelerometer, "accel_b"), (unit.magnetometer, "mag_b")):
        np.testing.assert_allclose(found[1][column], triad.applied(found[0][column]), rtol=1e-12)
