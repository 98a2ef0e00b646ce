"""A calibration flight: what was drawn of the unit is found within its sigma, and helps in the next flight."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import cli, pipeline, scenario
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.sensors import correction


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The log of a calibration flight, and the correction made of it."""
    folder = tmp_path_factory.mktemp("calibrate")
    log, unit = folder / "flown.mcap", folder / "unit.toml"
    pipeline.fly(scenario.load("calibration", estimators=["ins-cal"]), log)
    assert cli.main(["calibrate", str(log), "-o", str(unit)]) == 0
    return log, unit


def visible(matrices: list[np.ndarray]) -> np.ndarray:
    """Errors of all sensors without the rotation that they have in common, which no flight shows."""
    turned = np.mean([0.5 * (m - m.T) for m in matrices], axis=0)
    return np.array([m - turned for m in matrices])


@pytest.mark.long
def test_what_was_drawn_is_found_within_its_sigma(calibrated: tuple[Path, Path]) -> None:
    log, unit = calibrated
    found = correction.load(str(unit), "test")
    with FlightReader(log) as reader:
        drawn = reader.metadata["suite chr"]
    ratios, were, left = [], [], []
    for name in correction.TRIADS:
        triad = getattr(found, name)
        true = np.array(drawn[f"drawn.{name}.matrix"].split(), float).reshape(3, 3)
        were.append(true - np.eye(3))
        left.append(triad.inverse @ true - np.eye(3))
        ratios.append((left[-1] / triad.matrix_sigma).ravel())
    assert np.std(visible(left)) < 0.6 * np.std(visible(were))
    iron = np.array(drawn["drawn.magnetometer.turn_on_bias"].split(), float)
    ratios.append((iron - found.magnetometer.bias) / found.magnetometer.bias_sigma)
    ratio = np.concatenate(ratios)
    assert np.abs(ratio).max() < 4.0
    assert 0.2 < np.mean(ratio**2) < 3.0


@pytest.mark.long
def test_the_next_flight_of_the_unit_is_better(calibrated: tuple[Path, Path], tmp_path: Path) -> None:
    _, unit = calibrated
    errors = []
    for correct in ("", f"correction = '{unit}'"):
        file = tmp_path / "next.toml"
        file.write_text(f'extends = "short_turns"\nseed = 2\n[suite.chr]\nunit_seed = 1\n{correct}\n')
        accuracy = Accuracy(["ins-cal-chr"])
        pipeline.fly(scenario.load(str(file), estimators=["ins-cal@chr"]), None, accuracy=accuracy)
        found = accuracy.result(low=45.0)["estimators"]["ins-cal-chr"]
        errors.append(np.hypot(found["tilt_rmse_deg"], found["heading_rmse_deg"]))
    assert errors[1] < 0.95 * errors[0]


def test_errors_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "flown.mcap"
    pipeline.fly(scenario.load("standing", estimators=["marg-ekf@chr"], duration=25.0), log)
    for arguments, words in (
        (["--estimator", "marg-ekf@chr"], "has no states of calibration; take ins-cal"),
        (["--estimator", "ins-cal@chr", "--until", "2"], "has not aligned"),
        (["--estimator", "ins-cal@chx"], "chx"),
    ):
        assert cli.main(["calibrate", str(log), *arguments, "-o", str(tmp_path / "unit.toml")]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    (tmp_path / "unit.toml").write_text("")
    assert cli.main(["calibrate", str(log), "-o", str(tmp_path / "unit.toml")]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.long
def test_the_file_is_read_as_it_was_written(calibrated: tuple[Path, Path]) -> None:
    _, unit = calibrated
    tables = tomllib.loads(unit.read_text())
    assert set(tables) == set(correction.TRIADS)
    assert "bias" not in tables["gyro"]
    assert len(tables["magnetometer"]["bias"]) == 3
