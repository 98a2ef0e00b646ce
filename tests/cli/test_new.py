"""`ahrs-sim new scenario|grade|suite`: each file works as it is written, and nothing is overwritten."""

import json
import re
from pathlib import Path

import pytest

from ahrs_sim import cli

pytestmark = pytest.mark.usefixtures("pool_here")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_new_scenario_flies_with_a_new_grade(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", "scenario", "mine"]) == 0
    assert cli.main(["new", "grade", "unit"]) == 0
    assert "ahrs-sim fly mine.toml" in capsys.readouterr().out
    text = Path("mine.toml").read_text().replace('grade = "chr_6dm"', 'grade = "unit.toml"')
    Path("mine.toml").write_text(text)
    command = ["fly", "mine.toml", "--estimator", "ekf-chr", "-o", "x.mcap", "--json"]
    assert cli.main(command) == 0
    result = json.loads(capsys.readouterr().out)
    assert 60.0 < result["to_s"] < 120.0
    assert result["estimators"]["ekf-chr"]["availability"] > 0.7
    assert result["estimators"]["ekf-chr"]["tilt_rmse_deg"] < 5.0
    assert {"ground", "turning"} <= set(result["estimators"]["ekf-chr"]["phases"])


def test_what_a_new_scenario_has_commented_out_flies_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", "scenario", "mine"]) == 0
    text = Path("mine.toml").read_text()
    opened = re.sub(r"(?m)^# (\[\[fault\]\]|[a-z_.]+ = )", r"\1", text)
    assert opened.count("\n# ") == text.count("\n# ") - 8  # two of the suite, six of the fault
    Path("mine.toml").write_text(opened)
    assert cli.main(["fly", "mine.toml", "--duration", "3", "--estimator", "ekf-chr", "-o", "x.mcap", "--quiet"]) == 0


def test_a_new_suite_becomes_its_baseline_and_passes(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", "suite", "mine"]) == 0
    assert 'ahrs-sim check mine.toml --renew --why "first baseline"' in capsys.readouterr().out
    short = re.sub(
        r"duration_s = 60.0\nseeds = \[1, 2, 3\]", "duration_s = 8.0\nseeds = [1]", Path("mine.toml").read_text()
    )
    Path("mine.toml").write_text(short)
    assert cli.main(["check", "mine.toml", "--renew", "--why", "first baseline", "--workers", "1"]) == 0
    assert Path("mine.json").is_file()
    assert cli.main(["check", "mine.toml", "--workers", "1"]) == 0


@pytest.mark.parametrize("what", ["scenario", "grade", "suite", "estimator"])
def test_nothing_is_overwritten(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine").mkdir()
    Path("mine.toml").write_text("kept")
    assert cli.main(["new", what, "mine"]) == 2
    assert re.fullmatch(r"ahrs-sim: mine(\.toml)?: exists; choose another NAME or -o\n", capsys.readouterr().err)
    assert Path("mine.toml").read_text() == "kept" and not list(Path("mine").iterdir())


def test_wrong_names_and_options_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", "scenario", "1st"]) == 2
    assert cli.main(["new", "grade", "mine", "--lang", "c"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2 and "a letter first" in lines[0] and "--lang is for an estimator" in lines[1]
    assert not list(Path().iterdir())


def test_elsewhere(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", "suite", "mine", "-o", "flights/accuracy.toml"]) == 0
    text = Path("flights/accuracy.toml").read_text()
    assert "ahrs-sim check flights/accuracy.toml" in text and "commit flights/accuracy.json" in text
    assert "[estimator.mine]" in text
