"""The command line as a whole; what single commands do is tested with what they use."""

import argparse
import re
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from ahrs_sim import cli, scenario
from ahrs_sim.cli import fly


def output_of(*arguments: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 0
    return capsys.readouterr().out


def test_help_names_every_command_once_and_in_order(capsys: pytest.CaptureFixture[str]) -> None:
    names = re.findall(r"^    ([\w-]+) ", output_of("--help", capsys=capsys), re.M)
    modules = [command.__name__.rpartition(".")[2] for command in cli._COMMANDS]
    assert names == [name.replace("listing", "list").replace("_", "-") for name in modules]
    assert len(names) == len(set(names)) and names[0] == "fly"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert output_of("--version", capsys=capsys) == f"ahrs-sim {version('ahrs-sim')}\n"


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "ahrs_sim", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"ahrs-sim {version('ahrs-sim')}\n"
    wrong = subprocess.run([sys.executable, "-m", "ahrs_sim", "info", "absent.mcap"], capture_output=True, text=True)
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert wrong.stderr.startswith("ahrs-sim: absent.mcap")


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_names_every_command(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    script = output_of("--completion", shell, capsys=capsys)
    assert all(command in script for command in ("fly", "replay", "schema", "--duration"))
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=script.encode(), check=True)


def test_an_unknown_shell_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main(["--completion", "dos"])
    assert "known: bash" in capsys.readouterr().err


def test_grades_are_a_line_each_and_one_in_full_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list", "grades"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len({line.split()[0] for line in lines}) > 5
    assert cli.main(["list", "grades", "chr_6dm"]) == 0
    assert "imu.rate_hz = 100" in capsys.readouterr().out
    assert cli.main(["list", "grades", "chr_6d"]) == 2
    assert "did you mean 'chr_6dm'" in capsys.readouterr().err


def test_an_estimator_by_name_has_its_settings(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list", "estimators", "hand-ins"]) == 0
    assert "\n  align_s = 20.0  # s, stationary stretch that is averaged; at least 1" in capsys.readouterr().out
    assert cli.main(["list", "manoeuvres", "turn"]) == 0
    assert "  bank_deg = number" in capsys.readouterr().out


def test_lists_fit_the_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert cli.main(["list", "estimators"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert sum(not line.startswith(" ") for line in lines) >= 20


def test_a_fault_after_the_end_is_reported_before_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "late.toml"
    path.write_text(
        'duration_s = 2.0\n[motion]\nkind = "sway"\n[suite.chr]\ngrade = "chr_6dm"\n[estimator]\n'
        '[[fault]]\nsensor = "gyro"\nkind = "bias"\nsize_dps = 1.0\nat_s = 900.0\n'
    )
    assert cli.main(["fly", str(path), "-o", str(tmp_path / "a.mcap")]) == 0
    error = capsys.readouterr().err
    assert "late.toml: [[fault]] 1: at_s = 900: never happens, the flight ends at 2 s" in error
    assert scenario.load(str(path), duration=1000.0).notes == ()
    assert len(scenario.load(str(path)).unreached(100.0)) == 1


def test_a_run_of_a_campaign_has_a_log_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    circuit, asked = scenario.load("circuit"), argparse.Namespace(output=None, force=False)
    assert fly.output_of(asked, circuit) == Path("logs/circuit-seed1.mcap")
    assert fly.output_of(argparse.Namespace(**vars(asked), number=56), circuit) == Path("logs/circuit-run56.mcap")
