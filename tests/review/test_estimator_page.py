"""The page of estimators for a browser: its programs, run by Node, against the command line on the same recordings."""

import json
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ahrs_sim.cli import main
from ahrs_sim.review import estimator_page
from ahrs_sim.review.export import export
from ahrs_sim.world import gravity, magnetic

sys.path.append(str(Path(__file__).parents[1] / "recordings"))
import ulog_helpers as ulogs
from bag_helpers import Motion, motion

NAMES = ["ekf-chr", "ins21-chr"]
pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="no Node")
linked = pytest.mark.skipif(find_spec("ziglang") is None, reason="no ziglang")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("page") / "try.html"
    chosen = [option for name in NAMES for option in ("--estimator", name)]
    assert main(["export-page", "-o", str(made), *chosen]) == 0
    return made


@pytest.fixture(scope="module")
def readers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page without estimators: what reads recordings, and refuses them."""
    made = tmp_path_factory.mktemp("readers") / "try.html"
    made.write_text(estimator_page._page({"estimators": [], "code": [], **estimator_page._known()}))
    return made


def dropped(page: Path, *files: Path) -> dict[str, Any]:
    ran = subprocess.run(
        ["node", Path(__file__).parent / "run_page.mjs", page, *files], capture_output=True, text=True, check=True
    )
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


def replayed(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["replay", *map(str, arguments), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)["estimators"]
    return found


def agree(found: dict[str, Any], wanted: dict[str, Any], names: dict[str, str], relative: float) -> None:
    assert set(found) == set(names)
    for name, other in names.items():
        for measure in ("roll", "pitch", "heading", "tilt", "total"):
            key = f"{measure}_rmse_deg"
            assert found[name][key] == pytest.approx(wanted[other][key], rel=relative, abs=1e-6), (name, key)
            assert found[name][key] > 0.001


@linked
@pytest.mark.long
def test_a_log_has_the_figures_of_the_command_line(page: Path, flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = dropped(page, flown)
    assert found["form"] == "log of ahrs_sim"
    wanted = replayed(capsys, flown, "--estimator", "ekf-chr")
    agree({"ekf-chr": found["estimators"]["ekf-chr"]}, wanted, {"ekf-chr": "ekf-chr"}, 1e-6)


@linked
@pytest.mark.long
def test_tables_have_the_figures_of_the_command_line(
    page: Path, flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "tables"
    topics = ["/chr/imu/data_raw", "/chr/imu/mag", "/chr/gps/fix", "/chr/gps/vel", "/chr/air/data", "/truth/odometry"]
    files = export(flown, "csv", folder, topics)
    assert pd.read_csv(files[0])["t"][0] < 0.0  # a sensor's clock is not that of the flight: both count from there
    found = dropped(page, *files)
    assert found["notes"][-1] == "its time is no date: magnetic field of 2027.5"
    (folder / "map.toml").write_text(MAP)
    options = ["--map", folder / "map.toml", "--calibrate", "none"]
    agree(found["estimators"], replayed(capsys, folder, *options), {"ekf": "ekf", "ins21": "ins21"}, 1e-4)


@linked
@pytest.mark.long
def test_a_ulog_has_the_figures_of_the_command_line(
    page: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng, m = np.random.default_rng(1), motion(90.0)
    noisy = Motion(
        m.t, m.q_nb, m.gyro_b + rng.normal(0, 0.003, m.gyro_b.shape) + 0.002,
        m.accel_b + rng.normal(0, 0.03, m.accel_b.shape), m.mag_b + rng.normal(0, 2e-7, m.mag_b.shape),
    )  # fmt: skip
    still = {"vel_n_m_s": 0.01, "vel_e_m_s": 0.02, "vel_d_m_s": 0.0}
    path = ulogs.write(
        tmp_path / "flight.ulg", ulogs.inertial(noisy), ulogs.magnetometer(noisy), ulogs.receiver(noisy, **still),
        ulogs.attitude(m),
    )  # fmt: skip
    (tmp_path / "map.toml").write_text('[estimator.ekf]\nmethod = "marg-ekf"\n' + INS21)
    wanted = replayed(capsys, path, "--map", tmp_path / "map.toml", "--calibrate", "none")
    found = dropped(page, path)
    assert found["form"] == "ULog"
    assert found["notes"][:2] == ["imu: sensor_combined, 9000 messages", "mag: vehicle_magnetometer, 4500 messages"]
    agree(found["estimators"], wanted, {"ekf": "ekf", "ins21": "ins21"}, 1e-4)


INS21 = '[estimator.ins21]\nmethod = "ins21"\nheading_aid = false\n'
MAP = (
    """
[csv]
time = {column = "t", unit = "s"}
[csv.imu]
file = "chr_imu_data_raw.csv"
gyro = {columns = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"], unit = "rad/s"}
accel = {columns = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"], unit = "m/s2"}
[csv.mag]
file = "chr_imu_mag.csv"
field = {columns = ["magnetic_field.x", "magnetic_field.y", "magnetic_field.z"], unit = "T"}
[csv.fix]
file = "chr_gps_fix.csv"
latitude = {columns = ["latitude"]}
longitude = {columns = ["longitude"]}
altitude = {columns = ["altitude"]}
[csv.velocity]
file = "chr_gps_vel.csv"
velocity = {columns = ["twist.linear.x", "twist.linear.y", "twist.linear.z"], unit = "m/s"}
[csv.air]
file = "chr_air_data.csv"
airspeed = {columns = ["airspeed"], unit = "m/s"}
[csv.reference]
file = "truth_odometry.csv"
quaternion = {columns = ["pose.pose.orientation.w", "pose.pose.orientation.x", "pose.pose.orientation.y", "pose.pose.orientation.z"]}
[estimator.ekf]
method = "marg-ekf"
"""  # noqa: E501
    + INS21
)
IMU = "t (s),gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
ROWS = "".join(f"\n{0.01 * i:.2f},0,0,0.{i % 2},0,0,-9.81" for i in range(300))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.mcap", b"\x89MCAP0\r\n" + bytes(100), "a.mcap: not finished or cut off: mend it with 'ahrs-sim recover'"),
        ("a.mcap", b"\x89MCAP0\r\n", "a.mcap: not finished or cut off"),
        ("a.bin", bytes(range(200)), "a.bin: not a log of ahrs_sim (.mcap), a ULog (.ulg) or a table of text (.csv)"),
        (
            "a.ulg",
            ulogs.HEADER,
            "a.ulg: no sensor_combined in it; 'ahrs-sim replay' reads logs",
        ),
        ("a.csv", b"hello", "a.csv: no rows under a header"),
        ("a.csv", IMU.replace("t (s)", "when").encode() + ROWS.encode(), "a.csv: no column for the time"),
        ("a.csv", IMU.replace("gyro_z", "turn").encode() + ROWS.encode(), "no columns of an IMU in a.csv"),
        ("a.csv", IMU.replace("accel_x", "accel_x (furlong)").encode() + ROWS.encode(), "unit 'furlong' is not known"),
        ("a.csv", IMU.replace("gyro_x", "gyro_x (uT)").encode() + ROWS.encode(), "uT is no unit of this column"),
        ("a.csv", (IMU + ROWS).replace("-9.81", "-1.0").encode(), "the accelerometer reads 1.00 m/s2 in the median"),
    ],
)
def test_what_cannot_be_read_is_one_line(readers: Path, tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    refused = dropped(readers, tmp_path / name)["refused"]
    assert words in refused
    assert "\n" not in refused


def test_a_bag_of_others_is_refused(readers: Path, tmp_path: Path) -> None:
    from ahrs_sim.log.mcap.writer import LogWriter

    with LogWriter(tmp_path / "bag.mcap", epoch_ns=0) as log:
        channel = log.add_channel("/imu/data_raw", "sensor_msgs/msg/Imu")
        log.start()
        log.write(channel, np.arange(10) * 10**7, np.arange(10) * 10**7)
    assert "bag.mcap: not a log of ahrs_sim" in dropped(readers, tmp_path / "bag.mcap")["refused"]


def test_units_of_a_header_count_and_gravity_and_field_are_those_of_the_place(readers: Path, tmp_path: Path) -> None:
    head = "time [ms];gx (deg/s);gy (deg/s);gz (deg/s);ax (g);ay (g);az (g);mx (uT);my (uT);mz (uT);lat;lon;alt"
    rows = "".join(f"\n{10 * i};0;0;{i % 2};0;0;-1;20;0;40;43.57;1.47;150" for i in range(300))
    (tmp_path / "a.csv").write_text(head + rows)
    site = dropped(readers, tmp_path / "a.csv")["site"]
    lla = np.array([[np.radians(43.57), np.radians(1.47), 150.0]])
    assert site["gravity"] == pytest.approx(float(gravity.normal_gravity(lla)[0]), abs=1e-12)
    np.testing.assert_allclose(site["mag_n"], magnetic.wmm(lla, 2027.5)[0], atol=1e-12)


def test_the_page_connects_to_nothing(readers: Path) -> None:
    text = readers.read_text()
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy.startswith("default-src 'none'; script-src 'wasm-unsafe-eval' 'sha256-")
    assert "http" not in re.sub(r"/\*.*?\*/", "", policy)
    assert not re.findall(r"<(?:link|img|script|iframe)[^>]+(?:src|href)=\"(?!data:)", text)
    assert not re.findall(r"\b(fetch|XMLHttpRequest|WebSocket|sendBeacon|EventSource)\b", text)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "nowhere"),
        (["--estimator", "vqf@chr"], "vqf comes from another package"),
        (["--estimator", "marg-efk@chr"], "did you mean 'marg-ekf'?"),
    ],
)
def test_what_cannot_go_into_a_page_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    if find_spec("ziglang") is None:
        words = "needs a linker for WebAssembly: pip install 'ahrs-sim[cross]'"
    assert main(["export-page", *arguments, "-o", str(tmp_path / "try.html")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "try.html").exists()
