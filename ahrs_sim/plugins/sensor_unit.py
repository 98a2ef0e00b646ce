"""A sensor suite as a co-simulation unit (FMI 2.0 by PythonFMU, 3.0 by PythonFMU3): a plant's truth in, readings out.

The sensors are those of a flight, in Python: the unit needs an interpreter that has this package. Each step is a row of
the truth, whose values are those of the step's end; step size is what the suite takes as the time between rows.

    inputs      true_latitude true_longitude true_height  true_vel_north ...  true_q_w ...
                true_rate_x ... (inertial)  true_rate_dot_x ...  true_force_x ... (specific force)  true_cg_x ...
                true_airspeed true_alpha true_beta  true_wind_north ...  true_pressure true_temperature
                true_rpm true_throttle true_height_agl true_on_ground
    outputs     the inputs of an estimator by the names in `fmu_host`, the last of each; *_new and sample_new are true
                in the step in which they have come
    parameter   seed
"""

import datetime
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ahrs_sim.errors import AhrsSimError
from ahrs_sim.flight.truth import Truth
from ahrs_sim.plugins.fmu_host import INPUTS as READINGS
from ahrs_sim.scenario import Component
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.assemble import Assembler
from estimators.types import blank

_AXES, _NED = ("x", "y", "z"), ("north", "east", "down")
_PARTS = {
    "lla": ("latitude", "longitude", "height"), "vel_n": tuple(f"vel_{a}" for a in _NED),
    "q_nb": ("q_w", "q_x", "q_y", "q_z"), "rate_ib_b": tuple(f"rate_{a}" for a in _AXES),
    "rate_dot_b": tuple(f"rate_dot_{a}" for a in _AXES), "accel_b": tuple(f"force_{a}" for a in _AXES),
    "cg_b": tuple(f"cg_{a}" for a in _AXES), "wind_n": tuple(f"wind_{a}" for a in _NED),
}  # fmt: skip
TRUTH = {
    f"true_{name}": (column, index)
    for column in Truth.__match_args__ if column != "t"
    for index, name in enumerate(_PARTS.get(column, (column,)))
}  # fmt: skip
"""Inputs: the columns of `Truth` by the names of their parts."""
_STARTS = {"true_q_w": 1.0, "true_pressure": 101325.0, "true_temperature": 288.15, "true_on_ground": False}
_FLAGS = ("mag_new", "gnss_new", "heading_new", "air_new", "sample_new")


class Sensors:
    """What makes a slave of PythonFMU or PythonFMU3 the unit of a suite: the first base of an exported script's class.

    Attributes:
        library: `pythonfmu` or `pythonfmu3`.
        known: name, settings, where of the suite, faults (each likewise), epoch, seed.
    """

    library: Any
    known: Mapping[str, Any]
    register_variable: Callable[[Any], None]  # of the other base, as the next
    log: Callable[[str], None]

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.seed, self.time = int(self.known["seed"]), 0.0
        self._given: dict[str, Any] = {name: _STARTS.get(name, 0.0) for name in TRUTH}
        self._read: dict[str, Any] = dict.fromkeys(READINGS, np.nan) | dict.fromkeys(_FLAGS, False)
        self._suite: Any = None
        self._assembler = Assembler()
        three = hasattr(self.library, "Fmi3Slave")
        names = ("Fmi3Causality", "Fmi3Variability", "Float64", "Int32")
        if not three:
            names = ("Fmi2Causality", "Fmi2Variability", "Real", "Integer")
        self._causality, self._variability, self._number, integer = (getattr(self.library, name) for name in names)
        for values, causality in ((self._given, self._causality.input), (self._read, self._causality.output)):
            for name in values:
                self._register(name, values, causality)
        fixed = self._variability.fixed
        self.register_variable(integer("seed", causality=self._causality.parameter, variability=fixed))
        if three:
            own = {"causality": self._causality.independent, "variability": self._variability.continuous}
            self.register_variable(self._number("time", **own))

    def _register(self, name: str, values: dict[str, Any], causality: Any) -> None:
        def write(value: Any) -> None:
            values[name] = value

        kind = self.library.Boolean if isinstance(values[name], bool) else self._number
        variable = kind(name, causality=causality, variability=self._variability.discrete)
        variable.getter, variable.setter = lambda: values[name], write
        self.register_variable(variable)

    def do_step(self, t: float, step: float) -> bool:
        """Sense one row of the truth, at the end of the step."""
        row = round((t + step) / step) * step  # as a flight has it: the sum of many steps has other last digits
        columns = blank(Truth, 1)
        columns["t"][0] = row
        for name, (column, index) in TRUTH.items():
            values = columns[column][0] if columns[column].ndim > 1 else columns[column]
            values[index] = self._given[name]
        truth = Truth(**columns)
        try:
            if self._suite is None:
                self._suite = _suite(self.known, self.seed, step, truth.lla[0])
            samples = self._assembler.assemble(self._suite.sense(truth))
        except AhrsSimError as error:
            self.log(str(error))
            return False
        self._read |= dict.fromkeys(_FLAGS, False)
        for name, (reading, index) in READINGS.items() if len(samples) else ():
            value = getattr(samples, reading)
            new = value.any() if name in _FLAGS else value[-1] if index < 0 else value[-1, index]
            self._read[name] = bool(new) if name in _FLAGS else float(new)
        self._read["sample_new"] = len(samples) > 0
        self.time = row
        return True


def _suite(known: Mapping[str, Any], seed: int, dt: float, lla: np.ndarray) -> Any:
    return make_suite(
        Component(**known["suite"]), seed=seed, dt=dt, start_lla=lla, faults=[Component(**f) for f in known["faults"]],
        epoch=datetime.datetime.fromisoformat(known["epoch"]),
    )  # fmt: skip
