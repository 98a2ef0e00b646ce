"""Shared libraries behind ahrs_estimator.h: same figures as in process; whatever they do, the log is complete."""

import importlib
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import cli, pipeline, plugins, scenario
from ahrs_sim.errors import FlightError, InputError
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.plugins import layout
from ahrs_sim.plugins.library import LibraryEstimator
from estimators import Samples, SensorInfo, Site, Status

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

SITE = Site((0.76, 0.026, 150.0))
LATER = "static double seen; seen += samples[n - 1].t - samples[0].t; if (samples[n - 1].t > 8.0) "

BODY = """
#include "ahrs_estimator.h"
#include <stdlib.h>
struct ahrs_estimator { double gain; };
static struct ahrs_estimator one;
int32_t ahrs_version(void) { return %(version)s; }
ahrs_estimator *ahrs_create(const ahrs_site *s, const ahrs_sensors *x, const char *t) { %(create)s return &one; }
int32_t ahrs_process(ahrs_estimator *e, const ahrs_sample *samples, uint32_t n, ahrs_estimate *out) {
    for (uint32_t k = 0; k < n; k++) { out[k].q_nb[0] = 1.0; out[k].q_nb[1] = out[k].q_nb[2] = out[k].q_nb[3] = 0.0;
        out[k].status = AHRS_RUNNING; out[k].vel_n[0] = samples[k].gyro_b[2]; out[k].lla[2] = samples[k].mag_new; }
    %(process)s
    return 0;
}
void ahrs_reset(ahrs_estimator *e) {}
void ahrs_destroy(ahrs_estimator *e) {}
const char *ahrs_error(const ahrs_estimator *e) { return "it rains"; }
"""


def build(folder: Path, *, version: str = "AHRS_INTERFACE_VERSION", create: str = "", process: str = "") -> Path:
    source, library = folder / "plug.c", folder / "libplug.so"
    source.write_text(BODY % {"version": version, "create": create, "process": process})
    command = ["cc", "-O1", "-w", "-fPIC", "-shared", "-I", str(layout.HEADER.parent), "-o", str(library), str(source)]
    subprocess.run(command, check=True)
    return library


def samples(n: int = 1000) -> Samples:
    t = np.arange(n) * 0.01
    rng = np.random.default_rng(1)
    return Samples.make(t, rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), mag_new=t % 0.02 < 0.005)


def test_structures_lie_where_the_header_puts_them(tmp_path: Path) -> None:
    lines = []
    for name, structure in (("ahrs_sample", layout.SAMPLE), ("ahrs_estimate", layout.ESTIMATE)):
        lines.append(f'printf("%zu\\n", sizeof({name}));')
        lines += [f'printf("%zu\\n", offsetof({name}, {field}));' for field in structure.names or ()]
    lines += [f'printf("%zu\\n", sizeof({name}));' for name in ("ahrs_site", "ahrs_sensors")]
    lines.append('printf("%d\\n", AHRS_INTERFACE_VERSION);')
    (tmp_path / "print.c").write_text(
        '#include "ahrs_estimator.h"\n#include <stdio.h>\nint main(void) {' + "\n".join(lines) + "return 0;}"
    )
    binary = str(tmp_path / "print")
    subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Werror", "-pedantic", "-I", str(layout.HEADER.parent), "-o", binary, "print.c"],
        cwd=tmp_path,
        check=True,
    )
    found = [int(x) for x in subprocess.check_output([binary], text=True).split()]
    expected = []
    for structure in (layout.SAMPLE, layout.ESTIMATE):
        assert structure.fields is not None
        expected += [structure.itemsize, *(offset for _, offset in list(structure.fields.values()))]
    expected += [len(layout.constants(SITE)), len(layout.constants(SensorInfo())), layout.VERSION]
    assert found == expected


def test_samples_arrive_and_estimates_come_back(tmp_path: Path) -> None:
    given = samples(10_000)  # more than one call's worth
    estimator = LibraryEstimator(build(tmp_path), site=SITE, sensors=SensorInfo())
    estimates = estimator.process(given)
    np.testing.assert_array_equal(estimates.t, given.t)
    np.testing.assert_array_equal(estimates.vel_n[:, 0], given.gyro_b[:, 2])
    np.testing.assert_array_equal(estimates.lla[:, 2], given.mag_new)
    assert (estimates.status == Status.RUNNING).all() and np.isnan(estimates.att_cov).all()
    estimator.close()


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ({"version": "7"}, "version 7 of ahrs_estimator.h, this is version 1"),
        ({"create": "return 0;"}, "it rains"),
        ({"create": "abort();"}, "crashed (SIGABRT)"),
        ({"create": "exit(3);"}, "exit code 3"),
    ],
)
def test_a_library_that_does_not_start_is_one_line(tmp_path: Path, fault: dict[str, str], reason: str) -> None:
    library = build(tmp_path, **fault)
    with pytest.raises(InputError) as caught:
        LibraryEstimator(library, site=SITE, sensors=SensorInfo())
    assert reason in str(caught.value) and str(library) in str(caught.value) and "\n" not in str(caught.value)


def test_no_library_at_all_is_one_line(tmp_path: Path) -> None:
    text = tmp_path / "text.so"
    text.write_text("no library")
    with pytest.raises(InputError, match="cannot be loaded"):
        LibraryEstimator(text, site=SITE, sensors=SensorInfo())
    source, library = tmp_path / "few.c", tmp_path / "few.so"
    source.write_text("int ahrs_version(void) { return 1; }")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    with pytest.raises(InputError, match="no function ahrs_create"):
        LibraryEstimator(library, site=SITE, sensors=SensorInfo())


@pytest.mark.skipif(sys.platform != "linux", reason="libraries are ELF files on Linux")
@pytest.mark.parametrize(("number", "name"), [(183, "AArch64, 64 bits"), (258, "machine 258 of ELF, 64 bits")])
def test_a_library_of_another_machine_is_one_line(tmp_path: Path, number: int, name: str) -> None:
    library = build(tmp_path)
    content = bytearray(library.read_bytes())
    content[18:20] = number.to_bytes(2, "little")  # e_machine
    library.write_bytes(content)
    with pytest.raises(InputError, match=f"was compiled for {name}, this machine is .*; compile it for this one"):
        LibraryEstimator(library, site=SITE, sensors=SensorInfo())


@pytest.mark.parametrize(
    ("process", "settings", "reason"),
    [
        ("*(volatile int *)0 = 1;", "", "crashed (SIGSEGV)"),
        ("for (;;) {}", "time_limit_s = 0.5", "no answer within 0.5 s"),
        ("exit(0);", "", "ended the process it runs in"),
        ("return 1;", "", "it rains"),
    ],
)
def test_the_flight_goes_on_without_a_library_that_fails(
    tmp_path: Path, process: str, settings: str, reason: str
) -> None:
    build(tmp_path, process=f"if (samples[n - 1].t > 8.0) {{ {process} }}")
    flight = tmp_path / "flight.toml"
    flight.write_text(
        'extends = "takeoff"\nduration_s = 16.0\n'
        f'[estimator.plug]\nmethod = "lib:./libplug.so"\nsuite = "chr"\n{settings}\n'
    )
    log = tmp_path / "flight.mcap"
    loaded = scenario.load(str(flight), estimators=["plug", "ekf-chr"])
    with pytest.raises(FlightError, match="estimator 'plug'") as caught:
        pipeline.fly(loaded, log)
    assert reason in str(caught.value)
    with FlightReader(log) as reader:
        plug, other = reader.estimates("plug"), reader.estimates("ekf-chr")
        texts = [str(text) for text in reader.read("/events")["text"]]
    assert len(plug) == len(other) and other.t[-1] > 15.9
    assert (plug.status[plug.t < 3.9] == Status.RUNNING).all()
    assert (plug.status[plug.t > 8.5] == Status.DIVERGED).all() and np.isnan(plug.q_nb[plug.t > 8.5]).all()
    assert sum(reason in text for text in texts) == 1


def test_an_attitude_of_nan_is_not_running(tmp_path: Path) -> None:
    build(tmp_path, process="if (samples[n - 1].t > 8.0) out[n - 1].q_nb[0] = 0.0 / 0.0;")
    flight = tmp_path / "flight.toml"
    flight.write_text(
        'extends = "takeoff"\nduration_s = 12.0\n[estimator.plug]\nmethod = "lib:libplug.so"\nsuite = "chr"\n'
    )
    log = tmp_path / "flight.mcap"
    pipeline.fly(scenario.load(str(flight), estimators=["plug"]), log)
    with FlightReader(log) as reader:
        plug = reader.estimates("plug")
        texts = [str(text) for text in reader.read("/events")["text"]]
    assert (plug.status == Status.DIVERGED).any() and (plug.status == Status.RUNNING).any()
    assert sum("without an attitude" in text for text in texts) == 1


@pytest.mark.parametrize("language", ["c", "cpp"])
def test_a_new_project_builds_tests_itself_and_flies(
    tmp_path: Path, language: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "estimator", "mine", "--lang", language]) == 0
    monkeypatch.chdir(tmp_path / "mine")
    subprocess.run(["make", "-s", "test", "libmine.so"], check=True, stdout=subprocess.DEVNULL)
    capsys.readouterr()
    command = ["fly", "takeoff", "--duration", "12", "--estimator", "lib:./libmine.so@chr", "-o", "x.mcap", "--json"]
    assert cli.main(command) == 0
    result = json.loads(capsys.readouterr().out)["estimators"]["libmine-chr"]
    assert result["tilt_rmse_deg"] < 3.0
    assert cli.main(["new", "estimator", "mine", "-o", "."]) == 2


@pytest.mark.parametrize("language", ["c", "python"])
def test_the_accuracy_of_a_new_project_is_checked_as_it_says(
    tmp_path: Path, language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """README once, then Makefile and CI, whose commands are run as they are written, on a shorter flight."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "estimator", "own_one", "--lang", language]) == 0
    monkeypatch.chdir(tmp_path / "own_one")
    if language == "c":
        subprocess.run(["make", "-s"], check=True)
    suite = Path("accuracy.toml")
    first = suite.read_text().split("[[flight]]")[:2]
    suite.write_text("[[flight]]".join(first).replace("60.0", "12.0").replace("[1, 2, 3]", "[1]"))
    for file in (Path("README.md"), Path("Makefile"), Path(".github", "workflows", "accuracy.yml")):
        line = next(line for line in file.read_text().splitlines() if "ahrs-sim check" in line and "#" not in line[:1])
        words = shlex.split(line[line.index("ahrs-sim check") :], comments=True)
        assert cli.main([*words[1:], "--workers", "1"]) == 0, line


def test_c_and_cpp_and_python_projects_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    n = 3000
    given = Samples.make(
        np.arange(n) * 0.01,
        rng.normal(0.0, 0.1, (n, 3)),
        np.array([1.0, 0.5, -9.7]) + rng.normal(0.0, 0.2, (n, 3)),
        mag_b=np.array([2.0e-5, -0.5e-5, 4.0e-5]) + rng.normal(0.0, 1e-7, (n, 3)),
        mag_new=np.ones(n, bool),
    )
    found = {}
    for language in ("c", "cpp"):
        cli.main(["new", "estimator", "mine", "--lang", language, "-o", language])
        subprocess.run(["make", "-s", "-C", language, "libmine.so"], check=True)
        made = LibraryEstimator(Path(language, "libmine.so"), site=SITE, sensors=SensorInfo(), tilt_gain=0.3)
        found[language] = made.process(given).q_nb
        made.close()
    cli.main(["new", "estimator", "mine", "-o", "py"])
    monkeypatch.syspath_prepend(str(tmp_path / "py"))
    module = importlib.import_module("mine")
    found["python"] = module.mine(SITE, SensorInfo(), tilt_gain=0.3).process(given).q_nb
    sys.modules.pop("mine")
    assert np.isfinite(found["c"][200:]).all()
    for other in ("cpp", "python"):
        np.testing.assert_allclose(found[other], found["c"], atol=1e-9)


def test_paths_are_looked_up_beside_the_scenario(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file beside the scenario"):
        plugins.located("libnone.so", tmp_path)
    build(tmp_path)
    assert plugins.located("libplug.so", tmp_path) == tmp_path / "libplug.so"


def test_replay_goes_on_without_a_library_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    pipeline.fly(scenario.load("takeoff", duration=16.0, estimators=["ekf-chr"]), tmp_path / "log.mcap")
    build(tmp_path, process="if (samples[n - 1].t > 8.0) abort();")
    command = ["replay", "log.mcap", "--estimator", "lib:./libplug.so@chr", "--estimator", "ekf-chr", "-o", "new.mcap"]
    assert cli.main(command) == 1
    printed = capsys.readouterr()
    assert "crashed (SIGABRT)" in printed.err and "ekf-chr" in printed.out
    with FlightReader(tmp_path / "new.mcap") as reader:
        assert len(reader.estimates("libplug-chr")) == len(reader.estimates("ekf-chr"))


def test_a_setting_of_a_library_is_tuned_on_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only the library knows its settings: limits are given, and the error decides; it states no innovations."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "estimator", "mine", "--lang", "c"]) == 0
    subprocess.run(["make", "-s", "-C", "mine", "libmine.so"], check=True)
    own = 'method = "lib:./mine/libmine.so"\nsuite = "chr"\ntilt_gain = 0.9\n'
    Path("flight.toml").write_text(
        f'extends = "takeoff"\nduration_s = 95.0\nestimators = ["own"]\n[estimator.own]\n{own}'
    )
    assert cli.main(["fly", "flight.toml", "-o", "x.mcap"]) == 0
    command = ["tune", "x.mcap", "--estimator", "own", "--allow-code", "lib:./mine/libmine.so", "--objective", "error"]
    capsys.readouterr()
    assert cli.main([*command, "--setting", "tilt_gain=0.02..1"]) == 0
    printed = capsys.readouterr().out
    (gain,) = re.findall(r"^\[estimator\.libmine\]\nmethod = .*\ntilt_gain = (\S+)$", printed, re.MULTILINE)
    assert 0.02 <= float(gain) < 0.5 and ": better" in printed and "NIS" not in printed
    for setting, words in (
        ("heading_gain", "give limits: heading_gain=LOW..HIGH"),
        ("tilt_gaim=0.02..1", "no setting 'tilt_gaim'; known: tilt_gain"),
    ):
        assert cli.main([*command, "--setting", setting]) == 2
        assert words in capsys.readouterr().err
