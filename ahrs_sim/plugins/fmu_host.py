"""The process in which an FMU runs as an estimator (`python -m ahrs_sim.plugins.fmu_host`, see `host`), by FMPy.

One co-simulation step a sample: the inputs of the row are set, the step ends at its time stamp, the outputs are read.
Names of variables, unless `[estimator.NAME.map]` gives others:

    inputs   gyro_x gyro_y gyro_z  accel_x ...  mag_x ...  mag_new  latitude longitude height
             vel_north vel_east vel_down  gnss_t gnss_satellites gnss_new
             heading_in heading_sigma heading_t heading_new  airspeed alpha beta air_new
    outputs  q_w q_x q_y q_z, or roll pitch heading (rad), or down_x down_y down_z  status
             gyro_bias_x ...  gyro_bias_sigma_x ...  accel_bias_x ...  accel_bias_sigma_x ...
             latitude_est longitude_est height_est  vel_north_est vel_east_est vel_down_est
    parameters filled when they exist: site_latitude site_longitude site_height site_gravity
             site_mag_north site_mag_east site_mag_down  sample_rate

An array variable of FMI 3.0 named like a column (`gyro_b`, `q_nb`) is filled or read whole. Other settings are
parameters.
"""

import ctypes
import math
import shutil
import tempfile
from typing import Any

import numpy as np

from ahrs_sim.plugins import layout
from ahrs_sim.plugins.host import Refused, start

_AXES = ("x", "y", "z")
_NED = ("north", "east", "down")
_PLACE = ("latitude", "longitude", "height")


def _names(column: str, names: tuple[str, ...]) -> dict[str, tuple[str, int]]:
    return {name: (column, i) for i, name in enumerate(names)}


INPUTS: dict[str, tuple[str, int]] = {
    **_names("gyro_b", tuple(f"gyro_{a}" for a in _AXES)),
    **_names("accel_b", tuple(f"accel_{a}" for a in _AXES)),
    **_names("mag_b", tuple(f"mag_{a}" for a in _AXES)),
    **_names("lla", _PLACE),
    **_names("vel_n", tuple(f"vel_{a}" for a in _NED)),
    **{n: (n, -1) for n in ("gnss_t", "gnss_satellites", "heading_sigma", "heading_t", "airspeed", "alpha", "beta")},
    **{n: (n, -1) for n in ("mag_new", "gnss_new", "heading_new", "air_new")},
    "heading_in": ("heading", -1),
    "t": ("t", -1),
}
OUTPUTS: dict[str, tuple[str, int]] = {
    **_names("q_nb", ("q_w", "q_x", "q_y", "q_z")),
    **_names("down_b", tuple(f"down_{a}" for a in _AXES)),
    **{f"{c}_{a}": (c, i) for c in ("gyro_bias", "gyro_bias_sigma", "accel_bias", "accel_bias_sigma")
       for i, a in enumerate(_AXES)},
    **_names("lla", tuple(f"{p}_est" for p in _PLACE)),
    **_names("vel_n", tuple(f"vel_{a}_est" for a in _NED)),
    "status": ("status", -1),
}  # fmt: skip
EULER = ("roll", "pitch", "heading")


class Unit:
    """An FMU instance over shared memory, with the methods of `host.Library`."""

    def __init__(self, path: str, base: int, estimates: int, rows: int) -> None:
        import fmpy

        try:
            self._description = fmpy.read_model_description(path, validate=False)  # takes what works, as other tools do
        except Exception as error:  # FMPy raises whatever the XML or the archive makes it raise
            raise Refused(f"is no FMU: {' '.join(str(error).split())}") from None
        if self._description.coSimulation is None:
            raise Refused("is an FMU of model-exchange kind; export it for co-simulation")
        machines = [name for name in fmpy.supported_platforms(path) if name != "c-code"]
        if fmpy.platform_tuple == "x86_64-linux" and fmpy.platform not in machines:  # FMPy lists no other Linux
            raise Refused(
                f"has code for {', '.join(machines) or 'no machine'}, not for {fmpy.platform}; export it for that"
            )
        self._folder = tempfile.mkdtemp(prefix="ahrs_sim-fmu-")
        fmpy.extract(path, self._folder)
        self._variables = {v.name: v for v in self._description.modelVariables}
        self._memory = base
        self._samples = _array(base, rows, layout.SAMPLE)
        self._estimates = _array(estimates, rows, layout.ESTIMATE)
        self._fmu: Any = None
        self._inputs: list[tuple[Any, str, int]] = []
        self._outputs: list[tuple[Any, str, int]] = []
        self._euler: list[Any] = [None, None, None]

    def make(self, site: int, sensors: int, settings: int) -> str:
        """Instantiate with what lies at these offsets of the memory; return an error or ""."""
        text = ctypes.string_at(self._memory + settings).decode()
        given = dict(line.partition("=")[::2] for line in text.splitlines())
        renamed = {k.removeprefix("map."): v for k, v in given.items() if k.startswith("map.")}
        parameters = {k: v for k, v in given.items() if not k.startswith("map.")}
        place = np.frombuffer(ctypes.string_at(self._memory + site, 56))
        rate = np.frombuffer(ctypes.string_at(self._memory + sensors, 8))[0]
        names = [f"site_{n}" for n in (*_PLACE, "gravity", "mag_north", "mag_east", "mag_down")]
        known = {**dict(zip(names, place.tolist(), strict=True)), "sample_rate": float(rate)}
        self._starts = {k: repr(v) for k, v in known.items() if k in self._variables} | parameters
        self._dt = 1.0 / rate
        problem = self._bind(renamed) or self._known(parameters)
        if not problem:
            try:
                self._instantiate()
            except Exception as error:
                problem = f"does not start: {' '.join(str(error).split())}"
        return problem

    def rows(self, n: int) -> str:
        """Step `n` times; return an error or ""."""
        try:
            for sample, estimate in zip(self._samples[:n], self._estimates[:n], strict=True):
                self._step(sample, estimate)
        except Exception as error:
            return f"fails in a step: {' '.join(str(error).split())}"
        return ""

    def reset(self) -> str:
        """Begin anew with a fresh instance."""
        self._close()
        self._instantiate()
        return ""

    def end(self) -> None:
        """End the instance and remove what was unpacked."""
        self._close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _bind(self, renamed: dict[str, str]) -> str:
        """Pair the unit's variables with columns."""
        inside = {theirs: ours for ours, theirs in renamed.items()}
        self._inputs, self._outputs, self._euler = [], [], [None] * 3
        unknown = []
        for name, variable in self._variables.items():
            ours = inside.get(name, name)
            if variable.causality == "input":
                place = INPUTS.get(ours) or ((ours, -1) if ours in layout.SAMPLE.names else None)  # type: ignore[operator]
                if place is None:
                    unknown.append(name)
                else:
                    self._inputs.append((variable, *place))
            elif variable.causality == "output":
                if ours in EULER:
                    self._euler[EULER.index(ours)] = variable
                elif place := OUTPUTS.get(ours) or ((ours, -1) if ours in layout.ESTIMATE.names else None):  # type: ignore[operator]
                    self._outputs.append((variable, *place))
        if unknown:
            return f"has inputs that nobody fills: {', '.join(unknown)}; name them in a [map] table"
        if missing := [theirs for theirs in renamed.values() if theirs not in self._variables]:
            return f"map: the FMU has no variable '{missing[0]}'"
        columns = {column for _, column, _ in self._outputs}
        if not columns & {"q_nb", "down_b"} and None in self._euler[:2]:
            return "has no output q_w, q_x, q_y, q_z, nor roll and pitch; name them in a [map] table"
        return ""

    def _known(self, parameters: dict[str, str]) -> str:
        wrong = [k for k in parameters if k not in self._variables or self._variables[k].causality != "parameter"]
        return f"has no parameter '{wrong[0]}'" if wrong else ""

    def _instantiate(self) -> None:
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        cls = FMU3Slave if self._description.fmiVersion.startswith("3") else FMU2Slave
        self._fmu = cls(
            guid=self._description.guid, unzipDirectory=self._folder, instanceName="estimator",
            modelIdentifier=self._description.coSimulation.modelIdentifier,
        )  # fmt: skip
        self._three = cls is FMU3Slave
        self._fmu.instantiate()
        fmpy.simulation.apply_start_values(self._fmu, self._description, self._starts)
        self._t = math.nan

    def _initialise(self, t: float) -> None:
        if not self._three:
            self._fmu.setupExperiment(startTime=t)
            self._fmu.enterInitializationMode()
        else:
            self._fmu.enterInitializationMode(startTime=t)
        self._fmu.exitInitializationMode()
        self._t = t

    def _step(self, sample: np.void, estimate: np.void) -> None:
        t = float(sample["t"])
        if math.isnan(self._t):
            self._initialise(t - self._dt)
        if t <= self._t:  # a stamp that repeats or goes back: no step
            return
        for variable, column, index in self._inputs:
            self._set(variable, sample[column] if index < 0 else sample[column][index])
        self._fmu.doStep(currentCommunicationPoint=self._t, communicationStepSize=t - self._t)
        self._t = t
        estimate["status"] = 1
        for variable, column, index in self._outputs:
            value = self._get(variable)
            if index < 0:
                estimate[column] = value if np.ndim(value) else np.asarray(value).astype(layout.ESTIMATE[column].base)
            else:
                estimate[column][index] = value
        if self._euler[0] is not None:
            roll, pitch, yaw = (0.0 if v is None else self._get(v) for v in self._euler)
            _fill_attitude(estimate, roll, pitch, yaw, heading=self._euler[2] is not None)

    def _set(self, variable: Any, value: Any) -> None:
        values = np.atleast_1d(value).tolist()
        kind = variable.type.removesuffix("64").removesuffix("32")
        if kind in ("Boolean", "Integer", "Int"):
            values = [int(v) for v in values]
        setter = {"Real": "setReal", "Float": f"set{variable.type}", "Boolean": "setBoolean"}.get(
            kind, "setInteger" if not self._three else f"set{variable.type}"
        )
        getattr(self._fmu, setter)([variable.valueReference], values)

    def _get(self, variable: Any) -> Any:
        kind = variable.type.removesuffix("64").removesuffix("32")
        getter = {"Real": "getReal", "Float": f"get{variable.type}", "Boolean": "getBoolean"}.get(
            kind, "getInteger" if not self._three else f"get{variable.type}"
        )
        count = int(np.prod([int(d.start or 0) for d in variable.dimensions] or [1]))
        if count == 1 and not variable.dimensions:
            return getattr(self._fmu, getter)([variable.valueReference])[0]
        return np.array(getattr(self._fmu, getter)([variable.valueReference], nValues=count))

    def _close(self) -> None:
        if self._fmu is not None:
            if not math.isnan(self._t):
                self._fmu.terminate()
            self._fmu.freeInstance()
            self._fmu = None


def _fill_attitude(estimate: np.void, roll: float, pitch: float, yaw: float, *, heading: bool) -> None:
    """Quaternion, when there is a heading, and down vector of Euler angles (rad)."""
    estimate["down_b"] = (-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch))
    if heading:
        cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
        estimate["q_nb"] = (
            cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy,
        )  # fmt: skip


def _array(address: int, rows: int, kind: np.dtype) -> np.ndarray:
    """Make records over memory that this process shares."""
    buffer: Any = (ctypes.c_char * (rows * kind.itemsize)).from_address(address)
    array: np.ndarray = np.frombuffer(buffer, kind)
    return array


if __name__ == "__main__":
    start(lambda path, version, base, estimates, rows: Unit(path, base, estimates, rows))
