"""The reference and the schemas follow the readers: every shipped file is valid, and what a reader refuses is not."""

import dataclasses
import datetime
import re
import runpy
import subprocess
import tomllib
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from ahrs_sim import reference, scenario
from ahrs_sim.errors import InputError
from ahrs_sim.review import estimator_page
from ahrs_sim.scenario.shipped import scenario_dir
from estimators import Estimates, Samples, SensorInfo, Site, describe

ROOT = Path(__file__).parents[1]
GRADES = ROOT / "ahrs_sim" / "sensors" / "grades"


def plain(value: Any) -> Any:
    """TOML data as JSON has them."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [plain(v) for v in value]
    return value.isoformat() if isinstance(value, datetime.datetime) else value


@pytest.fixture(scope="module")
def scenarios() -> jsonschema.Draft202012Validator:
    made = reference.schema("scenario")
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


@pytest.mark.parametrize("path", sorted(scenario_dir().glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_scenarios_are_valid(path: Path, scenarios: jsonschema.Draft202012Validator) -> None:
    scenarios.validate(plain(tomllib.loads(path.read_text())))


@pytest.fixture(scope="module")
def grades() -> jsonschema.Draft202012Validator:
    made = reference.schema("grade")
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


@pytest.mark.parametrize("path", sorted(GRADES.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_grades_are_valid(path: Path, grades: jsonschema.Draft202012Validator) -> None:
    grades.validate(plain(tomllib.loads(path.read_text())))


def test_the_standard_suite_is_valid() -> None:
    suite = (ROOT / "tests" / "baselines" / "standard.toml").read_text()
    jsonschema.validate(plain(tomllib.loads(suite)), reference.schema("suite"))


@pytest.mark.parametrize(
    "text",
    [
        "seeed = 1",
        "seed = -1",
        'seed = "one"',
        "[start]\nlatitude_deg = 95.0",
        '[wind]\nturbulence = "wild"',
        '[[step]]\ndo = "turn"\nbnak_deg = 30.0',
        '[[step]]\ndo = "wait"',
        '[[step]]\ndo = "tumble"',
        '[motion]\nkind = "sway"\nspeed_mps = 3.0',
        '[suite.chr]\ngrade = "chr_6dm"\n[suite.chr.gyro]\nnoise_density_furlongs = 1.0',
    ],
)
def test_what_a_reader_refuses_the_schema_refuses(
    text: str, scenarios: jsonschema.Draft202012Validator, tmp_path: Path
) -> None:
    assert not scenarios.is_valid(plain(tomllib.loads(text)))
    file = tmp_path / "wrong.toml"
    file.write_text('extends = "sway"\n' + text if "motion" in text else 'extends = "takeoff"\n' + text)
    from ahrs_sim.flight import open_flight
    from ahrs_sim.sensors import make_suite

    with pytest.raises(InputError):
        loaded = scenario.load(str(file))
        for component in loaded.suites:
            epoch = datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC)
            make_suite(component, seed=0, dt=0.0025, epoch=epoch, start_lla=[0.7, 0.0, 0.0])  # type: ignore[arg-type]
        open_flight(loaded)


def test_map_and_its_units() -> None:
    made = reference.schema("map")
    jsonschema.validate({"imu": {"gyro_unit": "deg/s"}, "frames": {"body": "FLU"}}, made)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"imu": {"gyro_unit": "deg per s"}}, made)


def test_manoeuvres_say_what_they_need() -> None:
    keys = reference.manoeuvres()["wait"][1]
    assert keys["for_s"].required and keys["for_s"].above == 0.0
    turn = reference.manoeuvres()["turn"][1]
    assert not turn["bank_deg"].required and reference.unit("bank_deg") == "deg"


def test_the_page_is_up_to_date() -> None:
    page = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    assert page == reference.markdown(), "run: python -m ahrs_sim.reference"


def test_the_readme_says_what_each_row_of_its_table_uses() -> None:
    block = (
        (ROOT / "README.md").read_text(encoding="utf-8").partition("<!-- circuit: begin -->")[2].partition("<!--")[0]
    )
    tables = re.findall(r"^```text\n(.*?)^```", block, re.MULTILINE | re.DOTALL)
    plain_rows, aided_rows = (re.findall(r"^([\w-]+) +[\d.]+ / ", table, re.MULTILINE) for table in tables)
    circuit = {e.name: e.settings for e in scenario.load("circuit").estimators}
    assert sorted(plain_rows) == sorted(circuit)
    legend = [pattern for row in re.findall(r"^\| `(.*?)` \|", block, re.MULTILINE) for pattern in row.split(", ")]
    assert all(any(fnmatch(name, pattern) for pattern in legend) for name in circuit)
    aided = {m.name: m.settings["heading_aid"].default for m in describe() if m.own and "heading_aid" in m.settings}
    assert not aided["air-ins"]
    assert not [n for n, s in circuit.items() if s.get("heading_aid", aided.get(str(s["method"]), False))]
    assert sorted(aided_rows) == sorted(f"{n}-2ant" for n, s in circuit.items() if s["method"] in aided)
    for condition in (
        "scenario `circuit` (seed 1)",
        "CHR-6dm and SBG IG-500 grades",
        "vibration",
        "wind 4 m/s",
        "gusts",
    ):
        assert condition in " ".join(block.split()), condition


def test_the_contract_describes_every_field() -> None:
    for cls in (Samples, Estimates, Site, SensorInfo):
        described = re.findall(r"^        (\w+): ", cls.__doc__ or "", re.MULTILINE)
        assert described == [f.name for f in dataclasses.fields(cls)], cls.__name__


def test_the_site_has_every_page_and_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of estimators apart, which takes a linker and minutes; `.ci/run` builds it."""
    monkeypatch.setattr(estimator_page, "write", lambda path, scenario: None)
    build = runpy.run_path(str(ROOT / "docs" / "site" / "build.py"))
    build["write"](tmp_path / "site")
    listed = [page for pages in build["PAGES"].values() for page in pages]
    assert {f"docs/{p.stem}" for p in (ROOT / "docs").glob("*.md")} == {p for p in listed if p.startswith("docs/")}
    for page in listed:
        assert (tmp_path / "site" / f"{page}.md").read_text().startswith(("#", "---")), page
    commands = (tmp_path / "site" / "reference" / "commands.md").read_text()
    assert "## replay" in commands and "--against NAME" in commands


def test_tutorials_are_scripts(tmp_path: Path) -> None:
    script = runpy.run_path(str(ROOT / ".ci" / "newcomers.py"))["script"]
    tutorials = sorted((ROOT / "docs").glob("tutorial-*.md"))
    assert len(tutorials) == 3
    for tutorial in tutorials:
        text = script(tutorial)
        assert subprocess.run(["bash", "-n", "-c", text], check=False).returncode == 0
        assert text.count("ahrs-sim ") >= 6


def test_every_key_that_a_manoeuvre_speaks_of_is_listed() -> None:
    for name, (text, keys) in reference.manoeuvres().items():
        spoken = set(re.findall(r"`(\w+_(?:m|s|deg|mps|dps|g))`", text))
        assert spoken <= keys.keys(), name
