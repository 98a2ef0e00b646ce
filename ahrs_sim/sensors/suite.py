"""A sensor suite: the instruments of one grade in one place of the aircraft.

[suite.chr]
grade = "chr_6dm"                    # or parts: "bmi088 + rm3100 + zed_f9p"
position_m = [0.1, 0.0, -0.05]       # FRD from the centre of gravity at the start; absent: there
yaw_deg = 90.0                       # mounting (roll, pitch, yaw), known to the unit: it sends body axes all the same
mounting_error_deg = [0.0, 0.3, 0.0] # and what it does not know of its mounting
instruments = ["imu", "magnetometer"] # absent: all that the grade has
rate_hz = 100.0                      # of the IMU
unit_seed = 7                        # the same unit in flights of other seeds; absent: another unit each flight
correction = "unit.toml"             # taken off its readings (`ahrs_sim.sensors.correction`)
gyro.noise_density_dps_rthz = 0.05   # any figure of the grade
"""

import datetime
import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.truth import Event, Truth
from ahrs_sim.scenario import Component
from ahrs_sim.scenario.table import Table
from ahrs_sim.sensors import correction as corrections
from ahrs_sim.sensors import grade as grade_files
from ahrs_sim.sensors.air_data import AirData, AirFigures
from ahrs_sim.sensors.correction import Correction
from ahrs_sim.sensors.faults import make_faults
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.gnss import Gnss, GnssFigures, Sky
from ahrs_sim.sensors.grade import Grade, Section
from ahrs_sim.sensors.heading import DualAntenna, HeadingFigures
from ahrs_sim.sensors.imu import Imu, ImuFigures
from ahrs_sim.sensors.interferometer import Interferometer, PhaseFigures
from ahrs_sim.sensors.magnetometer import MagFigures, Magnetometer
from ahrs_sim.sensors.records import Record, SuiteBlock
from ahrs_sim.sensors.triad import GyroFigures, InertialFigures
from ahrs_sim.sensors.vibration import MotorFigures
from estimators.types import SensorInfo

SECTIONS: dict[str, Section] = {
    "imu": Section(ImuFigures),
    "gyro": Section(GyroFigures, "rate"),
    "accelerometer": Section(InertialFigures, "acceleration"),
    "motor": Section(MotorFigures),
    "magnetometer": Section(MagFigures, "field"),
    "gnss": Section(GnssFigures),
    "heading": Section(HeadingFigures),
    "air_data": Section(AirFigures),
    "interferometer": Section(PhaseFigures),
}
"""The tables of a grade."""

INSTRUMENTS = ("imu", "magnetometer", "gnss", "heading", "air_data", "interferometer")
"""What `instruments` can name; an instrument is there when the grade has its table."""


class Instrument(Protocol):
    """An instrument as a suite uses it."""

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records that it sends."""
        ...

    def sense(self, truth: Truth) -> dict[str, Record]:
        """Sense a block of the truth; return the records that arrive within it, by name."""
        ...

    def info(self) -> dict[str, Any]:
        """Return its fields of `SensorInfo`: data sheet figures, SI."""
        ...

    def drawn(self) -> dict[str, Any]:
        """Return the errors that were drawn for this flight, SI."""
        ...


class Suite:
    """The instruments of one unit; made by `make_suite`."""

    def __init__(self, fitting: Fitting, has: Sequence[str], correction: Correction | None) -> None:
        self.name = fitting.suite
        self.grade = fitting.grade
        self.has = tuple(has)  # of `INSTRUMENTS`
        self._faults, self._correction = fitting.faults, correction
        imu = Imu(fitting)
        sky = Sky(fitting.figures("gnss", GnssFigures), fitting.epoch, fitting.faults)
        make: dict[str, Callable[[], Instrument]] = {
            "imu": lambda: imu,
            "magnetometer": lambda: Magnetometer(fitting),
            "gnss": lambda: Gnss(fitting, sky, imu),
            "heading": lambda: DualAntenna(fitting, sky),
            "air_data": lambda: AirData(fitting),
            "interferometer": lambda: Interferometer(fitting),
        }
        self._instruments = [make[name]() for name in has]

    @property
    def instruments(self) -> tuple[str, ...]:
        """Names of the records of a block, in their order."""
        return tuple(name for i in self._instruments for name in i.records)

    def sense(self, truth: Truth) -> SuiteBlock:
        """Sense a block of the truth with every instrument; return the records that arrive within it.

        Blocks of any length give the same records.
        """
        self._faults.watch(truth.t)
        block: SuiteBlock = {}
        for instrument in self._instruments:
            block.update(instrument.sense(truth))
        return block if self._correction is None else self._correction.records(block)

    def take_events(self) -> list[Event]:
        """Collect the events of faults that began or ended since the last call."""
        return self._faults.take_events()

    @property
    def info(self) -> SensorInfo:
        """Data sheet figures of the suite, nothing that was drawn."""
        values: dict[str, Any] = {}
        for instrument in self._instruments:
            values |= instrument.info()
        return SensorInfo(**(values if self._correction is None else self._correction.sheet(values)))

    def drawn(self) -> dict[str, np.ndarray]:
        """Return the errors that were drawn for this flight, SI, in the sensors' axes."""
        return {name: np.asarray(value) for i in self._instruments for name, value in i.drawn().items()}

    def specification(self) -> dict[str, str]:
        """Describe effective figures with sources, and errors drawn for this flight, as flat texts for the log."""
        flat = {"grade": self.grade.name, "title": self.grade.title, "instruments": " ".join(self.instruments)}
        for section, entry in self.grade.rows():
            flat[f"{section}.{entry.key}"] = f"{entry.text} ({entry.mark}: {entry.source})"
        for name, value in self.drawn().items():
            flat[f"drawn.{name}"] = " ".join(repr(float(x)) for x in value.ravel())
        return flat | (self._correction.specification() if self._correction else {})


def make_suite(
    component: Component, *, seed: int, dt: float, epoch: datetime.datetime, start_lla: np.ndarray,
    faults: Sequence[Component] = (),
) -> Suite:  # fmt: skip
    """Make the suite of a scenario's `[suite.NAME]` table.

    Args:
        component: the table.
        seed: the scenario's.
        dt: s between rows of the truth.
        epoch: date of t = 0.
        start_lla: (3,) rad, rad, m: where the flight begins.
        faults: the scenario's; those of other suites are checked and left alone.

    Raises:
        InputError: anything wrong in the table, its grade or its faults: where, which key, what to do.
    """
    table = component.table()
    name = table.text("grade")
    position = table.vector("position_m", [0.0, 0.0, 0.0])
    roll, pitch, yaw = (math.radians(table.number(f"{axis}_deg", 0.0)) for axis in ("roll", "pitch", "yaw"))
    error = np.radians(table.vector("mounting_error_deg", [0.0, 0.0, 0.0]))
    wanted = table.value("instruments", None)
    rate = table.number("rate_hz", None, above=0.0)
    unit_seed = table.integer("unit_seed", minimum=0) if table.has("unit_seed") else seed
    corrected = table.text("correction", None)
    correction = None if corrected is None else corrections.load(corrected, component.where)
    grade = grade_files.load(name, SECTIONS, _with_rate(table.rest(), rate), component.where)
    has = _choose(grade, wanted, table)
    fitting = Fitting(
        suite=component.name,
        grade=grade,
        faults=make_faults(faults, suite=component.name, instruments=has, seed=seed),
        seed=seed,
        unit_seed=unit_seed,
        dt=dt,
        epoch=epoch,
        start_lla=start_lla,
        position=position,
        mount=attitude.matrix(roll, pitch, yaw).T,
        mounting_error=attitude.matrix(*error).T,
        where=component.where,
    )
    return Suite(fitting, has, correction)


def grades() -> list[dict[str, str]]:
    """List every figure of every grade, for `ahrs-sim list grades`; the first row of a grade is its title."""
    rows = []
    for name in grade_files.names():
        grade = grade_files.load(name, SECTIONS)
        rows.append({"grade": name, "figure": grade.title, "mark": "", "source": ""})
        for section, entry in grade.rows():
            figure = f"{section}.{entry.key} = {entry.text}"
            rows.append({"grade": name, "figure": f"{figure:60s}", "mark": f"{entry.mark:9s}", "source": entry.source})
    return rows


def _with_rate(overrides: dict[str, Any], rate: float | None) -> dict[str, Any]:
    if rate is None:
        return overrides
    return {**overrides, "imu": {**overrides.get("imu", {}), "rate_hz": rate}}


def _choose(grade: Grade, wanted: Any, table: Table) -> tuple[str, ...]:
    """Choose the instruments to carry: `wanted`, or all that the grade has."""
    there = tuple(name for name in INSTRUMENTS if name in grade)
    if "imu" not in there:
        raise table.error("grade", f'{grade.name} has no imu; put it together with one: "bmi088 + {grade.name}"')
    if wanted is None:
        return there
    if not isinstance(wanted, list) or not all(isinstance(x, str) for x in wanted):
        raise table.error("instruments", f"{wanted!r} is not a list of names; known: {', '.join(there)}")
    for name in wanted:
        if name not in there:
            raise InputError(f"{table.where}: instruments: the grade has no '{name}'{nearest(name, there)}")
    if "imu" not in wanted:
        raise table.error("instruments", 'a suite needs its imu; add "imu"')
    return tuple(name for name in there if name in wanted)
