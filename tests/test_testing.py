"""The pytest plugin, used as a user would, and the example of the documentation."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from ahrs_sim.testing import FlyScenario, accuracy, assert_accuracy

ROOT = Path(__file__).parents[1]


def test_figures_within_their_limits(fly_scenario: FlyScenario) -> None:
    log = fly_scenario("sway", duration=70, estimators=["ekf-chr"])
    found = accuracy(log)["ekf-chr"]
    assert_accuracy(log, {"ekf-chr": {"tilt_rmse_deg": found["tilt_rmse_deg"], "availability": 0.5}})


def test_every_figure_that_does_not_hold_is_named(fly_scenario: FlyScenario) -> None:
    log = fly_scenario("sway", duration=70, estimators=["ekf-chr"])
    with pytest.raises(AssertionError) as failure:
        assert_accuracy(
            log,
            {
                "ekf-chr": {"tilt_rmse_deg": 1e-6, "heading_p95_deg": 1e-6, "availability": 1.01, "tilt_rmse": 1.0},
                "ekf-crh": {"tilt_rmse_deg": 1.0},
            },
        )
    text = str(failure.value)
    for words in (
        "tilt_rmse_deg is",
        "heading_p95_deg is",
        "availability is",
        "did you mean",
        "ekf-crh: not in the log",
    ):
        assert words in text, text


def test_the_same_flight_is_flown_once(fly_scenario: FlyScenario) -> None:
    tables = {"mine": {"method": "marg-ekf", "suite": "chr"}}
    one = fly_scenario("sway", duration=3, estimators=tables)
    assert fly_scenario("sway", duration=3, estimators=tables) == one
    assert fly_scenario("sway", duration=3, seed=5, estimators=tables) != one


@pytest.mark.long
def test_workers_share_flights(tmp_path: Path) -> None:
    """Each of two files is on a worker of its own."""
    for number in (1, 2):
        (tmp_path / f"test_{number}.py").write_text(
            "import os\nfrom pathlib import Path\n\n"
            "def test_it(fly_scenario):\n"
            '    log = fly_scenario("sway", duration=3, estimators=["ekf-chr"])\n'
            f'    Path("{number}.txt").write_text(f"{{log}} {{log.stat().st_ino}} {{log.stat().st_mtime_ns}}")\n'
            f'    Path("worker{number}.txt").write_text(os.environ["PYTEST_XDIST_WORKER"])\n'
        )
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n",
        "2",
        "--dist",
        "loadfile",
        "-p",
        "no:cacheprovider",
        "--rootdir",
    ]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    done = subprocess.run(
        [*command, str(tmp_path), str(tmp_path)], capture_output=True, text=True, cwd=tmp_path, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    workers = [(tmp_path / f"worker{number}.txt").read_text() for number in (1, 2)]
    assert workers[0] != workers[1]
    assert (tmp_path / "1.txt").read_text() == (tmp_path / "2.txt").read_text()


def test_the_documented_example_runs(tmp_path: Path) -> None:
    document = (ROOT / "docs" / "regression.md").read_text()
    blocks = re.findall(r"```python\n# (\S+)\n(.*?)```", document, re.DOTALL)
    assert {name for name, _ in blocks} == {"my_filter.py", "test_my_filter.py"}
    for name, code in blocks:
        (tmp_path / name).write_text(code)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--rootdir",
        str(tmp_path),
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
