"""Tables of a log: names, units, numbers; the examples of the documentation run."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest

import ahrs_sim
from ahrs_sim import cli
from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError
from ahrs_sim.log import layouts
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.layouts.__main__ import ESTIMATORS, SUITES
from ahrs_sim.review.export import export

ROOT = Path(__file__).parents[2]


def test_parquet_has_numbers_and_units(flown: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    (path,) = export(flown, "parquet", tmp_path, ["/chr/imu/data_raw"])
    assert path.name == "chr_imu_data_raw.parquet"
    table = parquet.read_table(path)
    with FlightReader(flown) as log:
        imu = log.record("chr", "imu")
    assert np.array_equal(table["angular_velocity.x"].to_numpy(), imu.gyro_b[:, 0])
    assert table["t"].to_numpy() == pytest.approx(imu.stamp_ns / 1e9)
    field = table.schema.field("linear_acceleration.z")
    assert field.metadata[b"unit"] == b"m/s2"
    assert table.schema.metadata[b"type"] == b"sensor_msgs/msg/Imu"


def test_csv_of_everything(flown: Path, tmp_path: Path) -> None:
    files = {p.name for p in export(flown, "csv", tmp_path, ["/events", "/truth/air", "/sbg/gps/fix"])}
    assert files == {"events.csv", "truth_air.csv", "sbg_gps_fix.csv"}
    air = pandas.read_csv(tmp_path / "truth_air.csv")
    assert air["airspeed"].max() > 10
    assert "step 1 (wait) begins" in (tmp_path / "events.csv").read_text()


def test_units_of_our_own_types(flown: Path) -> None:
    with ahrs_sim.read_log(flown) as log:
        units = log["/est/ekf-chr/state"].attrs["units"]
        assert units["gyro_bias.x"] == "rad/s" and units["lla.1"] == "rad" and units["lla.2"] == "m"
        assert log["/truth/air"].attrs["units"]["wind.x"] == "m/s"


def test_frames_agree_with_compare(flown: Path) -> None:
    from ahrs_sim.review import compare

    with ahrs_sim.read_log(flown) as log:
        assert log.estimators == ["ekf-chr", "ekf-sbg"]
        assert "/chr/imu/mag" in log and len(log["/chr/imu/mag"]) > 1000
        errors = log.errors("ekf-chr")
        wanted = compare.compare(flown)["estimators"]["ekf-chr"]
        assert np.sqrt((errors["roll"] ** 2).mean()) == pytest.approx(wanted["roll_rmse_deg"], rel=1e-5)
        truth, estimate = log.truth(), log.estimates("ekf-chr")
        assert truth["height"].max() > 30 and estimate["status"].max() == 1
        with pytest.raises(KeyError):
            log["/nothing"]


def test_import_is_light() -> None:
    code = "import sys, ahrs_sim; sys.exit(any(m in sys.modules for m in ('pandas', 'numpy', 'scipy')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_command(flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = str(tmp_path / "tables")
    assert cli.main(["export", str(flown), "--to", "csv", "--topic", "/events", "-o", where]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "tables" / "events.csv")
    assert cli.main(["export", str(flown), "--to", "csv", "--topic", "/event", "-o", where]) == 2
    assert "did you mean '/events'" in capsys.readouterr().err
    with pytest.raises(InputError, match="no messages that fit"):
        export(flown, "csv", tmp_path, ["/tf"])


def test_shipped_layout_is_that_of_the_circuit() -> None:
    import json

    (shipped,) = layouts.describe()
    assert json.loads(Path(shipped["path"]).read_text()) == layouts.build(SUITES, ESTIMATORS)
    circuit = scenarios.load("circuit")
    assert tuple(SUITES) == tuple(s.name for s in circuit.suites)
    assert tuple(ESTIMATORS) == tuple(e.name for e in circuit.estimators)


def test_layout_shows_what_is_in_the_log(flown: Path, tmp_path: Path) -> None:
    import json

    layout = json.loads(layouts.of_log(flown, tmp_path / "layout.json").read_text())
    with FlightReader(flown) as log:
        for key, panel in layout["configById"].items():
            for path in panel.get("paths", []):
                topic, _, fields = path["value"].partition(".")
                dtype = log.dtype(topic)
                for field in re.sub(r"\[\d+\]", "", fields.removesuffix(".@rad2deg")).split("."):
                    assert field in (dtype.names or ()), f"{key}: {path['value']}"
                    dtype = dtype[field]


@pytest.mark.long
def test_examples_of_the_documentation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib").use("agg")
    plt = pytest.importorskip("matplotlib.pyplot")
    text = (ROOT / "docs" / "notebook.md").read_text()
    cells = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(cells) >= 4
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for cell in cells:
        exec(compile(cell, "docs/notebook.md", "exec"), names)
    assert (tmp_path / "errors.png").exists()
    plt.close("all")
