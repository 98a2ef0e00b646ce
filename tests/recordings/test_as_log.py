"""What `info`, `allan` and `export` make of other people's recordings, and of stamps that are not even."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bag_helpers import EPOCH, motion
from dataflash_helpers import write_dataflash
from test_tables import MAP, frame, phyphox
from ulog_helpers import inertial, magnetometer, write

from ahrs_sim.cli import main
from ahrs_sim.errors import InputError
from ahrs_sim.log.mcap.writer import LogWriter
from ahrs_sim.review.allan import evenly, of_log

DENSITY = np.radians(0.01)  # rad/s/sqrt(Hz)


def noise(n: int, rate: float) -> np.ndarray:
    return np.random.default_rng(7).normal(0.0, DENSITY * np.sqrt(rate / 2), (n, 3))


def test_info_allan_and_export_read_what_replay_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    m = motion(30.0)
    m = m._replace(gyro_b=m.gyro_b + 1e-4 * noise(len(m.t), 100.0))
    write_dataflash(tmp_path / "a.bin", m)
    write(tmp_path / "a.ulg", inertial(m), magnetometer(m))
    frame(m).to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "m.toml").write_text(MAP)
    phyphox(tmp_path / "phone", m)
    for name, topic, kind in (("a.bin", "IMU", "ArduPilot DataFlash"), ("a.ulg", "sensor_combined", "PX4 ULog"),
                              ("a.csv", "imu", "table of text"), ("phone", "imu/gyro", "table of text")):  # fmt: skip
        options = ["--map", str(tmp_path / "m.toml")] if name == "a.csv" else []
        path = str(tmp_path / name)
        assert main(["info", path, *options]) == 0
        out = capsys.readouterr().out
        assert kind in out
        assert any(line.startswith(topic + " ") and "3000" in line for line in out.splitlines())
        assert main(["allan", path, "--topic", topic, "--json", *options]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found[0]["rate_hz"] == pytest.approx(100.0, rel=1e-4)
        assert main(["export", path, "--to", "csv", "-o", str(tmp_path / f"{name}.out"), *options]) == 0
        capsys.readouterr()
        table = pd.read_csv(tmp_path / f"{name}.out" / f"{topic.replace('/', '_')}.csv")
        np.testing.assert_allclose(table["t"], m.t, atol=1e-6)
        if name != "phone":  # its axes are its own
            np.testing.assert_allclose(table["angular_velocity.x"], m.gyro_b[:, 0], atol=1e-6)
        assert main(["compare", path]) == 2
        assert "ahrs-sim replay" in capsys.readouterr().err
    assert main(["info", str(tmp_path / "a.bin"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["start_ns"] == pytest.approx(EPOCH, abs=2_000_000)


def bag(path: Path, t: np.ndarray, stamp: np.ndarray, values: np.ndarray) -> None:
    with LogWriter(path, epoch_ns=EPOCH, force=True) as log:
        channel = log.add_channel("/imu", "sensor_msgs/msg/Imu", frame_id="imu")
        log.start()
        arrival = EPOCH + np.rint(t * 1e9).astype(np.int64)
        log.write(channel, arrival, stamp, angular_velocity=values, linear_acceleration=values + np.array([0, 0, 9.8]))


N, RATE = 30000, 100.0
EVEN = EPOCH + np.rint(np.arange(N) / RATE * 1e9).astype(np.int64)


def stamped(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log times, stamps, and which samples they are, of a recording with one thing wrong."""
    rows = np.arange(N)
    rng = np.random.default_rng(3)
    if kind == "late":  # by up to 40 ms
        rows = np.argsort(rows + rng.uniform(0, 4, N), kind="stable")
    if kind == "lost":
        rows = np.delete(rows, np.r_[7000:7003, 20000])
    if kind == "lost under jitter":
        rows = np.delete(rows, np.r_[7000:7003])
    if kind == "twice":
        rows = np.sort(np.r_[rows, rows[5000:5100]])
    stamps = EVEN[rows].copy()
    if kind == "zero":
        stamps[:] = 0
    if kind == "back":  # by more than a sample, less than tells another clock
        stamps[N // 3 :] -= 5 * 10**9
    if kind == "starts anew":
        stamps[N // 2 :] -= 150 * 10**9
    if kind in ("jitter", "lost under jitter"):
        stamps += rng.normal(0.0, 3e6, len(stamps)).astype(np.int64)
    if kind == "coarse":  # ten samples of one stamp
        stamps = stamps // 10**8 * 10**8
    if kind == "seconds":
        stamps = stamps // 10**9 * 10**9
    return np.sort(EVEN[rows]) if kind != "late" else EVEN, stamps, rows


@pytest.mark.parametrize(
    ("kind", "words", "least"),
    [
        ("even", "", N),
        ("late", "came late", N),
        ("lost", "2 gaps, 4 samples lost in them, the longest even stretch is 12997 of 29996 samples", 12997),
        ("lost under jitter", "1 gaps, ", 22997),
        ("twice", "100 came twice", N),
        ("zero", "stamps are of another clock", N),
        ("back", "the clock steps back 1 times, first by 4.99 s", N // 3 * 2),
        ("starts anew", "another clock", N),
        ("jitter", "", N),
        ("coarse", "stamps repeat or stand still", N - 10),
        ("seconds", "stamps repeat or stand still", N - 10),
    ],
)
def test_rate_and_density_stay_right(tmp_path: Path, kind: str, words: str, least: int) -> None:
    log, stamp, rows = stamped(kind)
    bag(tmp_path / "a.mcap", (log - EPOCH) / 1e9, stamp, noise(N, RATE)[rows])
    gyro = next(c for c in of_log(tmp_path / "a.mcap") if c.sensor == "gyro")
    assert words in gyro.left_out, gyro.left_out
    assert gyro.table.rate == pytest.approx(RATE, rel=1e-3)
    assert gyro.table.duration * RATE == pytest.approx(least, abs=15)
    np.testing.assert_allclose(gyro.table.density.value, DENSITY, rtol=0.03)


def test_it_refuses_what_is_not_even(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    stamps = np.sort(EPOCH + rng.integers(0, 300 * 10**9, 60))
    stamps[::15] += 10**11
    with pytest.raises(InputError, match=r"of 60 samples no stretch of 20 without gaps \(.*\); the Allan"):
        evenly(stamps, stamps, noise(60, RATE), "a")
    values = noise(100, RATE)
    values[::10] = np.nan
    with pytest.raises(InputError, match="10 samples without values"):
        evenly(EVEN[:100], EVEN[:100], values, "a")
    for few in (0, 1, 2, 19):
        with pytest.raises(InputError, match=f"of {few} samples"):
            evenly(EVEN[:few], EVEN[:few], noise(few, RATE), "a")
