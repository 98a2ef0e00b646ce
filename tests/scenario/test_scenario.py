"""Scenarios: what is accepted, and the one line a mistake gets."""

import json
import math
import sys
from pathlib import Path

import pytest

from ahrs_sim import cli
from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError
from estimators import describe

MINIMAL = """
aircraft = "trainer"
[[step]]
do = "wait"
for_s = 1.0
"""


def write(folder: Path, text: str, name: str = "test.toml") -> str:
    path = folder / name
    path.write_text(text)
    return str(path)


def test_defaults_are_the_line_up_of_the_paper(tmp_path: Path) -> None:
    scenario = scenarios.load(write(tmp_path, MINIMAL))
    assert [e.name for e in scenario.estimators] == ["ekf-chr", "ckf-chr", "cdkf-chr", "ekf-sbg"]
    assert {s.name: s.settings["grade"] for s in scenario.suites} == {"chr": "chr_6dm", "sbg": "sbg_ig500"}
    assert scenario.rate == 400.0
    assert scenario.seed == 0


@pytest.mark.parametrize(
    ("suites", "expected"),
    [
        (["chr"], ["ekf-chr", "ckf-chr", "cdkf-chr"]),
        (["mine"], ["ekf-mine", "ckf-mine", "cdkf-mine"]),
        (["mine", "sbg", "other"], ["ekf-mine", "ckf-mine", "cdkf-mine", "ekf-sbg", "ekf-other"]),
        (["sbg", "mine", "chr"], ["ekf-chr", "ckf-chr", "cdkf-chr", "ekf-sbg"]),
    ],
)
def test_the_line_up_flies_on_the_suites_that_there_are(tmp_path: Path, suites: list[str], expected: list[str]) -> None:
    text = MINIMAL + "".join(f'[suite.{name}]\ngrade = "chr_6dm"\n' for name in suites)
    scenario = scenarios.load(write(tmp_path, text))
    assert [e.name for e in scenario.estimators] == expected
    assert all(e.settings["suite"] in suites for e in scenario.estimators)
    one = scenarios.load(write(tmp_path, f'estimators = ["{expected[0]}"]\n{text}'))
    assert [e.name for e in one.estimators] == expected[:1]


def test_degrees_become_radians(tmp_path: Path) -> None:
    text = MINIMAL + "[start]\nlatitude_deg = 45.0\nheading_deg = 90.0\n[wind]\nspeed_mps = 4.0\nfrom_deg = 180.0\n"
    scenario = scenarios.load(write(tmp_path, text))
    assert scenario.start.latitude == pytest.approx(math.pi / 4)
    assert scenario.start.heading == pytest.approx(math.pi / 2)
    assert scenario.wind.from_ == pytest.approx(math.pi)


def test_extends_merges_tables_and_replaces_lists(tmp_path: Path) -> None:
    write(tmp_path, MINIMAL + "[start]\naltitude_m = 7.0\nheading_deg = 10.0\n", "base.toml")
    text = 'extends = "base"\nseed = 9\n[start]\nheading_deg = 20.0\n[[step]]\ndo = "takeoff"\n'
    scenario = scenarios.load(write(tmp_path, text))
    assert scenario.start.altitude == 7.0
    assert math.degrees(scenario.start.heading) == pytest.approx(20.0)
    assert [s.data["do"] for s in scenario.steps] == ["takeoff"]
    assert scenario.seed == 9


def test_the_effective_text_is_the_same_scenario_again(tmp_path: Path) -> None:
    first = scenarios.load(write(tmp_path, MINIMAL), seed=5, duration=3.0, estimators=["marg-ckf@sbg"])
    again = scenarios.load(write(tmp_path, first.toml(), "again.toml"))
    assert again.data == first.data
    assert (again.seed, again.duration, again.estimators[0].name) == (5, 3.0, "marg-ckf-sbg")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sede = 1\n" + MINIMAL, "sede: unknown key; did you mean 'seed'?"),
        ("seed = -1\n" + MINIMAL, "seed: -1 is out of range"),
        ("seed = 1.5\n" + MINIMAL, "seed: 1.5 is not a whole number"),
        ("duration_s = nan\n" + MINIMAL, "duration_s: nan is not a finite number"),
        ("duration_s = -3.0\n" + MINIMAL, "duration_s: -3 is out of range"),
        ("epoch = 3\n" + MINIMAL, "epoch: 3 is not a date"),
        (MINIMAL + "[wind]\nspeed_mps = -4.0\n", "[wind]: speed_mps: -4 is out of range"),
        (MINIMAL + "[wind]\nturbulence = 'lihgt'\n", "turbulence: 'lihgt' is unknown; did you mean 'light'?"),
        (MINIMAL + "[start]\nheadin_deg = 3.0\n", "[start]: headin_deg: unknown key; did you mean 'heading_deg'?"),
        (MINIMAL + "[suite.a]\n[estimator.x]\nmethod = 'marg-ckf'\nsuite = 'b'\n", "suite: 'b' is unknown"),
        (MINIMAL + "[estimator.x]\nsuite = 'chr'\n", "method: missing; add it"),
        (MINIMAL + "[pilot]\nattitude = 'ckf-chx'\n", "did you mean 'ckf-chr'?"),
        (MINIMAL + "[motion]\nkind = 'sway'\n", "a motion takes neither script nor [[step]]"),
        ("aircraft = 'trainer'\n", "step: missing"),
        ("extends = 'test'\n" + MINIMAL, "leads back to this file"),
        ("extends = 'nowhere'\n" + MINIMAL, "nowhere: no such scenario"),
        ("seed = \n", "not valid TOML"),
    ],
)
def test_a_mistake_gets_one_line_with_file_key_and_remedy(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        scenarios.load(write(tmp_path, text))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "test.toml" in str(caught.value) or "nowhere" in text


def test_missing_file_and_unknown_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        scenarios.load(str(tmp_path / "absent.toml"))
    with pytest.raises(InputError, match="no such scenario"):
        scenarios.load("circuitt")


def test_unknown_estimator_on_the_command_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'ckf-chr'"):
        scenarios.load(write(tmp_path, MINIMAL), estimators=["ckf-ch"])


def test_errors_of_an_estimator_of_the_command_line_name_the_option(tmp_path: Path) -> None:
    (made,) = scenarios.load(write(tmp_path, MINIMAL), estimators=["no_module:C@chr"]).estimators
    assert made.where.endswith(": --estimator no_module:C@chr")


def test_turns_ask_for_the_whole_catalogue() -> None:
    turns = scenarios.load("turns")
    asked = {(e.settings["method"], e.settings.get("aiding", "none")) for e in turns.estimators}
    for method in describe():
        if method.installed:
            assert (method.name, "none") in asked, method.name
    peers = {m.name for m in describe() if not m.own and m.installed and "aiding" in m.settings}
    assert {(name, "airspeed") for name in ("marg-ekf", "marg-ckf", "marg-cdkf", *peers)} <= asked
    listed = [(e.settings["method"], e.settings["suite"], e.settings.get("aiding")) for e in turns.estimators]
    assert len(set(listed)) == len(listed), "none flies twice"
    again = scenarios.parse(turns.data, "again", "again")
    assert again.estimators == tuple(
        scenarios.Component(e.name, e.settings, e.where.replace(turns.where, "again")) for e in turns.estimators
    )


def test_a_peer_that_is_not_installed_is_a_note_and_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    everybody = {e.name for e in scenarios.load("turns").estimators}
    for package in ("vqf", "imufusion", "ahrs", "turbo_ckf", "attipy", "smsfusion"):
        monkeypatch.setitem(sys.modules, package, None)
    turns = scenarios.load("turns")
    here = {e.name for e in turns.estimators}
    peers = ("vqf", "imufusion", "madgwick", "mahony", "ahrs", "turbo-ckf", "attipy", "smsfusion")
    assert here == {name for name in everybody if not name.startswith(peers)}
    (note,) = turns.notes
    assert "vqf" in note and "pip install 'ahrs-sim[peers]'" in note and "\n" not in note
    assert scenarios.load("turns", estimators=["ins21@chr"]).notes == ()
    with pytest.raises(InputError, match=r"no \[estimator.vqf-chr\]"):
        scenarios.load("turns", estimators=["vqf-chr"])


def test_a_catalogue_of_an_unknown_suite_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="suite: 'chx' is unknown"):
        scenarios.load(write(tmp_path, 'catalogue = "chx"\n' + MINIMAL))


def test_the_pilot_of_the_command_line_replaces_that_of_the_file() -> None:
    assert scenarios.load("closed_loop").pilot_attitude == "ins21-chr"
    assert scenarios.load("closed_loop", pilot="ckf-chr").pilot_attitude == "ckf-chr"
    with pytest.raises(InputError, match="did you mean 'ckf-chr'"):
        scenarios.load("closed_loop", pilot="ckf-ch")


def test_the_list_names_source_and_peers(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert cli.main(["list", "estimators"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "Yao 2012" in lines["sekf"]
    assert {m.name for m in describe()} == set(lines)
    for method in (m for m in describe() if not m.own):
        monkeypatch.setitem(sys.modules, method.package, None)
        assert cli.main(["list", "estimators", "--json"]) == 0
        (row,) = (r for r in json.loads(capsys.readouterr().out) if r["name"] == method.name)
        assert f"'{method.package}' is not installed" in row["source"]
        assert row["settings"]["aiding"]["default"] == "none"


def test_the_log_keeps_as_much_of_the_truth_as_asked(tmp_path: Path) -> None:
    assert scenarios.load("circuit").truth_rate == 100.0
    path = write(tmp_path, "truth_rate_hz = 400.0\n" + MINIMAL)
    assert scenarios.load(path).truth_rate == 400.0
    with pytest.raises(InputError, match="truth_rate_hz: 800 is out of range"):
        scenarios.load(write(tmp_path, "truth_rate_hz = 800.0\n" + MINIMAL))
