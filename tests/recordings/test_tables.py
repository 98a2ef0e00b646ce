"""Tables of text: dialects, several files, times in any form, and a line for what cannot be."""

import csv
import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from bag_helpers import EPOCH, LLA, Motion, motion

from ahrs_sim.errors import InputError
from ahrs_sim.recordings import presets
from ahrs_sim.recordings.recording import open_bag
from ahrs_sim.recordings.sources.base import DATES_FROM_NS
from ahrs_sim.recordings.sources.tables import Csv
from ahrs_sim.scenario.table import read_toml
from ahrs_sim.sensors.assemble import Assembler
from estimators.types import Samples

MAP = """
[csv]
time = {column = "time", unit = "s"}
[csv.imu]
gyro = {columns = ["gx", "gy", "gz"], unit = "rad/s"}
accel = {columns = ["ax", "ay", "az"], unit = "m/s2"}
"""


@pytest.fixture(scope="module")
def moving() -> Motion:
    return motion(30.0, still=5.0)


def frame(m: Motion, epoch: float = EPOCH / 1e9) -> pd.DataFrame:
    names = ["time", "gx", "gy", "gz", "ax", "ay", "az"]
    return pd.DataFrame(np.column_stack([epoch + m.t, m.gyro_b, m.accel_b]), columns=names)


def samples_of(path: Path, text: str | None = MAP) -> tuple[Samples, list[str]]:
    map_file = None
    if text is not None and not text.startswith("preset:"):
        map_file = path.parent / "map.toml"
        map_file.write_text(text)
    elif text is not None:
        map_file = Path(text)
    with open_bag(path, map_file=map_file) as bag:
        assembler = Assembler()
        return Samples.concatenate([assembler.assemble(block["bag"]) for block in bag.blocks()]), bag.notes


def check(s: Samples, m: Motion, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(s.t, m.t - m.t[0], atol=1e-6)
    np.testing.assert_allclose(s.gyro_b, m.gyro_b, atol=atol)
    np.testing.assert_allclose(s.accel_b, m.accel_b, atol=10 * atol)


def iso(m: Motion) -> list[str]:
    first = datetime.datetime(2026, 6, 1, 10)
    return [(first + datetime.timedelta(seconds=float(t))).isoformat(timespec="milliseconds") + "Z" for t in m.t]


def test_dialects_give_the_same_samples(tmp_path: Path, moving: Motion) -> None:
    f = frame(moving)
    f.to_csv(tmp_path / "comma.csv", index=False, sep=";", decimal=",")
    f.to_csv(tmp_path / "tab.txt", index=False, sep="\t")
    f.to_csv(tmp_path / "blank.dat", index=False, sep=" ")
    f.assign(time=iso(moving)).to_csv(tmp_path / "iso.csv", index=False)
    f.assign(**{"Temp [°C]": 21.5}).to_csv(tmp_path / "cp1252.csv", index=False, encoding="cp1252")
    f.to_csv(tmp_path / "utf16.csv", index=False, encoding="utf-16")
    head = "// Start Time: Unknown\n// Update Rate: 100.0Hz\n"
    (tmp_path / "comments.csv").write_text(head + f.to_csv(index=False))
    (tmp_path / "preamble.csv").write_text("My logger\nserial,7\n\n" + f.to_csv(index=False))
    (tmp_path / "hash.csv").write_text("#" + f.to_csv(index=False))
    (tmp_path / "crlf.csv").write_bytes(f.to_csv(index=False, lineterminator="\r\n").encode())
    (tmp_path / "cr.csv").write_bytes(f.to_csv(index=False, lineterminator="\r").encode())
    quoted = f.assign(**{"note, of the day": "a, b"})
    quoted.to_csv(tmp_path / "quotes.csv", index=False, quoting=csv.QUOTE_ALL)
    f.to_csv(tmp_path / "quoted_comma.csv", index=False, sep=";", decimal=",", quoting=csv.QUOTE_ALL)
    for path in sorted(tmp_path.glob("*.*")):
        s, _ = samples_of(path)
        check(s, moving)
    assert any("read as cp1252" in note for note in samples_of(tmp_path / "cp1252.csv")[1])


def test_keys_of_the_map_decide(tmp_path: Path, moving: Motion) -> None:
    text = frame(moving).to_csv(index=False, sep=";", decimal=",").replace("\n", "\n! note\n", 3)
    (tmp_path / "a.csv").write_text("a;b\nc;d\n" + text, encoding="utf-8")
    keys = 'separator = ";"\ndecimal = ","\nencoding = "utf-8"\nskip_rows = 2\ncomment = "!"\n'
    check(samples_of(tmp_path / "a.csv", MAP.replace("[csv]\n", f"[csv]\n{keys}"))[0], moving)
    with pytest.raises(InputError, match="encoding 'klingon' is not known"):
        samples_of(tmp_path / "a.csv", MAP.replace("[csv]\n", '[csv]\nencoding = "klingon"\n'))


def test_units_of_the_header(tmp_path: Path, moving: Motion) -> None:
    f = frame(moving)
    f[["gx", "gy", "gz"]] = np.degrees(f[["gx", "gy", "gz"]])
    f[["ax", "ay", "az"]] /= 9.80665
    f["time"] = ((f["time"] - EPOCH / 1e9) * 1e3).round(3)
    names = ["time", *(["gx", "gy", "gz"]), *(["ax", "ay", "az"])]
    units = ["ms", *["°/s"] * 3, *["g"] * 3]
    bare = MAP.replace(', unit = "s"', "").replace(', unit = "rad/s"', "").replace(', unit = "m/s2"', "")
    f.columns = pd.Index([f"{n} [{u}]" for n, u in zip(names, units, strict=True)])
    f.to_csv(tmp_path / "brackets.csv", index=False)
    check(samples_of(tmp_path / "brackets.csv", bare)[0], moving, 1e-8)
    f.columns = pd.Index(names)
    lines = f.to_csv(index=False).split("\n", 1)
    (tmp_path / "second.csv").write_text(lines[0] + "\n" + ",".join(f"({u})" for u in units) + "\n" + lines[1])
    check(samples_of(tmp_path / "second.csv", bare)[0], moving, 1e-8)
    _, notes = samples_of(tmp_path / "second.csv", bare.replace('"gz"]', '"gz"], unit = "rad/s"'))
    assert any("unit is rad/s by the map, deg/s by its header" in note for note in notes)
    f.to_csv(tmp_path / "none.csv", index=False)
    spelt = bare.replace('"gz"]', '"gz"], unit = "dps"').replace('"az"]', '"az"], unit = "g"')
    check(samples_of(tmp_path / "none.csv", spelt.replace('"time"', '"time", unit = "ms"'))[0], moving, 1e-8)
    with pytest.raises(InputError, match="unit: missing"):
        samples_of(tmp_path / "none.csv", bare)


def test_units_of_the_header_that_are_none(tmp_path: Path, moving: Motion) -> None:
    """What is known is taken at its word; what is not is named, and never taken for something else in silence."""
    bare, path, f = MAP.replace(', unit = "s"', ""), tmp_path / "a.csv", frame(moving)
    seconds = f["time"] - EPOCH / 1e9
    f.assign(time=seconds / 60).rename(columns={"time": "time (min)"}).to_csv(path, index=False)
    check(samples_of(path, bare)[0], moving)
    f.rename(columns={"time": "time (fortnights)"}).to_csv(path, index=False)
    assert any(
        "time: 'fortnights' of the header is no unit known here, taken as s" in n for n in samples_of(path, bare)[1]
    )
    f.rename(columns={"time": "time (ms)"}).to_csv(path, index=False)
    assert any("time: unit is s by the map, ms by its header" in note for note in samples_of(path)[1])
    f.assign(time=seconds * 1e4).to_csv(path, index=False)
    with pytest.raises(InputError, match=r"less than once a second, too seldom .* is the unit of their times right"):
        samples_of(path)
    fixes = '[csv.fix]\nlatitude = {columns = ["lat"]}\nlongitude = {columns = ["lon"]}\naltitude = {columns = ["h"]}\n'
    (tmp_path / "map.toml").write_text(MAP + fixes)
    f.assign(lat=LLA[0], lon=LLA[1], **{"h (ft)": 1000.0}).to_csv(path, index=False)
    with open_bag(path, map_file=tmp_path / "map.toml") as bag:
        assert bag.site.lla[2] == pytest.approx(304.8)
    f.assign(lat=LLA[0], lon=LLA[1], **{"h (fathoms)": 1000.0}).to_csv(path, index=False)
    _, notes = samples_of(path, MAP + fixes)
    assert any("h: 'fathoms' of the header is no unit known here, taken as m" in note for note in notes)


@pytest.mark.parametrize(
    ("columns", "time"),
    [
        ({"week": 2421, "tow": lambda m: 122418.0 + m.t}, 'week = "week", seconds = "tow"'),
        ({"ticks": lambda m: np.rint(m.t * 1e4)}, 'column = "ticks", unit = 1e-4'),
        ({"ticks": lambda m: np.rint(m.t * 1e4) % 65536}, 'column = "ticks", unit = 1e-4, wraps_at = 65536.0'),
        ({"us": lambda m: np.rint(m.t * 1e6).astype(int)}, 'column = "us", unit = "us"'),
        (
            {"Y": 2026, "M": 6, "D": 1, "h": 10, "m": 0, "s": lambda m: m.t},
            'year = "Y", month = "M", day = "D", hour = "h", minute = "m", second = "s"',
        ),
        (
            {"at": lambda m: [f"01.06.2026 10:00:{t:09.6f}" for t in m.t]},
            'column = "at", format = "%d.%m.%Y %H:%M:%S.%f"',
        ),
    ],
)
def test_times_in_any_form(tmp_path: Path, moving: Motion, columns: dict[str, Any], time: str) -> None:
    f = frame(moving).drop(columns="time")
    for name, value in columns.items():
        f[name] = value(moving) if callable(value) else value
    f.to_csv(tmp_path / "a.csv", index=False)
    text = MAP.replace('column = "time", unit = "s"', time)
    check(samples_of(tmp_path / "a.csv", text)[0], moving)
    (tmp_path / "map.toml").write_text(text)
    source = Csv(tmp_path / "a.csv", read_toml(tmp_path / "map.toml").table("csv"))
    dated = "ticks" not in columns and "us" not in columns
    assert (source.epoch_ns > DATES_FROM_NS) == dated
    if dated:
        assert source.epoch_ns == pytest.approx(EPOCH, abs=1000)


def test_times_of_a_day_and_from_a_trigger_on(tmp_path: Path, moving: Motion) -> None:
    """Over midnight, with a decimal comma beside dates with points, and negative before the trigger."""
    f = frame(moving)
    late = [datetime.datetime(2026, 6, 1, 23, 59, 50) + datetime.timedelta(seconds=float(t)) for t in moving.t]
    f.assign(time=[f"{t:%H:%M:%S.%f}" for t in late]).to_csv(tmp_path / "a.csv", index=False)
    check(samples_of(tmp_path / "a.csv")[0], moving)
    dates = [f"{t:%d.%m.%Y %H:%M:%S,%f}" for t in late]
    f.assign(time=dates).to_csv(tmp_path / "a.csv", index=False, sep=";", decimal=",")
    form = MAP.replace('unit = "s"', 'format = "%d.%m.%Y %H:%M:%S,%f"')
    check(samples_of(tmp_path / "a.csv", form)[0], moving)
    f.assign(time=moving.t - 5.0).to_csv(tmp_path / "a.csv", index=False)
    s, notes = samples_of(tmp_path / "a.csv")
    check(s, moving)
    assert any("its times start at -5 s: counted from there" in note for note in notes)
    f.assign(time=46174.4 + moving.t / 86400).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match=r"nor end after .* is their unit right"):
        samples_of(tmp_path / "a.csv", MAP.replace('"s"', "86400"))


def test_each_lost_value_is_named(tmp_path: Path, moving: Motion) -> None:
    f = frame(moving).astype(object)
    f.loc[1000, "gx"] = "ERR"
    f.to_csv(tmp_path / "a.csv", index=False)
    s, notes = samples_of(tmp_path / "a.csv")
    assert len(s) == len(moving.t) - 1
    assert any("gx: 1 value is no number, the first in row 1002: 'ERR'" in note for note in notes)
    text = frame(moving).to_csv(index=False).splitlines()
    text[500] += ",1,2,3"
    (tmp_path / "b.csv").write_text("\n".join(text))
    s, notes = samples_of(tmp_path / "b.csv")
    assert len(s) == len(moving.t) - 1
    assert any("1 rows with too many cells" in note for note in notes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.assign(time=[f"{x:.6g}" for x in f["time"]]), "time: 3000 rows, 1 different times"),
        (lambda f: f.assign(time=[f"{x:.10g}" for x in f["time"]]), "time: 3000 rows, 31 different times"),
        (lambda f: f.assign(time="noon"), "time: no number in row 2: 'noon'"),
        (lambda f: f.assign(gx="-"), "gx: no number in row 2: '-'"),
        (lambda f: f.assign(gx=np.nan), "imu: no row has all of its columns"),
        (lambda f: f.drop(columns="gx"), "no column 'gx'"),
        (lambda f: f.iloc[:0], "no rows under"),
    ],
)
def test_what_cannot_be_is_one_line(tmp_path: Path, moving: Motion, change: Any, words: str) -> None:
    change(frame(moving)).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError) as caught:
        samples_of(tmp_path / "a.csv")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_rows_that_go_back(tmp_path: Path, moving: Motion) -> None:
    f = frame(moving, 1000.0)
    f.iloc[::-1].to_csv(tmp_path / "down.csv", index=False)
    s, notes = samples_of(tmp_path / "down.csv")
    check(s, moving)
    assert any("from the last to the first" in note for note in notes)
    short = f.iloc[:1000].assign(time=f["time"][:1000] - 300)
    pd.concat([f, short]).to_csv(tmp_path / "twice.csv", index=False)
    s, notes = samples_of(tmp_path / "twice.csv")
    check(s, moving)
    assert any(
        "time goes back by 329.99 s in row 3002: of the 2 parts the longest is used, rows 2 to 3001" in n for n in notes
    )
    # fixes in the second part only are not those of the first
    fixes = '[csv.fix]\nlatitude = {columns = ["lat"]}\nlongitude = {columns = ["lon"]}\naltitude = {columns = ["h"]}\n'
    both = pd.concat([f.assign(lat=np.nan), short.assign(lat=LLA[0])]).assign(lon=LLA[1], h=100.0)
    both.to_csv(tmp_path / "twice.csv", index=False)
    with pytest.raises(InputError, match="no row of fix is in rows 2 to 3001, the longest part"):
        samples_of(tmp_path / "twice.csv", MAP + fixes)
    for part, name in (
        (["time", "gx", "gy", "gz", "ax", "ay", "az"], "imu.csv"),
        (["time", "lat", "lon", "h"], "fix.csv"),
    ):
        both.assign(lat=LLA[0])[part].to_csv(tmp_path / name, index=False)
    text = MAP.replace("[csv.imu]", '[csv.imu]\nfile = "imu.csv"') + fixes.replace("fix]", 'fix]\nfile = "fix.csv"')
    with pytest.raises(InputError, match=r"time goes back .* of several files each has to be one part"):
        samples_of(tmp_path, text)
    pd.concat([short.iloc[i : i + 50][::1] for i in range(950, 0, -50)]).to_csv(tmp_path / "many.csv", index=False)
    pd.concat([f.iloc[i : i + 150] for i in range(2800, 0, -150)]).to_csv(tmp_path / "many.csv", index=False)
    with pytest.raises(InputError, match="times more; sort the rows"):
        samples_of(tmp_path / "many.csv")


def test_gyro_and_accelerometer_in_rows_of_their_own(tmp_path: Path, moving: Motion) -> None:
    m = moving
    gyro = pd.DataFrame({"time": m.t, "gx": m.gyro_b[:, 0], "gy": m.gyro_b[:, 1], "gz": m.gyro_b[:, 2]})
    accel = pd.DataFrame({"time": m.t + 0.002, "ax": m.accel_b[:, 0], "ay": m.accel_b[:, 1], "az": m.accel_b[:, 2]})
    pd.concat([gyro, accel]).sort_values("time").to_csv(tmp_path / "a.csv", index=False)
    s, notes = samples_of(tmp_path / "a.csv")
    assert any(note.startswith("accel           imu/accel") for note in notes)
    assert len(s) == len(m.t) - 1  # before the first acceleration there is none
    np.testing.assert_allclose(s.gyro_b, m.gyro_b[1:], atol=1e-9)
    there = np.column_stack([np.interp(m.t[1:], m.t + 0.002, column) for column in m.accel_b.T])
    np.testing.assert_allclose(s.accel_b, there, atol=1e-9)


def test_a_slower_column_counts_once(tmp_path: Path, moving: Motion) -> None:
    f = frame(moving)
    for i, name in enumerate(("mx", "my", "mz")):
        f[name] = np.repeat(moving.mag_b[::5, i] + 1e-12 * np.arange(len(moving.t) // 5), 5) * 1e6
    f["lat"] = np.repeat(LLA[0] + 1e-6 * np.arange(len(moving.t) // 100), 100)
    f["lon"], f["fixed"] = LLA[1], np.where(moving.t < 10, 0, 3)
    f.to_csv(tmp_path / "a.csv", index=False)
    text = (
        MAP
        + """
        [csv.mag]
        field = {columns = ["mx", "my", "mz"], unit = "uT"}
        [csv.fix]
        latitude = {columns = ["lat"]}
        longitude = {columns = ["lon"]}
        status = {columns = ["fixed"]}
        """
    )
    s, _ = samples_of(tmp_path / "a.csv", text)
    assert s.mag_new.sum() == len(moving.t) // 5
    assert (s.gnss_new & np.isfinite(s.lla[:, 0])).sum() == 20  # one a second, none before there was a fix


# ----------------------------------------------------------------------------------------------- ready-made maps


def write(path: Path, columns: dict[str, Any], before: str = "", **options: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(before + pd.DataFrame(columns).to_csv(index=False, **options), encoding="utf-8")


def xyz(names: str | list[str], values: np.ndarray) -> dict[str, np.ndarray]:
    labels = [names.format(a) for a in "xyz"] if isinstance(names, str) else names
    return dict(zip(labels, values.T, strict=True))


def flu(values: np.ndarray) -> np.ndarray:
    return values * [1, -1, -1]


def phone(values: np.ndarray) -> np.ndarray:
    """In the axes of a phone whose top points forward: right, forward, up."""
    return values[:, [1, 0, 2]] * [1, 1, -1]


def sensor_logger(folder: Path, m: Motion) -> Path:
    time = {"time": EPOCH + np.rint(m.t * 1e9).astype(np.int64), "seconds_elapsed": m.t}
    for name, values in (("Gyroscope", m.gyro_b), ("TotalAcceleration", m.accel_b), ("Magnetometer", m.mag_b * 1e6)):
        write(folder / f"{name}.csv", {**time, **dict(reversed(xyz("{}", phone(values)).items()))})
    write(folder / "Location.csv", {"time": time["time"][::100], "latitude": LLA[0], "longitude": LLA[1],
                                    "altitude": LLA[2], "speed": 0.0})  # fmt: skip
    return folder


def sensor_logger_ios(folder: Path, m: Motion) -> Path:
    sensor_logger(folder, m._replace(accel_b=-m.accel_b))
    (folder / "Magnetometer.csv").unlink()
    return folder


def phyphox(folder: Path, m: Motion) -> Path:
    for name, unit, values in (("Gyroscope", "rad/s", m.gyro_b), ("Accelerometer", "m/s^2", m.accel_b),
                               ("Magnetometer", "µT", m.mag_b * 1e6)):  # fmt: skip
        labels = [f"{axis} ({unit})" for axis in "XYZ"]
        write(folder / f"{name}.csv", {"Time (s)": m.t, **xyz(labels, phone(values))})
    write(folder / "Location.csv", {"Time (s)": m.t[::100], "Latitude (°)": LLA[0], "Longitude (°)": LLA[1],
                                    "Height (m)": LLA[2]})  # fmt: skip
    return folder


def mt_manager(folder: Path, m: Motion) -> Path:
    from ahrs_sim.attitude import euler, product

    # FLU against ENU from FRD against NED, and its angles
    half = np.array([[0.0, 0.5**0.5, 0.5**0.5, 0.0]])
    q = product(product(half * [1, -1, -1, -1], m.q_nb), np.array([[0.0, -1.0, 0.0, 0.0]]))
    angles = np.degrees(euler(q))
    columns = {"PacketCounter": np.arange(len(m.t)), "SampleTimeFine": np.rint(m.t * 1e4).astype(int) + 5,
               **xyz(["Acc_X", "Acc_Y", "Acc_Z"], flu(m.accel_b)), **xyz(["Gyr_X", "Gyr_Y", "Gyr_Z"], flu(m.gyro_b)),
               **xyz(["Mag_X", "Mag_Y", "Mag_Z"], flu(m.mag_b) / 4.9e-5),
               **xyz(["Roll", "Pitch", "Yaw"], angles)}  # fmt: skip
    head = "// General information: \n//  MT Manager version: 2022.2.0 \n// Coordinate system: ENU\n"
    write(folder / "MT_00B42D4F.txt", columns, head, sep="\t")
    return folder / "MT_00B42D4F.txt"


def control_center(folder: Path, m: Motion) -> Path:
    """The header as VectorNav's own exporter writes it: time, imu, gnss, attitude and ins groups."""
    from ahrs_sim.attitude import euler

    def named(names: str, values: np.ndarray) -> dict[str, np.ndarray]:
        return dict(zip(names.split(","), values.T, strict=True))

    place = np.tile(LLA, (len(m.t), 1))
    columns = {
        "TimeStartup": np.rint(m.t * 1e9).astype(np.int64) + 7,
        **named("MagX,MagY,MagZ", m.mag_b * 1e4),
        **named("AccelX,AccelY,AccelZ", m.accel_b),
        **named("GyroX,GyroY,GyroZ", m.gyro_b),
        **named("Gnss1Lat,Gnss1Lon,Gnss1Alt", place),
        **named("Gnss1VelN,Gnss1VelE,Gnss1VelD", np.zeros((len(m.t), 3))),
        **named("Yaw,Pitch,Roll", np.degrees(euler(m.q_nb))[:, ::-1]),
        **named("PosLat,PosLon,PosAlt", place + 1.0),  # of its filter: not what is wanted
    }
    write(folder / "vn300.csv", columns)
    return folder / "vn300.csv"


def sbg_center(folder: Path, m: Motion) -> Path:
    from ahrs_sim.attitude import euler

    us = np.rint(m.t * 1e6).astype(int)

    def log(name: str, units: str, columns: dict[str, Any]) -> None:
        text = pd.DataFrame({"timestamp": us, "status": 0, **columns}).to_csv(index=False, sep="\t")
        head, rest = text.split("\n", 1)
        (folder / name).write_text(f"{head}\n(us)\t(N/A)\t{units}\n{rest}", encoding="utf-8")

    folder.mkdir(parents=True, exist_ok=True)
    turn = xyz(["deltaAngleX", "deltaAngleY", "deltaAngleZ"], np.degrees(m.gyro_b))
    log("imuShort.txt", "\t".join(["(m.s^-2)"] * 3 + ["(deg.s^-1)"] * 3 + ["(°C)"]),
        {**xyz(["deltaVelX", "deltaVelY", "deltaVelZ"], m.accel_b), **turn, "temperature": 30.0})  # fmt: skip
    log("ekfEuler.txt", "\t".join(["(deg)"] * 3), xyz(["roll", "pitch", "yaw"], np.degrees(euler(m.q_nb))))
    log("gps1Vel.txt", "(m.s-1)\t(m.s-1)\t(m.s-1)", {"velN": m.t, "velE": 2.0, "velD": 3.0})
    return folder


def sensor_connect(folder: Path, m: Motion) -> Path:
    node = "inertial-6253.76535:"
    columns = {"Time": EPOCH + np.rint(m.t * 1e9).astype(np.int64),
               **xyz([f"{node}scaledAccel{a}" for a in "XYZ"], m.accel_b / 9.80665),
               **xyz([f"{node}scaledGyro{a}" for a in "XYZ"], m.gyro_b),
               **xyz([f"{node}scaledMag{a}" for a in "XYZ"], m.mag_b * 1e4)}  # fmt: skip
    write(folder / "SensorConnectData.csv", columns)
    return folder / "SensorConnectData.csv"


def euroc(folder: Path, m: Motion) -> Path:
    ns = EPOCH + np.rint(m.t * 1e9).astype(np.int64)
    gyro = xyz([f"w_RS_S_{a} [rad s^-1]" for a in "xyz"], flu(m.gyro_b))
    accel = xyz([f"a_RS_S_{a} [m s^-2]" for a in "xyz"], flu(m.accel_b))
    write(folder / "mav0/imu0/data.csv", {"#timestamp [ns]": ns, **gyro, **accel})
    q = dict(zip([f" q_RS_{a} []" for a in "wxyz"], m.q_nb.T, strict=True))
    write(folder / "mav0/state_groundtruth_estimate0/data.csv", {"#timestamp": ns, **q})
    return folder


def ulog2csv(folder: Path, m: Motion, old: bool = False) -> Path:
    us = np.rint(m.t * 1e6).astype(int) + 9
    gyro, accel = ([f"{n}[{i}]" for i in range(3)] for n in ("gyro_rad", "accelerometer_m_s2"))
    write(folder / "log_sensor_combined_0.csv", {"timestamp": us, **xyz(gyro, m.gyro_b), **xyz(accel, m.accel_b)})
    mag = xyz([f"magnetometer_ga[{i}]" for i in range(3)], m.mag_b * 1e4)
    write(folder / "log_vehicle_magnetometer_0.csv", {"timestamp": us, **mag})
    q = dict(zip([f"q[{i}]" for i in range(4)], m.q_nb.T, strict=True))
    write(folder / "log_vehicle_attitude_0.csv", {"timestamp": us, **q})
    names = ("lat", "lon", "alt_ellipsoid") if old else ("latitude_deg", "longitude_deg", "altitude_ellipsoid_m")
    scales = (1e7, 1e7, 1e3) if old else (1.0, 1.0, 1.0)
    place = {n: np.rint(v * s) if old else v for n, v, s in zip(names, LLA, scales, strict=True)}
    write(folder / "log_vehicle_gps_position_0.csv", {"timestamp": us[::20], **place, "vel_n_m_s": m.t[::20],
                                                      "vel_e_m_s": 2.0, "vel_d_m_s": 3.0, "fix_type": 3})  # fmt: skip
    return folder


def ulog2csv_old(folder: Path, m: Motion) -> Path:
    return ulog2csv(folder, m, old=True)


MADE = {"sensor-logger": sensor_logger, "sensor-logger-ios": sensor_logger_ios, "phyphox": phyphox,
        "xsens-mt-manager": mt_manager, "vectornav-control-center": control_center, "sbg-center": sbg_center,
        "microstrain-sensorconnect": sensor_connect, "euroc": euroc, "ulog2csv": ulog2csv,
        "ulog2csv-old": ulog2csv_old}  # fmt: skip


@pytest.mark.parametrize("name", MADE)
def test_ready_made_map(tmp_path: Path, moving: Motion, name: str) -> None:
    path = MADE[name](tmp_path / "export", moving)
    s, notes = samples_of(path, f"preset:{name}")
    np.testing.assert_allclose(s.t, moving.t[-len(s.t) :], atol=1.1e-6)
    last = moving.gyro_b[-len(s.t) :]
    np.testing.assert_allclose(s.gyro_b, last, atol=1e-9)
    np.testing.assert_allclose(s.accel_b, moving.accel_b[-len(s.t) :], atol=1e-8)
    if s.mag_new.any():
        t = np.rint((s.t[s.mag_new] - moving.t[0]) * 100).astype(int)
        np.testing.assert_allclose(s.mag_b[s.mag_new], moving.mag_b[t], atol=1e-12)
    if np.isfinite(s.lla).any():
        known = np.isfinite(s.lla[:, 0])
        np.testing.assert_allclose(np.degrees(s.lla[known, 0]), LLA[0], atol=1e-6)
    suspicions = [n for n in notes if n.startswith("check") and "measures heading" not in n]
    if name == "euroc":  # its truth here is in other axes than its own
        suspicions = [n for n in suspicions if "reference" not in n]
    assert not suspicions


def test_every_map_has_a_test_and_is_found_by_its_columns(tmp_path: Path, moving: Motion) -> None:
    assert sorted(MADE) == presets.names()
    for name, make in MADE.items():
        found = presets.fitting(make(tmp_path / name, moving))
        assert found == name.replace("-ios", "")  # an iPhone's files have the same names
    assert presets.fitting(tmp_path) is None
    _, notes = samples_of(tmp_path / "phyphox", None)
    assert any("those of --map preset:phyphox" in note for note in notes)
    with pytest.raises(InputError, match="did you mean 'phyphox'"):
        samples_of(tmp_path / "phyphox", "preset:phyfox")


def test_a_map_that_builds_on_another(tmp_path: Path, moving: Motion) -> None:
    phyphox(tmp_path / "export", moving)
    (tmp_path / "own.toml").write_text('preset = "phyphox"\n[mounting]\nyaw_deg = 0.0\n[place]\naltitude_m = 3.0\n')
    with open_bag(tmp_path / "export", map_file=tmp_path / "own.toml") as bag:
        np.testing.assert_allclose(bag.converter.mapping.mount, np.eye(3), atol=1e-12)
        assert bag.site.lla[2] == 3.0
