"""Small sound files of every kind that is read, and what is done with such a file: what the fuzzer starts from."""

import json
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "recordings"))

from bag_helpers import Motion, motion, ns, write_bag, write_ulog
from dataflash_helpers import write_dataflash
from foreign_helpers import write_json, write_protobuf, write_ros1_bag, write_ros1_mcap

from ahrs_sim import cli, pipeline, scenario
from ahrs_sim.evaluation.metrics import euler
from ahrs_sim.runs import campaign, check, check_baseline, check_report, check_suite
from ahrs_sim.runs.check_baseline import Found
from ahrs_sim.scenario import Gate
from ahrs_sim.scenario.shipped import scenario_dir

SCENARIO = """
title = "x"
seed = 3
epoch = 2026-06-01T10:00:00Z
duration_s = 4.0
catalogue = "chr"
[start]
latitude_deg = 43.0
altitude_m = 150.0
[wind]
speed_mps = 3.0
turbulence = "light"
gust = [{at_s = 1.0, speed_mps = 2.0}]
[motion]
kind = "sway"
still_s = 2.0
[pilot]
attitude = "truth"
[suite.chr]
grade = "chr_6dm"
gyro.turn_on_bias_dps = [0.1, 0.2, 0.3]
position_m = [0.1, 0.0, 0.0]
[suite.sbg]
grade = "sbg_ig500"
[estimator.a]
method = "marg-ekf"
suite = "chr"
align_s = 1.0
[estimator.b]
method = "marg-ekf"
suite = "sbg"
aiding = "airspeed"
align_s = 1.0
[[fault]]
suite = "chr"
sensor = "magnetometer"
kind = "dropout"
at_s = 1.0
for_s = 1.0
"""

LOGGED = SCENARIO.replace('catalogue = "chr"\n', "")

CSV_MAP = """
[topics]
fix = ""
[frames]
body = "FRD"
[csv]
separator = ","
time = {column = "time_ms", unit = "ms"}
[csv.imu]
gyro = {columns = ["gx", "gy", "gz"], unit = "deg/s"}
accel = {columns = ["ax", "ay", "az"], unit = "g"}
[csv.mag]
field = {columns = ["mx", "my", "mz"], unit = "mG"}
[csv.reference]
euler = {columns = ["roll", "pitch", "yaw"], unit = "deg"}
[place]
latitude_deg = 45.0
longitude_deg = 7.0
[sensors]
gyro_noise = 5e-4
[estimator.mine]
method = "marg-ekf"
align_s = 1.0
"""

LOOSE_MAP = """
[csv]
time = {column = "time_ms", unit = "ms"}
[csv.imu]
gyro = {columns = ["gx", "gy", "gz"], unit = "deg/s"}
accel = {columns = ["ax", "ay", "az"], unit = "g"}
[csv.mag]
optional = true
field = {columns = ["mx|my", "my", "mz"], unit = "mG"}
"""

SUITE = """
title = "x"
catalogue = "chr"
[tolerance]
relative = 0.05
degrees = 0.05
[estimator.mine]
method = "marg-ekf"
suite = "chr"
[every]
at_most_s = 150.0
seeds = [1, 2]
[[flight]]
scenario = "flight.toml"
seeds = [1, 2, 3]
duration_s = 5.0
estimators = ["mine"]
"""

BASELINE = {
    "history": [{"date": "2026-01-01", "version": "1", "why": "first"}],
    "flights": {
        "flight": {
            "seeds": [1, 2, 3],
            "estimators": {"mine": {"all.tilt": [1.0, 2.0, None], "all.availability": [1.0, 1.0, 1.0]}},
        }
    },
}

BESIDE = {
    "table.csv.map.toml": CSV_MAP,
    "export.txt.map.toml": LOOSE_MAP,
    "flight.toml": SCENARIO,
    "baseline.json": json.dumps(BASELINE),
}
"""Texts that lie beside a file under test, sound."""


@dataclass(frozen=True)
class Kind:
    """A kind of input."""

    file: str  # its name
    form: str  # how it is mutated: see `mutate.MUTATORS`
    actions: tuple[Callable[[Path, Path], object], ...]  # each given the file and a folder to write to


def command(*arguments: str) -> Callable[[Path, Path], object]:
    """A command line; `{in}` is the file, `{out}` the folder."""

    def run(file: Path, out: Path) -> int:
        places = {"{in}/..": str(file.parent), "{in}": str(file), "{out}": str(out)}
        given = list(arguments)
        for mark, place in places.items():
            given = [argument.replace(mark, place) for argument in given]
        return cli.main(given)

    return run


def _load_and_fly(file: Path, out: Path) -> object:
    """Fly a scenario as the command does, but for at most a second and in this process."""
    found = scenario.load(str(file), gate=Gate())
    short = scenario.parse({**found.data, "duration_s": 1.0}, found.where, found.name, gate=Gate())
    return pipeline.fly(short, out / "flown.mcap")


def _fly_on_grade(file: Path, out: Path) -> object:
    data = {"motion": {"kind": "sway"}, "duration_s": 0.5, "suite": {"chr": {"grade": str(file)}}, "estimator": {}}
    return pipeline.fly(scenario.parse(data, "here", "here"), out / "flown.mcap")


def _check(file: Path, out: Path) -> object:
    shutil.copy(file.parent / "flight.toml", out)
    suite = check_suite.load(str(shutil.copy(file, out)))
    shutil.copy(file.parent / "baseline.json", suite.baseline)
    figures = {f.name: {"mine": {"all.tilt": [1.0] * len(f.seeds)}} for f in suite.flights}
    return check_report.table(check.compare(suite, Found(figures, {})))


def _baseline(file: Path, out: Path) -> object:
    shutil.copy(file.parent / "flight.toml", out)
    head, flights = SUITE.partition("[every]")[0], SUITE.partition("[[flight]]")[2]
    (out / "s.toml").write_text(f'baseline = "b.json"\n{head}[[flight]]{flights}')
    shutil.copy(file, out / "b.json")
    suite = check_suite.load(str(out / "s.toml"))
    figures = {f.name: {"mine": {"all.tilt": [1.0] * len(f.seeds)}} for f in suite.flights}
    result = check.compare(suite, Found(figures, {}))
    check_baseline.renew(suite, Found(figures, {}), "fuzzed")
    return [check_report.table(result), check_report.markdown(result), check_report.junit(result)]


def _manifest(file: Path, out: Path) -> object:
    shutil.copy(file, out / "manifest.json")
    store = campaign.Store(str(out))
    campaign.scenario_of(str(out), 1)
    return store.begin(store.plan())


KINDS: Mapping[str, Kind] = {
    "log": Kind(
        "log.mcap",
        "mcap",
        (
            command("info", "{in}"),
            command("compare", "{in}"),
            command("compare", "{in}", "--reference", "a", "--sync", "--align", "frames", "--lag"),
            command("compare", "{in}", "--report", "{out}/r.html"),
            command("compare", "{in}", "--csv"),
            command("export", "{in}", "--to", "csv", "-o", "{out}/csv"),
            command("export", "{in}", "--to", "layout", "-o", "{out}/l.json"),
            command("recover", "{in}", "-o", "{out}/recovered.mcap"),
            command("replay", "{in}"),
            command("replay", "{in}", "-o", "{out}/again.mcap", "--estimator", "marg-ekf@chr"),
            command("allan", "{in}"),
        ),
    ),
    "bag": Kind(
        "bag.mcap",
        "mcap",
        (
            command("replay", "{in}", "--estimator", "marg-ekf"),
            command("replay", "{in}", "--estimator", "marg-ekf", "--calibrate", "mag", "--sync", "-o", "{out}/o.mcap"),
            command("allan", "{in}"),
            command("info", "{in}", "--json"),
        ),
    ),
    "db3": Kind("bag.db3", "db3", (command("replay", "{in}", "--estimator", "marg-ekf"),)),
    "ulog": Kind("px4.ulg", "ulog", (command("replay", "{in}", "--estimator", "marg-ekf"),)),
    "dataflash": Kind("ap.bin", "dataflash", (command("replay", "{in}", "--estimator", "marg-ekf"),)),
    "json": Kind("json.mcap", "mcap", (command("replay", "{in}", "--estimator", "marg-ekf"),)),
    "protobuf": Kind("protobuf.mcap", "mcap", (command("allan", "{in}"),)),
    "ros1": Kind("ros1.mcap", "mcap", (command("replay", "{in}", "--estimator", "marg-ekf"),)),
    "rosbag": Kind("ros1.bag", "db3", (command("replay", "{in}", "--estimator", "marg-ekf"),)),
    "table": Kind(
        "export.txt",
        "csv",
        (command("export", "{in}", "--to", "csv", "-o", "{out}", "--map", "{in}.map.toml"),),
    ),
    "csv": Kind("table.csv", "csv", (command("replay", "{in}", "--map", "{in}.map.toml"),)),
    "map": Kind("map.toml", "toml", (command("replay", "{in}/../table.csv", "--map", "{in}"),)),
    "scenario": Kind("scenario.toml", "toml", (_load_and_fly,)),
    "flown": Kind("flown.toml", "toml", (_load_and_fly,)),
    "grade": Kind("grade.toml", "toml", (_fly_on_grade,)),
    "suite": Kind("suite.toml", "toml", (_check,)),
    "baseline": Kind("baseline.json", "json", (_baseline,)),
    "manifest": Kind("manifest.json", "json", (_manifest,)),
}  # fmt: skip


def write_all(folder: Path) -> None:
    """Write a sound file of each kind."""
    still = motion(12.0, 50.0, still=4.0)
    logged = scenario.parse(scenario.table.parse_toml(LOGGED, "logged"), "logged", "logged")
    pipeline.fly(logged, folder / "log.mcap")
    write_bag(folder / "bag.mcap", still)
    write_ulog(folder / "px4.ulg", still)
    write_dataflash(folder / "ap.bin", still)
    _write_db3(folder)
    short = motion(4.0, 50.0, still=1.0)
    write_json(folder / "json.mcap", short)
    write_protobuf(folder / "protobuf.mcap", short)
    write_ros1_mcap(folder / "ros1.mcap", short)
    write_ros1_bag(folder / "ros1.bag", short)
    _write_csv(folder / "table.csv", still)
    _write_csv(folder / "export.txt", short)
    for name, text in BESIDE.items():
        (folder / name).write_text(text)
    (folder / "map.toml").write_text(CSV_MAP)
    (folder / "scenario.toml").write_text(SCENARIO)
    turns = (scenario_dir() / "takeoff.toml").read_text()
    (folder / "flown.toml").write_text(turns)
    grades = Path(scenario.__file__).parents[1] / "sensors" / "grades"
    (folder / "grade.toml").write_text((grades / "sbg_ig500.toml").read_text())
    (folder / "suite.toml").write_text(SUITE)
    plan = campaign.Plan.make(scenario.load(str(folder / "flight.toml")), 3, ["wind.speed_mps=uniform:0..8"])
    (folder / "manifest.json").write_text(json.dumps(plan.manifest()))


def _write_csv(path: Path, m: Motion) -> None:
    columns = [(ns(m.t) - ns(m.t)[0]) / 1e6, *np.degrees(m.gyro_b).T, *(m.accel_b / 9.80665).T, *(m.mag_b * 1e7).T,
               *np.degrees(euler(m.q_nb)).T]  # fmt: skip
    names = "time_ms,gx,gy,gz,ax,ay,az,mx,my,mz,roll,pitch,yaw"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="", fmt="%.9g")


def _write_db3(folder: Path) -> None:
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with (
        rosbag2.Writer(folder / "db3", version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer,
        rosbag2.Reader(folder / "bag.mcap") as reader,
    ):
        by_topic = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for connection, time, data in reader.messages():
            writer.write(by_topic[connection.topic], time, data)
    shutil.copy(next((folder / "db3").glob("*.db3")), folder / "bag.db3")
