"""A sensor suite: the instruments of one grade in one place of the aircraft.

[suite.chr]
grade = "chr_6dm"
position_m = [0.1, 0.0, -0.05]       # FRD from the aircraft's reference; absent: at the centre of gravity
yaw_deg = 90.0                       # mounting (roll, pitch, yaw), known to the unit: it sends body axes all the same
mounting_error_deg = [0.0, 0.3, 0.0] # and what it does not know of its mounting
instruments = ["imu", "magnetometer"] # absent: all that the grade has
rate_hz = 100.0                      # of the IMU
gyro.noise_density_dps_rthz = 0.05   # any figure of the grade
"""

import datetime
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from ahrs_sim import seeds
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.truth import Event, Truth
from ahrs_sim.scenario import Component
from ahrs_sim.sensors import grade as grades
from ahrs_sim.sensors.faults import make_faults
from ahrs_sim.sensors.grade import Grade, Section
from ahrs_sim.sensors.imu import Imu, ImuFigures
from ahrs_sim.sensors.magnetometer import MagFigures, Magnetometer
from ahrs_sim.sensors.records import Record, SuiteBlock
from ahrs_sim.sensors.signal import rotation
from ahrs_sim.sensors.triad import GyroFigures, InertialFigures
from ahrs_sim.sensors.vibration import MotorFigures
from ahrs_sim.table import Table
from estimators.types import SensorInfo

SECTIONS: dict[str, Section] = {
    "imu": Section(ImuFigures),
    "gyro": Section(GyroFigures, "rate"),
    "accelerometer": Section(InertialFigures, "acceleration"),
    "motor": Section(MotorFigures),
    "magnetometer": Section(MagFigures, "field"),
}
"""The tables of a grade."""

INSTRUMENTS = ("imu", "magnetometer")
"""What `instruments` can name; an instrument is there when the grade has its table."""


class Instrument(Protocol):
    """What a suite asks of an instrument."""

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records it sends."""
        ...

    def process(self, truth: Truth) -> dict[str, Record]:
        """Records that arrive within the block, by name."""
        ...


class Suite:
    """The instruments of one suite; made by `make_suite`."""

    def __init__(
        self, component: Component, *, seed: int, dt: float, epoch: datetime.datetime, start_lla: np.ndarray,
        faults: Sequence[Component],
    ) -> None:  # fmt: skip
        self.name = component.name
        table = component.table()
        name = table.text("grade")
        self._position = table.vector("position_m", None)
        mount = np.radians([table.number(f"{axis}_deg", 0.0) for axis in ("roll", "pitch", "yaw")])
        error = np.radians(table.vector("mounting_error_deg", [0.0, 0.0, 0.0]))
        wanted = table.value("instruments", None)
        rate = table.number("rate_hz", None, above=0.0)
        overrides = _with_rate(table.rest(), rate)
        self.grade = grades.load(name, SECTIONS, overrides, component.where)
        self.has = _choose(self.grade, wanted, table)
        self._seed = seed
        self._dt = dt
        self._where = component.where
        self.faults = make_faults(faults, suite=self.name, instruments=self.has, seed=seed)
        turned = {"mount": rotation(*mount).T, "turned": rotation(*error).T}
        self.imu = Imu(
            self.grade, self._stream, self.faults, dt=dt, position=self._position, where=self._place("imu"), **turned
        )
        self._instruments: list[Instrument] = [self.imu]
        self.magnetometer: Magnetometer | None = None
        if "magnetometer" in self.has:
            self.magnetometer = Magnetometer(
                self.grade, self._stream, self.faults, dt=dt, epoch=epoch, where=self._place("magnetometer"),
                world=seeds.generator(seed, "world", "magnetic field"), **turned,
            )  # fmt: skip
            self._instruments.append(self.magnetometer)

    def _stream(self, *name: str) -> np.random.Generator:
        return seeds.generator(self._seed, "suite", self.name, *name)

    def _place(self, section: str) -> str:
        return f"{self._where}: [{section}]"

    @property
    def instruments(self) -> tuple[str, ...]:
        """Names of the records that come, in the order of a block."""
        return tuple(name for i in self._instruments for name in i.records)

    def process(self, truth: Truth) -> SuiteBlock:
        """What arrives from every instrument while `truth` happens; blocks of any length give the same records."""
        self.faults.watch(truth.t)
        block: SuiteBlock = {}
        for instrument in self._instruments:
            block.update(instrument.process(truth))
        return block

    def take_events(self) -> list[Event]:
        """Faults that set in or ended since the last call."""
        return self.faults.take_events()

    @property
    def info(self) -> SensorInfo:
        """What the data sheets say: grade figures, nothing drawn."""
        gyro, accel = self.imu.gyro, self.imu.accel
        g, a = gyro.figures, accel.figures
        values: dict[str, Any] = {
            "rate": 1.0 / self.imu.period,
            "gyro_noise": _rms(g.noise_density),
            "gyro_bias": _rms(g.turn_on_bias),
            "gyro_instability": _rms(g.bias_floor),
            "gyro_scale": float(np.hypot(_rms(g.scale), np.hypot(g.misalignment, g.cross_axis))),
            "accel_noise": _rms(a.noise_density),
            "accel_bias": _rms(a.turn_on_bias),
            "accel_scale": float(np.hypot(_rms(a.scale), np.hypot(a.misalignment, a.cross_axis))),
            "gyro_delay": gyro.band.delay,
            "accel_delay": accel.band.delay,
        }
        if self.magnetometer:
            f = self.magnetometer.figures
            values |= {
                "mag_noise": _rms(f.noise_density) * float(np.sqrt(0.5 / self.magnetometer.period)),
                "mag_bias": _rms(f.turn_on_bias),
                "mag_delay": self.magnetometer.triad.band.delay,
            }
        return SensorInfo(**values)

    def specification(self) -> dict[str, str]:
        """Effective figures with their sources, and what was drawn for this flight, as flat texts for the log."""
        flat = {"grade": self.grade.name, "title": self.grade.title}
        for section, entry in self.grade.rows():
            value = " ".join(f"{x:g}" for x in np.atleast_1d(entry.value))
            flat[f"{section}.{entry.key}"] = f"{value} ({entry.mark}: {entry.source})"
        for key, drawn in self.drawn().items():
            flat[f"drawn.{key}"] = " ".join(repr(float(x)) for x in np.ravel(drawn))
        return flat

    def drawn(self) -> dict[str, np.ndarray]:
        """The truth of the errors that were drawn for this flight, SI, in the sensors' axes."""
        values = {}
        triads = {"gyro": self.imu.gyro, "accelerometer": self.imu.accel}
        if self.magnetometer:
            triads["magnetometer"] = self.magnetometer.triad
            values["magnetometer.model_error"] = self.magnetometer.model_error
            values["magnetometer.motor_field"] = self.magnetometer.motor_field
        for name, triad in triads.items():
            values[f"{name}.turn_on_bias"] = triad.turn_on
            values[f"{name}.matrix"] = triad.matrix
        return values


def make_suite(
    component: Component, *, seed: int, dt: float, epoch: datetime.datetime, start_lla: np.ndarray,
    faults: Sequence[Component] = (), duration_hint: float | None = None,
) -> Suite:  # fmt: skip
    """The suite of a scenario's `[suite.NAME]` table.

    Args:
        component: the table.
        seed: the scenario's.
        dt: s between rows of the truth.
        epoch: date of t = 0.
        start_lla: (3,) rad, rad, m: where the flight begins.
        faults: the scenario's; those of other suites are checked and left alone.
        duration_hint: s; not needed by any instrument so far.

    Raises:
        InputError: anything wrong in the table, its grade or its faults: where, which key, what to do.
    """
    return Suite(component, seed=seed, dt=dt, epoch=epoch, start_lla=start_lla, faults=faults)


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _with_rate(overrides: dict[str, Any], rate: float | None) -> dict[str, Any]:
    if rate is None:
        return overrides
    return {**overrides, "imu": {**overrides.get("imu", {}), "rate_hz": rate}}


def _choose(grade: Grade, wanted: Any, table: Table) -> tuple[str, ...]:
    """The instruments to carry: `wanted`, or all that the grade has."""
    there = tuple(name for name in INSTRUMENTS if name in grade)
    if wanted is None:
        return there
    if not isinstance(wanted, list) or not all(isinstance(x, str) for x in wanted):
        raise table.error("instruments", f"{wanted!r} is not a list of names; known: {', '.join(there)}")
    for name in wanted:
        if name not in there:
            raise InputError(f"{table.where}: instruments: the grade has no '{name}'{nearest(name, there)}")
    if "imu" not in wanted:
        raise table.error("instruments", "a suite needs its imu; add \"imu\"")
    return tuple(name for name in there if name in wanted)
