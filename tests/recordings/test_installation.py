"""How sensors are installed: what was planted is found within its sigma, what a flight does not show is not claimed."""

import math
import tomllib
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
from flights import FIELD_N, Path, Planted, flown

from ahrs_sim import attitude
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
