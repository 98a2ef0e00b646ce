"""A sensor suite as a co-simulation unit, run by FMPy, against the suite on the whole block."""

import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ahrs_sim import attitude, cli, scenario
from ahrs_sim.flight.truth import Truth
from ahrs_sim.plugins import sensor_unit
from ahrs_sim.plugins.fmu_host import INPUTS
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.assemble import Assembler
from estimators.types import blank

fmpy = pytest.importorskip("fmpy")

DT, ROWS = 0.0025, 800


def truth() -> Truth:
    """Two seconds of swinging in the air."""
    columns, t = blank(Truth, ROWS), np.arange(ROWS) * DT
    columns["t"][:] = t
    columns["lla"][:] = np.column_stack([0.76 + 3e-6 * t, 0.02 + 1e-6 * t, 300.0 + t])
    columns["vel_n"][:] = np.column_stack([19.0 + np.sin(t), 5.0 * np.cos(t), -np.ones(ROWS)])
    columns["q_nb"][:] = attitude.from_euler(np.column_stack([0.3 * np.sin(t), 0.1 * np.cos(t), 0.2 + 0.1 * t]))
    for name in ("rate_ib_b", "rate_dot_b", "cg_b", "wind_n"):
        columns[name][:] = 0.1 * np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    columns["accel_b"][:] = np.array([0.3, 0.2, -9.8]) + np.sin(np.outer(t, [2.0, 1.0, 3.0]))
    values = {"airspeed": 20.0, "alpha": 0.04, "beta": 0.01, "pressure": 98000.0, "temperature": 287.0, "rpm": 5000.0}
    for name, value in (values | {"throttle": 0.6, "height_agl": 150.0}).items():
        columns[name][:] = value * (1.0 + 0.01 * np.sin(t))
    columns["on_ground"][:] = t < 0.3
    return Truth(**columns)


def given(unit: Any, row: Truth, references: dict[str, int]) -> None:
    """Set the inputs of a unit to a row of the truth."""
    numbers = {n: (c, i) for n, (c, i) in sensor_unit.TRUTH.items() if n != "true_on_ground"}
    values = [float(np.ravel(getattr(row, column))[index]) for column, index in numbers.values()]
    set_numbers = unit.setFloat64 if hasattr(unit, "setFloat64") else unit.setReal
    set_numbers([references[name] for name in numbers], values)
    unit.setBoolean([references["true_on_ground"]], [bool(row.on_ground[0])])


def run(path: Path, block: Truth, seed: int) -> dict[str, np.ndarray]:
    """Outputs of the unit at the steps in which a sample came."""
    folder = fmpy.extract(str(path))
    described = fmpy.read_model_description(str(path))
    references = {v.name: v.valueReference for v in described.modelVariables}
    three = described.fmiVersion == "3.0"
    unit = (fmpy.fmi3.FMU3Slave if three else fmpy.fmi2.FMU2Slave)(
        guid=described.guid, unzipDirectory=folder, instanceName="sensors",
        modelIdentifier=described.coSimulation.modelIdentifier,
    )  # fmt: skip
    unit.instantiate()
    (unit.setInt32 if three else unit.setInteger)([references["seed"]], [seed])
    if three:
        unit.enterInitializationMode(startTime=-DT)
    else:
        unit.setupExperiment(startTime=-DT)
        unit.enterInitializationMode()
    unit.exitInitializationMode()
    flags = [name for name in INPUTS if name.endswith("_new")]
    numbers = [name for name in INPUTS if name not in flags]
    found: dict[str, list[float]] = {name: [] for name in INPUTS}
    for k in range(len(block)):
        given(unit, block[k : k + 1], references)
        unit.doStep(currentCommunicationPoint=(k - 1) * DT, communicationStepSize=DT)
        if unit.getBoolean([references["sample_new"]])[0]:
            for names, get in ((numbers, unit.getFloat64 if three else unit.getReal), (flags, unit.getBoolean)):
                for name, value in zip(names, get([references[n] for n in names]), strict=True):
                    found[name].append(value)
    unit.terminate()
    unit.freeInstance()
    return {name: np.array(values) for name, values in found.items()}


ALONE = """
import os, sys, pathlib, numpy
import test_sensor_unit as test
numpy.savez(sys.argv[2], **test.run(pathlib.Path(sys.argv[1]), test.truth(), int(sys.argv[3])))
os._exit(0)
"""
"""In a process that ends at once: PythonFMU's library crashes when an interpreter that loaded it comes to its end."""


@pytest.mark.parametrize(("fmi", "library"), [("2.0", "pythonfmu"), ("3.0", "pythonfmu3")])
def test_the_unit_reads_what_the_suite_reads(
    tmp_path: Path, fmi: str, library: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip(library)
    path, block, seed = tmp_path / "chr.fmu", truth(), 7
    assert cli.main(["export-fmu", "--sensors", "chr", "--fmi", fmi, "-o", str(path)]) == 0
    assert fmpy.read_model_description(str(path)).fmiVersion == fmi
    assert "sensors of chr" in capsys.readouterr().out
    command = [sys.executable, "-c", ALONE, str(path), str(tmp_path / "read.npz"), str(seed)]
    subprocess.run(command, cwd=Path(__file__).parent, check=True)
    found = dict(np.load(tmp_path / "read.npz"))
    made = scenario.load("circuit")
    component = next(c for c in made.suites if c.name == "chr")
    suite = make_suite(component, seed=seed, dt=DT, epoch=made.epoch, start_lla=block.lla[0], faults=made.faults)
    samples = Assembler().assemble(suite.sense(block))
    assert len(samples) == len(found["t"]) > 100 and samples.gnss_new.any() and samples.air_new.any()
    for name, (column, index) in INPUTS.items():
        wanted = getattr(samples, column)
        np.testing.assert_array_equal(found[name], wanted if index < 0 else wanted[:, index], err_msg=name)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ([], "give a METHOD, or --sensors SUITE"),
        (["marg-ekf", "--sensors", "chr"], "give a METHOD, or --sensors SUITE"),
        (["--sensors", "chx"], "has no such suite; did you mean 'chr'?"),
        (["--sensors", "chr", "--setting", "x=1"], "--setting is for a METHOD"),
    ],
)
def test_what_is_no_unit_is_one_line(
    tmp_path: Path, arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["export-fmu", *arguments, "-o", str(tmp_path / "x.fmu")]) == 2
    error = capsys.readouterr().err
    assert line in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_every_column_of_the_truth_is_an_input() -> None:
    covered = {column for column, _ in sensor_unit.TRUTH.values()}
    assert covered == {f.name for f in dataclasses.fields(Truth)} - {"t"}
