"""A user's own class, grade and choice of estimators, each in a file of its own."""

import re
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import cli, scenario
from ahrs_sim.errors import InputError
from ahrs_sim.sensors import grade
from ahrs_sim.sensors.suite import SECTIONS
from ahrs_sim.sensors.triad import GyroFigures, InertialFigures

CLASS = """
import numpy as np
from estimators.types import Estimates, blank
class {name}:
    def __init__(self, site, sensors, wrong=""):
        self.wrong = wrong
    def process(self, samples):
        if self.wrong == "raises":
            raise RuntimeError("boom")
        if self.wrong == "in a library":
            np.linalg.inv(np.zeros((3, 3)))
        if self.wrong == "dict":
            return dict(t=samples.t)
        columns = blank(Estimates, len(samples))
        if self.wrong != "no t":
            columns["t"][:] = samples.t
        columns["status"][:] = 1
        columns["q_nb"][:] = [2.0 if self.wrong == "long" else 1.0, 0.0, 0.0, 0.0]
        return Estimates(**columns)
"""


def flight(folder: Path, method: str) -> str:
    path = folder / "flight.toml"
    estimator = f'[estimator.mine]\nmethod = "{method}"\nsuite = "chr"\n'
    path.write_text('extends = "takeoff"\nduration_s = 3.0\nestimators = ["mine"]\n' + estimator)
    return str(path)


@pytest.mark.parametrize(("method", "name"), [("beside_it:Beside", "beside_it"), ("./own.py:Own", "own")])
def test_a_class_beside_the_scenario_flies(
    tmp_path: Path, method: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / f"{name}.py").write_text(CLASS.format(name=method.rpartition(":")[2]))
    assert cli.main(["fly", flight(tmp_path, method), "-o", str(tmp_path / "x.mcap")]) == 0
    assert "mine" in capsys.readouterr().out


def test_a_class_in_the_current_folder_flies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "here_it_is.py").write_text(CLASS.format(name="Here"))
    monkeypatch.chdir(tmp_path)
    command = ["fly", "takeoff", "--duration", "3", "-o", "x.mcap", "--force", "--estimator"]
    assert cli.main([*command, "here_it_is:Here@chr"]) == 0
    assert "here_it_is-Here-chr" in capsys.readouterr().out
    assert cli.main([*command, "./here_it_is.py:Here@chr"]) == 0
    assert cli.main([*command, "nowhere:None@chr"]) == 2
    assert "nowhere:None" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ("raises", "RuntimeError: boom (wrong_one.py, line 9)"),
        ("in a library", "LinAlgError: Singular matrix (wrong_one.py, line 11)"),
        ("dict", "process() returned dict, not estimators.Estimates"),
        ("no t", "other time stamps"),
    ],
)
def test_a_class_that_fails_is_one_line_with_its_place(
    tmp_path: Path, wrong: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "wrong_one.py").write_text(CLASS.format(name="Wrong"))
    path = flight(tmp_path, "wrong_one:Wrong") + ""
    Path(path).write_text(Path(path).read_text() + f'wrong = "{wrong}"\n')
    assert cli.main(["fly", path, "-o", str(tmp_path / "x.mcap"), "--quiet"]) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "estimator 'mine'" in line and reason in line


def test_a_constructor_that_fails_is_one_line_with_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "unmade.py").write_text(
        "import math\nclass Unmade:\n    def __init__(self, site, sensors):\n        self.gain = math.log(0.0)\n"
        "    def process(self, samples):\n        return None\n"
    )
    assert cli.main(["fly", flight(tmp_path, "unmade:Unmade"), "-o", str(tmp_path / "x.mcap"), "--quiet"]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert re.search(r"estimator 'mine' cannot be made: ValueError: .* \(unmade.py, line 4\)", line)


def test_a_quaternion_of_another_length_is_no_attitude(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "long_one.py").write_text(CLASS.format(name="Long"))
    path = flight(tmp_path, "long_one:Long")
    Path(path).write_text(Path(path).read_text() + 'wrong = "long"\n')
    assert cli.main(["fly", path, "-o", str(tmp_path / "x.mcap"), "--json"]) == 0
    assert '"availability": 0.0' in capsys.readouterr().out


def test_a_scenario_chooses_its_estimators(tmp_path: Path) -> None:
    path = tmp_path / "few.toml"
    path.write_text('extends = "takeoff"\nestimators = ["ckf-chr", "ins15@sbg"]\n')
    assert [e.name for e in scenario.load(str(path)).estimators] == ["ckf-chr", "ins15-sbg"]
    path.write_text('extends = "takeoff"\nestimators = ["ckv-chr"]\n')
    with pytest.raises(InputError, match=r"estimators: ckv-chr: .*did you mean 'ckf-chr'"):
        scenario.load(str(path))


def test_a_grade_of_ones_own_with_the_units_of_data_sheets(tmp_path: Path) -> None:
    sheet = '{value = %s, source = "data sheet", mark = "quoted"}'
    (tmp_path / "mine.toml").write_text(
        'title = "mine"\nextends = "chr_6dm"\n'
        f"[gyro]\nnoise_density_mdps_rthz = {sheet % 2.8}\n[accelerometer]\nnoise_density_ug_rthz = {sheet % 70}\n"
    )
    found = grade.load("mine.toml", SECTIONS, where=f"{tmp_path / 'flight.toml'}: [suite.chr]")
    assert found.figures("gyro", GyroFigures).noise_density == pytest.approx(np.radians(2.8e-3))
    assert found.figures("accelerometer", InertialFigures).noise_density == pytest.approx(70e-6 * 9.80665)
    walk = grade.parse({"gyro": {"noise_density_deg_rth": 0.15}}, SECTIONS, "x", "a source")
    entry = walk["gyro"]["noise_density"]
    assert entry.value * entry.factor == pytest.approx(np.sqrt(2.0) * np.radians(0.15) / 60.0)
    with pytest.raises(InputError, match="no such file beside it"):
        grade.load("other.toml", SECTIONS, where=f"{tmp_path / 'flight.toml'}: [suite.chr]")


def test_a_suite_without_baseline_flies_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "suite.toml").write_text('[[flight]]\nscenario = "circuit"\nseeds = [1]\n')
    assert cli.main(["check", str(tmp_path / "suite.toml")]) == 2
    assert "no baseline yet" in capsys.readouterr().err
