"""No file decides which code runs: every way in which the name of a class can come, each with and without leave."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import estimators
from ahrs_sim import cli
from ahrs_sim.errors import InputError
from ahrs_sim.scenario import ANY, Component, Gate, create_estimator, load, parse
from estimators.types import SensorInfo, Site

SCENARIO = """
duration_s = 2.0
[motion]
kind = "sway"
[estimator.theirs]
method = "stranger:Estimator"
suite = "chr"
"""

MODULE = """
from pathlib import Path
import numpy as np
from estimators.types import Estimates, blank
Path(__file__).with_name("ran").touch()

class Estimator:
    def __init__(self, site, sensors, answer=1.0):
        pass
    def process(self, samples):
        return Estimates(**{**blank(Estimates, len(samples)), "t": samples.t})

def function(site=None, sensors=None, **settings):
    Path(__file__).with_name("called").touch()
"""


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], bool]:
    """A module that notes that it was imported; the result tells whether it was, since the last time of asking."""
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "stranger.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(folder))

    def ran() -> bool:
        sys.modules.pop("stranger", None)
        mark = folder / "ran"
        found = mark.exists() or (folder / "called").exists()
        for name in ("ran", "called"):
            (folder / name).unlink(missing_ok=True)
        return found

    ran()
    return ran


@pytest.fixture
def log(tmp_path: Path, stranger: Callable[[], bool]) -> Path:
    """A log whose scenario names the module, and which that module had no part in."""
    path = tmp_path / "theirs.mcap"
    scenario = tmp_path / "own.toml"
    scenario.write_text(SCENARIO)
    assert cli.main(["fly", str(scenario), "-o", str(path), "--quiet"]) == 0
    assert stranger()
    return path


def test_a_file_of_ones_own_runs_its_class_and_says_so(
    tmp_path: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "own.toml"
    scenario.write_text(SCENARIO)
    assert cli.main(["fly", str(scenario), "-o", str(tmp_path / "out.mcap")]) == 0
    assert stranger()
    line = f"ahrs-sim: {scenario}: [estimator.theirs]: runs stranger:Estimator, code from outside\n"
    assert capsys.readouterr().err.count(line) == 1


def refused(arguments: list[str], stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert cli.main(arguments) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "--allow-code stranger:" in line
    assert not stranger()
    return line


def allowed(arguments: list[str], stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert cli.main(arguments) == 0
    assert stranger()
    assert "runs stranger:Estimator, code from outside" in capsys.readouterr().err


def test_replay_runs_nothing_that_a_log_names(
    log: Path, tmp_path: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out.mcap")
    for command in (["replay", str(log)], ["replay", str(log), "-o", out, "--force"]):
        assert "theirs.mcap: [estimator.theirs]: method" in refused(command, stranger, capsys)
        refused([*command, "--allow-code", "stranger:Other"], stranger, capsys)
        refused([*command, "--allow-code", "strange"], stranger, capsys)
        allowed([*command, "--allow-code", "stranger"], stranger, capsys)
        allowed([*command, "--estimator", "stranger:Estimator@chr"], stranger, capsys)


def test_tuning_runs_nothing_that_a_log_names(
    log: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("theirs", "ekf-chr", "ins21@chr"):
        cli.main(["tune", str(log), "--estimator", name])
        assert not stranger(), name
    assert "--allow-code stranger:" in refused(["tune", str(log), "--estimator", "theirs"], stranger, capsys)


def test_other_commands_run_nothing_that_a_log_names(
    log: Path, tmp_path: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (
        ["info", str(log)],
        ["compare", str(log)],
        ["compare", str(log), "--lag", "--report", str(tmp_path / "report.html")],
        ["export", str(log), "--to", "csv", "--topic", "/est/theirs/state", "-o", str(tmp_path / "csv")],
        ["recover", str(log), "-o", str(tmp_path / "whole.mcap")],
    ):
        cli.main(command)
        assert not stranger(), command


def test_replay_runs_nothing_that_a_map_names(
    tmp_path: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    bag, map_file = tmp_path / "bag.csv", tmp_path / "map.toml"
    rows = [f"{i / 50},{i % 7 / 1e3},0,{i % 5 / 1e3},0,{i % 3 / 100},9.8{i % 9}" for i in range(500)]
    bag.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *rows]))
    columns = '[csv]\ntime = {column = "t"}\n[csv.imu]\ngyro = {columns = ["gx", "gy", "gz"], unit = "rad/s"}\n'
    columns += 'accel = {columns = ["ax", "ay", "az"], unit = "m/s2"}\n[estimator.theirs]\nmethod = '
    map_file.write_text(columns + '"stranger:Estimator"\n')
    command = ["replay", str(bag), "--map", str(map_file)]
    assert "map.toml: [estimator.theirs]: method" in refused(command, stranger, capsys)
    allowed([*command, "--allow-code", "stranger"], stranger, capsys)
    allowed([*command, "--estimator", "stranger:Estimator"], stranger, capsys)
    map_file.write_text(columns + '"marg-ekf"\nsite = 1\n')
    assert cli.main(command) == 2
    assert "[estimator.theirs]: site: is not a setting" in capsys.readouterr().err


def test_check_runs_nothing_that_a_suite_or_its_scenario_names(
    tmp_path: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    suite, scenario = tmp_path / "suite.toml", tmp_path / "flight.toml"
    scenario.write_text(SCENARIO)
    suite.write_text('[[flight]]\nscenario = "flight.toml"\nseeds = [1]\n')
    command = ["check", str(suite), "--renew", "--why", "first", "--workers", "1"]
    assert "flight.toml: [estimator.theirs]: method" in refused(command, stranger, capsys)
    scenario.write_text(SCENARIO.partition("[estimator")[0])
    suite.write_text(suite.read_text() + '[estimator.theirs]\nmethod = "stranger:Estimator"\nsuite = "chr"\n')
    refused(command, stranger, capsys)
    allowed([*command, "--allow-code", "stranger:Estimator"], stranger, capsys)


def test_a_run_of_a_campaign_runs_nothing_that_its_manifest_names(
    tmp_path: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = {"name": "theirs", "seed": 1, "runs": 1, "vary": [], "band_s": 1.0, "scenario": SCENARIO}
    for scenario, vary in (
        (SCENARIO, []),
        (SCENARIO.replace("stranger:Estimator", "marg-ekf"), ["estimator.theirs.method=choice:stranger:Estimator"]),
    ):
        text = json.dumps(manifest | {"scenario": scenario, "vary": vary})
        (tmp_path / "manifest.json").write_text(text)
        command = ["fly", "--from", str(tmp_path), "--run", "0", "-o", str(tmp_path / "out.mcap"), "--force"]
        refused(command, stranger, capsys)
        allowed([*command, "--allow-code", "stranger"], stranger, capsys)


@pytest.mark.long
def test_a_campaign_of_ones_own_file_runs_its_class_in_the_workers(
    tmp_path: Path, stranger: Callable[[], bool], capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "own.toml"
    scenario.write_text(SCENARIO)
    command = ["campaign", str(scenario), "--runs", "1", "--workers", "1", "-o", str(tmp_path / "out")]
    allowed(command, stranger, capsys)
    assert "stranger" not in json.loads((tmp_path / "out" / "manifest.json").read_text()).get("code", "")


@pytest.mark.parametrize("method", ["stranger:function", "os:system", "setuptools:setup", "stranger:np"])
def test_what_is_no_estimator_class_is_not_called(method: str, stranger: Callable[[], bool], tmp_path: Path) -> None:
    with pytest.raises(estimators.SettingError, match="not a class with a method"):
        estimators.create(method, command="touch called")
    stranger()
    assert not (tmp_path / "modules" / "called").exists()


@pytest.mark.parametrize("method", [":x", "x:", ":", "a..b:C", "a b:C", "a:b:c", "a:b.c"])
def test_a_name_that_cannot_be_a_class_is_one_line(method: str) -> None:
    with pytest.raises(estimators.SettingError, match=r"is not written package\.module:Class"):
        estimators.create(method)


def test_the_gate_covers_whole_names_only() -> None:
    passing = [("mine", "mine:A"), ("mine", "mine.b:C"), ("mine.b", "mine.b.c:D"), ("mine:A", "mine:A"), ("*", "x:Y")]
    stopped = [("mine", "mineral:A"), ("mine:A", "mine:AB"), ("mine.b", "mine:A"), ("A", "mine:A"), ("", "mine:A")]
    for name, method in passing:
        Gate((name,)).check(method, "here")
    for name, method in stopped:
        with pytest.raises(InputError, match="code from outside"):
            Gate((name,)).check(method, "here")
    Gate().check("marg-ekf", "here")


def test_without_a_gate_nothing_from_outside_is_created(stranger: Callable[[], bool]) -> None:
    component = Component("a", {"method": "stranger:Estimator", "suite": "chr"}, "here")
    with pytest.raises(InputError, match="code from outside"):
        create_estimator(component, Site((0.0, 0.0, 0.0)), SensorInfo())
    assert not stranger()


def test_settings_cannot_stand_for_what_an_estimator_is_given(tmp_path: Path) -> None:
    for key in ("name", "site", "sensors"):
        data = {"motion": {"kind": "sway"}, "estimator": {"a": {"method": "marg-ekf", "suite": "chr", key: 1}}}
        with pytest.raises(InputError, match=f"{key}: is not a setting"):
            parse(data, "here", "a", gate=Gate(ANY))


def test_a_scenario_read_by_a_program_is_its_users_own(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(SCENARIO)
    assert load(str(file)).code == ("stranger:Estimator",)
    with pytest.raises(InputError, match="code from outside"):
        load(str(file), gate=Gate())
