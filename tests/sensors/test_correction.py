"""Corrections of a unit: what was planted is taken off, sheets say what is left, a unit can fly again."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_helpers import run, same, suite, wild

from ahrs_sim.errors import InputError

FIGURES: dict[str, Any] = {
    "instruments": ["imu", "magnetometer"],
    "gyro": {"scale_percent": 1.0, "misalignment_deg": 0.5, "turn_on_bias_dps": 0.3},
    "accelerometer": {"scale_percent": 0.5, "cross_axis_percent": 1.0, "turn_on_bias_mps2": 0.2},
    "magnetometer": {"soft_iron_percent": 2.0, "misalignment_deg": 0.5, "turn_on_bias_ut": 2.0},
}


def written(path: Path, drawn: dict[str, np.ndarray], **more: Any) -> str:
    """A correction that takes off what was drawn."""
    lines = []
    for name in ("gyro", "accelerometer", "magnetometer"):
        values = {"matrix": drawn[f"{name}.matrix"], "bias": drawn[f"{name}.turn_on_bias"], **more}
        lines += [f"[{name}]", *(f"{key} = {json.dumps(np.ravel(v).tolist())}" for key, v in values.items())]
    path.write_text("\n".join(lines))
    return str(path)


def test_a_corrected_unit_reads_the_truth(tmp_path: Path) -> None:
    flight = wild(400)
    ideal = run(suite("ideal", instruments=FIGURES["instruments"]), flight)
    crooked = suite("ideal", **FIGURES)
    name = written(tmp_path / "unit.toml", crooked.drawn())
    assert np.abs(run(crooked, flight)["imu"].gyro_b - ideal["imu"].gyro_b).max() > 0.005
    mended = run(suite("ideal", **FIGURES, correction=name), flight)
    np.testing.assert_allclose(mended["imu"].gyro_b, ideal["imu"].gyro_b, atol=1e-14)
    np.testing.assert_allclose(mended["imu"].accel_b, ideal["imu"].accel_b, atol=1e-13)
    np.testing.assert_allclose(mended["mag"].mag_b, ideal["mag"].mag_b, atol=1e-18)
    np.testing.assert_allclose(mended["imu_errors"].gyro_bias, 0.0, atol=1e-15)


def test_the_true_biases_are_those_of_the_corrected_readings(tmp_path: Path) -> None:
    flight = wild(400)
    crooked = suite("ideal", **FIGURES)
    half = {k: 0.5 * (v + np.eye(3)) if "matrix" in k else 0.3 * v for k, v in crooked.drawn().items()}
    out = run(suite("ideal", **FIGURES, correction=written(tmp_path / "unit.toml", half)), flight)
    errors, imu = out["imu_errors"], out["imu"]
    true = run(suite("ideal", instruments=["imu"]), flight)["imu"]
    np.testing.assert_allclose(errors.accel_effective_bias, imu.accel_b - true.accel_b, atol=1e-13)
    left = np.linalg.inv(half["gyro.matrix"]) @ (0.7 * crooked.drawn()["gyro.turn_on_bias"])
    np.testing.assert_allclose(errors.gyro_effective_bias, np.tile(left, (100, 1)), atol=1e-15)


def test_any_length_of_blocks_gives_the_same_bytes(tmp_path: Path) -> None:
    flight = wild(400)
    name = written(tmp_path / "unit.toml", suite("chr_6dm").drawn())
    whole, short = (run(suite("chr_6dm", correction=name), flight, block) for block in (0, 7))
    assert all(same(whole[k], short[k]) for k in ("imu", "imu_errors", "mag"))


def test_the_sheet_says_what_is_left(tmp_path: Path) -> None:
    made = suite("chr_6dm")
    sigma = np.full((3, 3), 3e-3) + np.diag([1e-3] * 3)
    name = written(tmp_path / "unit.toml", made.drawn(), matrix_sigma=sigma)
    corrected = suite("chr_6dm", correction=name)
    info, own = corrected.info, made.info
    for sensor in ("gyro", "accel", "mag"):
        assert getattr(info, f"{sensor}_misalignment") == pytest.approx(4.5e-3)
        assert getattr(info, f"{sensor}_scale_factor") == pytest.approx(4e-3)
    assert info.gyro_scale == pytest.approx(np.hypot(4e-3, 4.5e-3))
    assert info.soft_iron == 0.0
    assert (info.mag_bias, info.gyro_bias) == (own.mag_bias, own.gyro_bias)  # no sigma of a bias was given
    assert "correction.gyro.matrix" in corrected.specification()


def test_the_same_unit_in_another_flight() -> None:
    flight = wild(400)
    first, again = suite("chr_6dm", seed=1), suite("chr_6dm", seed=2, unit_seed=1)
    other = suite("chr_6dm", seed=2)
    drawn = [s.drawn() for s in (first, again, other)]
    for name in ("gyro.matrix", "accelerometer.matrix", "magnetometer.matrix", "magnetometer.turn_on_bias"):
        assert np.array_equal(drawn[0][name], drawn[1][name])
        assert not np.array_equal(drawn[1][name], drawn[2][name])
    for name in ("gyro.turn_on_bias", "accelerometer.turn_on_bias", "magnetometer.model_error"):  # of the day
        assert np.array_equal(drawn[1][name], drawn[2][name])
        assert not np.array_equal(drawn[0][name], drawn[1][name])
    assert not np.array_equal(run(first, flight)["imu"].gyro_b, run(again, flight)["imu"].gyro_b)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[gyro]\nmatrix = [2,0,0, 0,1,0, 0,0,1]", r"\[gyro\]: matrix: is further than 0.5"),
        ("[magnetometer]\nbias_sigma = [1.0, -1.0, 1.0]", r"\[magnetometer\]: bias_sigma: is negative"),
        ("[gyro]\nmatrx = 1", "matrx: unknown key; did you mean 'matrix'"),
        ("[giro]", "giro: unknown key; did you mean 'gyro'"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "unit.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        suite("chr_6dm", correction=str(tmp_path / "unit.toml"))
    with pytest.raises(InputError, match="no such file beside it"):
        suite("chr_6dm", correction="none.toml")
