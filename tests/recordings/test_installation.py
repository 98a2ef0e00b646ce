"""How sensors are installed: what was planted is found within its sigma, what a flight does not show is not claimed."""

import math
import re
import tomllib
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
import ulog_helpers
from bag_helpers import EPOCH
from flights import FIELD_N, Path, Planted, flown, measured

from ahrs_sim import attitude
from ahrs_sim.cli import main
from ahrs_sim.recordings import installation, mapping
from ahrs_sim.recordings.checks import signed_axes
from ahrs_sim.recordings.installation import Installation
from ahrs_sim.world.gravity import STANDARD as G

DIP = math.atan2(FIELD_N[2], math.hypot(FIELD_N[0], FIELD_N[1]))
INCIDENCE = math.radians(2.0)


def planted(seed: int, **fixed: Any) -> Planted:
    """Everything wrong at once."""
    rng = np.random.default_rng(seed + 500)
    angles = np.radians(rng.uniform(-4.0, 4.0, 3))
    values = {
        "gnss_delay": rng.uniform(-0.05, 0.4), "mag_delay": rng.uniform(-0.02, 0.15), "air_delay": rng.uniform(0, 0.5),
        "lever_b": rng.uniform(-1.5, 1.5, 3), "boresight": attitude.matrix(*angles),
        "air_scale": rng.uniform(0.9, 1.1), "hard_iron": rng.uniform(-3e-6, 3e-6, 3),
    }  # fmt: skip
    return Planted(**{**values, **fixed})


def found_in(path: Path, p: Planted, seed: int, map_file: File | None = None, **options: Any) -> Installation:
    s = flown(path, p, seed=seed, **options)
    return installation.find(s, s.mag, mapping.load(map_file), G, DIP)


def truth(p: Planted) -> dict[str, np.ndarray]:
    roll, pitch, yaw = attitude.euler_of(p.boresight)
    values = {"velocity": p.gnss_delay, "fix": p.gnss_delay, "mag": p.mag_delay, "air": p.air_delay, "lever": p.lever_b,
              "air_scale": p.air_scale, "roll": roll, "incidence": pitch + INCIDENCE, "yaw": yaw}  # fmt: skip
    return {name: np.atleast_1d(value) for name, value in values.items()}


def check(out: Installation, p: Planted) -> None:
    seen = {name: e for name, e in out.found.items() if e.seen}
    assert len(seen) >= 6
    for name, estimate in seen.items():
        assert np.all(np.abs(estimate.value - truth(p)[name]) < 3.0 * estimate.sigma), name


@pytest.mark.parametrize("seed", range(2))
def test_planted_values_are_found(seed: int) -> None:
    p = planted(seed)
    check(found_in(Path(seed), p, seed), p)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2, 14))
def test_planted_values_are_found_on_more_seeds(seed: int) -> None:
    p = planted(seed)
    check(found_in(Path(seed), p, seed), p)


def test_lines_go_into_a_map_and_take_it_out(tmp_path: File) -> None:
    p = planted(3)
    out = found_in(Path(3), p, 3)
    data = tomllib.loads(out.toml())
    assert data["time"]["velocity_s"] == pytest.approx(-p.gnss_delay, abs=0.05)
    assert data["time"]["mag_s"] == pytest.approx(-p.mag_delay, abs=0.05)
    assert data["air"]["scale"] == pytest.approx(p.air_scale, rel=0.02)
    assert data["sensors"]["antenna_b"] == pytest.approx(p.lever_b, abs=0.8)
    (tmp_path / "m.toml").write_text(out.toml())
    map_ = mapping.load(tmp_path / "m.toml")
    assert map_.shifts["velocity"] == round(data["time"]["velocity_s"] * 1e9)
    assert map_.air_scale == data["air"]["scale"]


def test_nothing_planted_gives_no_lines() -> None:
    out = found_in(Path(4), Planted(), 4)
    assert out.toml() == ""
    assert "magnetometer orientation: as it is read" in out.lines


def test_a_flight_of_circles_says_what_it_cannot_know() -> None:
    out = found_in(Path(circles=True), planted(1), 1)
    unseen = " ".join(line for line in out.lines if "not observable" in line)
    for words in ("GNSS velocity: delay", "GNSS lever arm", "magnetometer orientation", "magnetometer: delay",
                  "airspeed: delay", "boresight"):  # fmt: skip
        assert words in unseen
    assert set(tomllib.loads(out.toml())) <= {"air"}


def test_orientation_of_a_magnetometer_goes_into_a_map(tmp_path: File) -> None:
    name, matrix = next((n, m) for n, m in signed_axes() if n == "-y x z")
    out = found_in(Path(2), Planted(mag_axes=matrix, mag_delay=0.05), 2)
    assert f"magnetometer orientation: axes read as ({name})" in out.lines
    (tmp_path / "m.toml").write_text(out.toml())
    np.testing.assert_allclose(mapping.load(tmp_path / "m.toml").mag_mount, matrix, atol=1e-6)
    assert out.found["mag"].value == pytest.approx([0.05], abs=3 * float(out.found["mag"].sigma[0]))


def test_without_gnss_only_the_magnetometer_is_found() -> None:
    s = flown(Path(2), Planted(mag_delay=0.08))
    s.t_velocity, s.vel_n = s.t_velocity[:0], s.vel_n[:0]
    out = installation.find(s, s.mag, mapping.load(None), G, DIP)
    assert set(out.found) == {"mag"}
    assert any(line.startswith("GNSS: no velocity: not observable") for line in out.lines)


@pytest.mark.long
def test_the_command_finds_it_in_a_file(tmp_path: File, capsys: pytest.CaptureFixture[str]) -> None:
    """From a recording on disk to the lines of a map: calibration and checks lie between."""
    p = planted(0)
    log = tmp_path / "a.ulg"
    as_ulog(log, measured(Path(0), p, seed=0))
    assert main(["replay", str(log), "--find"]) == 0
    out = capsys.readouterr().out
    lines = tomllib.loads(out.split("lines for a map:")[-1])
    assert lines["time"]["velocity_s"] == pytest.approx(-p.gnss_delay, abs=0.06)
    assert lines["time"]["air_s"] == pytest.approx(-p.air_delay, abs=0.15)
    assert lines["sensors"]["antenna_b"] == pytest.approx(p.lever_b, abs=1.2)
    scale, sigma = re.findall(r"true airspeed is ([\d.]+) \+- ([\d.]+) of what is read", out)[0]
    assert float(scale) == pytest.approx(p.air_scale, abs=3 * float(sigma))
    as_ulog(log, measured(Path(circles=True), Planted(gnss_delay=0.3), seed=0))
    assert main(["replay", str(log), "--find"]) == 0
    assert "not observable in this recording" in capsys.readouterr().out


def as_ulog(path: File, blocks: Any) -> None:
    """Write the records of a flight as PX4 would log them."""
    imu, mag, velocity, fix, air = (blocks[k] for k in ("imu", "mag", "velocity", "fix", "air"))
    epoch = 5_000_000

    def us(records: Any) -> np.ndarray:
        stamps: np.ndarray = records.stamp_ns // 1000 + epoch
        return stamps

    ulog_helpers.write(
        path,
        ("sensor_combined", 0, "timestamp gyro_rad:float[3] accelerometer_m_s2:float[3]",
         {"timestamp": us(imu), "gyro_rad": imu.gyro_b, "accelerometer_m_s2": imu.accel_b}),
        ("vehicle_magnetometer", 0, "timestamp magnetometer_ga:float[3]",
         {"timestamp": us(mag), "magnetometer_ga": 1e4 * mag.mag_b}),
        ("vehicle_gps_position", 0, ulog_helpers.FIX,
         {"timestamp": us(fix), "time_utc_usec": us(fix) + EPOCH // 1000, "fix_type": 3, "heading": np.nan,
          **dict(zip(("latitude_deg", "longitude_deg", "altitude_ellipsoid_m"), fix.lla_deg.T, strict=True)),
          **dict(zip(("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"), velocity.vel_n.T, strict=True))}),
        ("airspeed", 0, "timestamp indicated_airspeed_m_s:float true_airspeed_m_s:float",
         {"timestamp": us(air), "indicated_airspeed_m_s": air.airspeed, "true_airspeed_m_s": air.airspeed}),
    )  # fmt: skip
