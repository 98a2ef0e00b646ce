"""The command line as a whole; what single commands do is tested with what they use."""

import re
import shutil
import subprocess
import sys
from importlib.metadata import version

import pytest

from ahrs_sim import cli


def output_of(*arguments: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 0
    return capsys.readouterr().out


def test_help_names_every_command_once_and_in_order(capsys: pytest.CaptureFixture[str]) -> None:
    names = re.findall(r"^    (\w+) ", output_of("--help", capsys=capsys), re.M)
    assert names == [command.__name__.rpartition(".")[2].replace("listing", "list") for command in cli._COMMANDS]
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
