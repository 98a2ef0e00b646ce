"""Scenarios: what is accepted, and the one line a mistake gets."""

import math
from pathlib import Path

import pytest

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError

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
