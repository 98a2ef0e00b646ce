"""What estimates report of a recording: innovations of the predicted size or not, an aid missing, no attitude."""

import dataclasses
import re
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
from bag_helpers import motion, write_bag
from flights import FIELD_N, LLA, Path, Planted, measured, records

from ahrs_sim.chain import recorded_chains
from ahrs_sim.cli import main
from ahrs_sim.recordings import checks
from ahrs_sim.recordings.mapping import SUITE
from ahrs_sim.recordings.outcome import Outcome
from ahrs_sim.scenario import Component
from ahrs_sim.sensors.records import ImuRecord, MagRecord
from ahrs_sim.world.gravity import STANDARD as G
from estimators.types import SensorInfo, Site


def component(method: str, **settings: Any) -> Component:
    return Component(method, {"method": method, "suite": SUITE, **settings}, "here")


def outcome(method: str, block: Any, sensors: SensorInfo | None = None, **settings: Any) -> Outcome:
    site = Site(
        (float(LLA[0]), float(LLA[1]), float(LLA[2])), G, (float(FIELD_N[0]), float(FIELD_N[1]), float(FIELD_N[2]))
    )
    chains = recorded_chains([component(method, **settings)], site, {SUITE: sensors or SensorInfo()})
    found = Outcome(chains)
    for name, estimates in chains[SUITE].estimate(chains[SUITE].assemble(block)):
        found.add(name, estimates)
    return found


@pytest.fixture(scope="module")
def block() -> Any:
    return measured(Path(3), Planted(), duration=120.0)


@pytest.mark.parametrize("method", ["ins21", "ins-cal", "marg-ekf", "air-ins"])
def test_silent_when_innovations_are_of_the_size_told(block: Any, method: str) -> None:
    aiding = {"aiding": "gnss"} if method == "marg-ekf" else {}
    found = outcome(method, block, **aiding)
    assert found.nis(method)
    assert found.lines() == []


WORSE, BETTER = SensorInfo(gnss_vel=0.01), SensorInfo(gnss_vel=4.0)


@pytest.mark.parametrize(
    ("method", "sensors", "words"),
    [
        ("ins21", WORSE, "right is 1: late, disturbed, or worse than [sensors] says"),
        ("ins21", BETTER, "right is 1: better than [sensors] says"),
        ("ins-cal", BETTER, "right is 1: better than [sensors] says"),
    ],
)
def test_a_receiver_that_is_worse_or_better_than_stated(
    block: Any, method: str, sensors: SensorInfo, words: str
) -> None:
    lines = outcome(method, block, sensors).lines()
    assert [x for x in lines if x.startswith(f"check: {method}: NIS of GNSS velocity ") and words in x], lines


def test_a_receiver_that_is_worse_than_stated_beside_other_checks(block: Any) -> None:
    lines = outcome("ins21", block, WORSE).lines(suspected=True)
    assert [x for x in lines if x.endswith("right is 1: first mend what the checks above name")] == lines


def test_a_navigator_that_learns_the_noise_of_its_receiver_is_silent(block: Any) -> None:
    """`ins-cal` multiplies the velocity's sigma as its innovations ask for: five times are no news then."""
    found = outcome("ins-cal", block, WORSE)
    assert found.lines() == []
    assert 0.5 < found.nis("ins-cal")["gnss.vel_n"] < 2.0


def test_a_disturbed_magnetometer_is_the_one_that_is_named(block: Any) -> None:
    rng = np.random.default_rng(4)
    mag = block["mag"]
    wild = dataclasses.replace(mag, mag_b=mag.mag_b + np.repeat(rng.normal(0, 1.5e-5, (120, 3)), 100, axis=0))
    (line,) = outcome("ins-cal", {**block, "mag": wild}).lines()
    assert re.fullmatch(
        r"check: ins-cal: magnetometer given up: motion contradicts its heading, \d\d+ % of the time", line
    )


def test_noise_of_the_ground_in_motion() -> None:
    """The papers' filters state the noise of a standing vehicle: one line, of all their sensors."""
    m, rng = motion(100.0, still=25.0), np.random.default_rng(5)
    gyro, accel = m.gyro_b + rng.normal(0, 2e-3, m.gyro_b.shape), m.accel_b + rng.normal(0, 0.03, m.accel_b.shape)
    accel[m.t > 25.0] += rng.normal(0, 0.5, (int(np.sum(m.t > 25.0)), 3))  # shaken as it moves
    block = {
        "imu": records(ImuRecord, m.t, gyro_b=gyro, accel_b=accel),
        "mag": records(MagRecord, m.t, mag_b=m.mag_b + rng.normal(0, 3e-7, m.mag_b.shape)),
    }
    (line,) = outcome("marg-ekf", block).lines()
    assert "accelerometer" in line
    assert line.endswith('noise as of the standing vehicle is too small in motion: noise = "practical"')
    assert outcome("hand-ins", block).lines() == []


def test_an_estimator_without_its_aid() -> None:
    imu, gnss, air = {"imu", "mag"}, {"fix", "velocity"}, {"diff_pressure"}

    def lines(kinds: set[str], *components: Component) -> list[str]:
        return checks.unaided(components, kinds)

    for method, words in (("ins21", "GNSS velocity"), ("ins-cal", "GNSS velocity"), ("ins9-ukf", "GNSS velocity"),
                          ("air-ins", "airspeed")):  # fmt: skip
        (line,) = lines(imu, component(method))
        assert f"{method} is aided by {words}, which is not in this recording" in line
    both = component("ins21", aiding="gnss+airspeed")
    assert "GNSS velocity and airspeed" in lines(imu, both)[0]
    assert "by airspeed," in lines(imu | gnss, both)[0]
    assert "by airspeed," in lines(imu | gnss, component("marg-ekf", aiding="airspeed"))[0]
    everything = imu | gnss | air
    for quiet in ("ins21", "ins-cal", "air-ins", "hand-ins", "marg-ekf", "fakf", "somebody:Mine"):
        assert lines(everything, component(quiet)) == []
    for quiet in ("hand-ins", "marg-ekf"):
        assert lines(imu, component(quiet)) == []
    assert "nothing that measures heading" in lines(gnss | air, component("air-ins"))[0]
    assert lines(gnss, component("ins21")) == []


@pytest.mark.parametrize(("seconds", "aligned"), [(0.7, None), (2.5, 1.0), (12.0, 3.0), (20.5, 6.0), (23.0, 20.0)])
def test_a_recording_that_only_stands(
    tmp_path: File, capsys: pytest.CaptureFixture[str], seconds: float, aligned: float | None
) -> None:
    """Shorter than the alignment takes: an attitude after a third of it, or a line that says why there is none."""
    m = motion(seconds, still=100.0)
    rng = np.random.default_rng(1)
    m = m._replace(
        gyro_b=m.gyro_b + rng.normal(0, 1e-3, m.gyro_b.shape),
        accel_b=m.accel_b + rng.normal(0, 0.02, m.accel_b.shape),
        mag_b=m.mag_b + rng.normal(0, 1e-7, m.mag_b.shape),
    )
    write_bag(tmp_path / "a.mcap", m, with_place=False)
    (tmp_path / "m.toml").write_text("[topics]\nvelocity = ''\ndiff_pressure = ''\nreference = ''\n")
    out = tmp_path / "o.mcap"
    arguments = ["--map", str(tmp_path / "m.toml"), "--estimator", "marg-ekf", "-o", str(out)]
    assert main(["replay", str(tmp_path / "a.mcap"), *arguments]) == 0
    text = capsys.readouterr().out
    assert ("marg-ekf: align_s = " in text) == (seconds < 21.0)
    assert ("no attitude: never aligned in" in text) == (aligned is None)
    if aligned is None:
        return
    from ahrs_sim.log.flight_reader import FlightReader

    with FlightReader(out) as log:
        e = log.estimates("marg-ekf")
    known = np.flatnonzero(np.isfinite(e.q_nb).all(axis=1))
    assert e.t[known[0]] == pytest.approx(aligned, abs=0.05)
    sigma = np.degrees(np.sqrt(np.trace(e.att_cov[known[0]]) / 3))
    assert 0.1 < sigma < 3.0
