"""Allan tables of logs: specified beside recovered, gaps, and one clear line for what cannot be analysed."""

import json
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import pipeline, scenario
from ahrs_sim.errors import InputError
from ahrs_sim.review import allan


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("allan") / "still.mcap"
    scene = scenario.parse(
        {
            "duration_s": 60.0,
            "motion": {"kind": "sway", "still_s": 60.0},
            "suite": {"sbg": {"grade": "sbg_ig500", "imu": {"warm_up_k": 0.0}}},
            "estimator": {"ekf": {"method": "marg-ekf", "suite": "sbg"}},
            "fault": [{"suite": "sbg", "sensor": "imu", "kind": "dropout", "at_s": 50.0, "for_s": 0.5}],
        },
        "still",
        "test.toml",
    )
    pipeline.fly(scene, path)
    return path


def test_specified_and_recovered_side_by_side(log: Path) -> None:
    channels = allan.of_log(log)
    assert [(c.topic, c.sensor) for c in channels] == [
        ("/sbg/imu/data_raw", "gyro"),
        ("/sbg/imu/data_raw", "accelerometer"),
    ]
    gyro = channels[0]
    assert gyro.table.duration == pytest.approx(50.0, abs=0.05)  # the longest stretch without a gap
    assert gyro.specified is not None
    np.testing.assert_allclose(gyro.specified["density"], np.radians(0.05))
    np.testing.assert_allclose(gyro.specified["floor"], np.radians(20.0 / 3600.0))
    np.testing.assert_allclose(gyro.table.density.value, np.radians(0.05), rtol=0.08)
    lines = allan.text(channels).splitlines()
    assert len(lines) == 2 * 11
    assert "1 gaps" in lines[1]
    assert "specified     0.05" in lines[2]
    rows = json.loads(json.dumps(allan.as_json(channels)))
    assert rows[0]["coefficients"][0]["specified"] == pytest.approx(np.radians(0.05))


def test_named_topics_and_pictures(log: Path, tmp_path: Path) -> None:
    (mag,) = allan.of_log(log, ["/sbg/imu/mag"])
    assert mag.specified is not None
    np.testing.assert_allclose(mag.specified["density"], 1e-9)
    allan.plot([mag], tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="cannot be written"):
        allan.plot([mag], tmp_path / "none" / "a.png")


def test_what_cannot_be_analysed(log: Path) -> None:
    with pytest.raises(InputError, match="give an Imu or MagneticField topic"):
        allan.of_log(log, ["/sbg/gps/fix"])
    with pytest.raises(InputError, match="no topic '/sbg/imu/dat_raw'"):
        allan.of_log(log, ["/sbg/imu/dat_raw"])
    with pytest.raises(InputError, match="too few"):
        allan.allan_table(np.zeros(5), 1.0)
    with pytest.raises(InputError, match="missing values"):
        allan.allan_table(np.full(50, np.nan), 1.0)


def test_a_constant_has_no_noise() -> None:
    table = allan.allan_table(np.full(1000, 3.0), 10.0)
    assert not table.deviation.any()
    assert not table.density.value.any()
