"""Sensor faults of a scenario: which sensor, what kind, when, and how large.

    [[fault]]
    suite = "chr"              # absent: all suites that have the sensor
    sensor = "gyro"            # see SENSORS; a group stands for its members
    kind = "bias"              # see KINDS
    at_s = 120.0
    for_s = 30.0               # absent: to the end of the flight
    size_dps = [0.0, 0.0, 2.0] # in a unit of the sensor; one number stands for all axes

A fault hits the samples whose slot t has at <= t < at + for, and no other. Kinds that shape a value (bias, drift,
spike, noise, saturation) act before the range and the quantisation of the instrument, several add up; then `freeze` and
`nan` act on what would be sent, and `dropout` and `delay` on the message. The fields of `dipole`, `field_step` and
`field_burst` act on the place where the magnetometer is, ahead of its filter and delay.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.truth import Event
from ahrs_sim.scenario import Component, seeds
from ahrs_sim.scenario.table import Table
from ahrs_sim.sensors.grade import UNITS

CHANNELS: dict[str, tuple[str, int]] = {
    "gyro": ("rate", 3),
    "accelerometer": ("acceleration", 3),
    "magnetometer": ("field", 3),
    "position": ("length", 3),
    "velocity": ("speed", 3),
    "heading": ("angle", 1),
    "diff_pressure": ("pressure", 1),
    "static_pressure": ("pressure", 1),
    "air": ("speed", 1),
    "vanes": ("angle", 2),
    "interferometer": ("angle", 1),
}
"""Quantity and number of axes of every sensor that a fault can name."""

SENSORS: dict[str, tuple[str, ...]] = {
    **{name: (name,) for name in CHANNELS if name not in ("air", "vanes")},
    "imu": ("gyro", "accelerometer"),
    "gnss": ("position", "velocity"),
    "air_data": ("diff_pressure", "static_pressure", "air"),
    "vanes": ("vanes",),
}
"""What a fault can name, and the channels it means."""

INSTRUMENT = {
    "gyro": "imu", "accelerometer": "imu", "magnetometer": "magnetometer", "position": "gnss", "velocity": "gnss",
    "heading": "heading", "diff_pressure": "air_data", "static_pressure": "air_data", "air": "air_data",
    "vanes": "air_data", "interferometer": "interferometer",
}  # fmt: skip
"""The instrument that a channel belongs to."""

RANGED = ("gyro", "accelerometer", "magnetometer", "diff_pressure", "static_pressure")
"""Sensors that can saturate."""

SHAPING = ("bias", "drift", "spike", "noise", "saturation", "wrong_fix")
SENDING = ("freeze", "nan")
MESSAGE = ("dropout", "delay")
SKY = ("jamming", "satellites")
FIELD = ("dipole", "field_step", "field_burst")
KINDS = (*SHAPING, *SENDING, *MESSAGE, *SKY, *FIELD)

_MU0_4PI = 1e-7  # T m / A


def _ns(t: float) -> float:
    """Round a time (s) to whole nanoseconds; infinity stays."""
    return float(np.rint(t * 1e9))


@dataclass
class Fault:
    """A fault and its state during a flight."""

    name: str
    sensor: str
    kind: str
    channels: tuple[str, ...]
    at: float  # s
    until: float  # s
    rng: np.random.Generator
    size: np.ndarray = field(default_factory=lambda: np.zeros(3))  # SI, per axis
    factor: float = 1.0  # of sigma
    every: float = math.inf  # s between spikes
    latency: float = 0.0  # s
    count: int = 0  # satellites left
    moment: np.ndarray = field(default_factory=lambda: np.zeros(3))  # A m2, NED
    path: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  # distance m, below m, speed m/s, bearing rad
    frequency: float = 0.0  # Hz
    state: str = "ahead"  # "ahead", "on", "over"
    spikes: dict[str, int] = field(default_factory=dict)  # number of the last spike, by channel
    last: dict[str, np.ndarray] = field(default_factory=dict)  # the value sent before, by channel

    def hits(self, t: np.ndarray) -> np.ndarray:
        """Mask the samples at `t` (n,) s that the fault affects."""
        # To the nanosecond, as stamps are: a clock that has added up 1/400 s is off by some 1e-13 s.
        ns = np.rint(t * 1e9)
        return np.asarray((ns >= _ns(self.at)) & (ns < _ns(self.until)))

    def spike(self, channel: str, t: np.ndarray) -> np.ndarray:
        """Mask the samples at `t` (n,) s with a spike: the first at or after every multiple of the period."""
        hit = self.hits(t)
        periods = np.floor((t - self.at) / self.every + 1e-6)  # 0 throughout for a single spike
        number = np.where(hit, periods, -1.0).astype(int)
        before = np.concatenate([[self.spikes.get(channel, -1)], np.maximum.accumulate(number)[:-1]])
        if len(t):
            self.spikes[channel] = max(self.spikes.get(channel, -1), int(number.max()))
        return hit & (number > before)


class Channel:
    """Faults of one sensor's values and messages; cheap when there are none."""

    def __init__(self, name: str, faults: Iterable[Fault]) -> None:
        self.name = name
        mine = [f for f in faults if name in f.channels]
        self.shaping = [f for f in mine if f.kind in SHAPING]
        self.sending = [f for f in mine if f.kind in SENDING]
        self.message = [f for f in mine if f.kind in MESSAGE]
        self.axes = CHANNELS[name][1]

    def shape(self, t: np.ndarray, noise: np.ndarray, limit: np.ndarray) -> None:
        """Change, in place, the white `noise` (m, axes) of the samples at `t`, and their `limit` (m, axes)."""
        # Factors first: they belong to the instrument's own noise, not to what another fault adds to it.
        for f in self.shaping:
            if f.kind == "noise" and f.factor != 1.0:
                noise[f.hits(t)] *= f.factor
        for f in self.shaping:
            hit = f.hits(t)
            size = f.size[: self.axes]
            if f.kind in ("bias", "wrong_fix"):
                noise[hit] += size
            elif f.kind == "drift":
                noise[hit] += size * (t[hit] - f.at)[:, None]
            elif f.kind == "spike":
                noise[f.spike(self.name, t)] += size
            elif f.kind == "saturation":
                limit[hit] = np.minimum(limit[hit], size)
            elif f.kind == "noise" and size.any():
                noise[hit] += size * f.rng.standard_normal((int(hit.sum()), self.axes))

    def send(self, t: np.ndarray, values: np.ndarray) -> None:
        """Freeze or lose, in place, the `values` (m, axes) of the samples at `t`."""
        for f in self.sending:
            hit = f.hits(t)
            if f.kind == "nan":
                values[hit] = np.nan
            elif len(t):
                before = np.flatnonzero(~hit & (t < f.at))
                if len(before):
                    f.last[self.name] = values[before[-1]].copy()
                values[hit] = f.last.setdefault(self.name, values[0].copy())

    def deliver(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return mask of sent messages and delays (m,) s of the messages at `t`; None when no fault affects them."""
        if not self.message:
            return None
        sent, late = np.ones(len(t), bool), np.zeros(len(t))
        for f in self.message:
            hit = f.hits(t)
            if f.kind == "dropout":
                sent &= ~hit
            else:
                late[hit] += f.latency
        return sent, late


class Faults:
    """Holds all faults of one suite."""

    def __init__(self, faults: Sequence[Fault], suite: str) -> None:
        self.faults = list(faults)
        self.suite = suite
        self.fields = [f for f in self.faults if f.kind in FIELD]
        self._sky = [f for f in self.faults if f.kind in SKY]
        self._events: list[Event] = []
        self._waiting = bool(self.faults)

    def channel(self, name: str) -> Channel:
        """Select the faults of one channel."""
        return Channel(name, self.faults)

    def watch(self, t: np.ndarray) -> None:
        """Note which faults set in or end within the rows at `t` (n,)."""
        if not self._waiting or not len(t):
            return
        ns = np.rint(t * 1e9)
        for f in self.faults:
            where = f"{f.kind} of {self.suite}/{f.sensor}"
            if f.state == "ahead" and ns[-1] >= _ns(f.at):
                first = float(t[np.searchsorted(ns, _ns(f.at))])
                self._events.append(Event(first, "warning", "fault", f"{where} sets in"))
                f.state = "on"
            if f.state == "on" and ns[-1] >= _ns(f.until):
                first = float(t[np.searchsorted(ns, _ns(f.until))])
                self._events.append(Event(first, "info", "fault", f"{where} ends"))
                f.state = "over"
        self._waiting = any(f.state != "over" for f in self.faults)

    def take_events(self) -> list[Event]:
        """Return the events noted since the last call, in order of time."""
        events, self._events = self._events, []
        return sorted(events, key=lambda e: e.t)

    def most_satellites(self, t: np.ndarray) -> np.ndarray:
        """Return the largest number of satellites (m,) that can be received at `t`; 255: no limit."""
        most = np.full(len(t), 255)
        for f in self._sky:
            hit = f.hits(t)
            most[hit] = np.minimum(most[hit], f.count)
        return most

    def field_n(self, t: np.ndarray) -> np.ndarray:
        """Compute the external magnetic field (n, 3), T, NED, at `t` (n,) s."""
        total = np.zeros((len(t), 3))
        for f in self.fields:
            hit = f.hits(t)
            if f.kind == "field_step":
                total[hit] += f.size
            elif f.kind == "field_burst":
                total[hit] += np.outer([math.sin(2.0 * math.pi * f.frequency * (x - f.at)) for x in t[hit]], f.size)
            else:
                total[hit] += dipole(f.moment, _passing(f, t[hit]))
        return total


def _passing(f: Fault, t: np.ndarray) -> np.ndarray:
    """Compute the position (n, 3), m, NED, relative to a dipole passed on a straight line, nearest at mid-fault."""
    distance, below, speed, bearing = f.path
    along = speed * (t - 0.5 * (f.at + f.until))
    c, s = math.cos(bearing), math.sin(bearing)
    return np.column_stack([along * c + distance * s, along * s - distance * c, np.full(len(t), -below)])


def dipole(moment: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Compute the field (n, 3), T, of a magnetic dipole `moment` (3,), A m2, at `r` (n, 3), m, from it."""
    d2 = r[:, :1] ** 2 + r[:, 1:2] ** 2 + r[:, 2:] ** 2
    along = r[:, :1] * moment[0] + r[:, 1:2] * moment[1] + r[:, 2:] * moment[2]
    return np.asarray(_MU0_4PI * (3.0 * along * r / d2 - moment) / (d2 * np.sqrt(d2)))


def check_suites(components: Iterable[Component], suites: Sequence[str]) -> None:
    """Refuse faults for a suite that the scenario does not have.

    Raises:
        InputError: naming the fault and the suites there are.
    """
    for c in components:
        name = c.settings.get("suite")
        if name is not None and name not in suites:
            raise InputError(f"{c.where}: suite: '{name}' is unknown{nearest(str(name), suites)}")


def make_faults(components: Iterable[Component], *, suite: str, instruments: Sequence[str], seed: int) -> Faults:
    """Make the faults of `suite` from those of the scenario.

    Raises:
        InputError: an unknown sensor, kind or key, a size that the kind needs, or one in a unit of another sensor.
    """
    made = []
    for component in components:
        fault = _make(component, suite, instruments, seed)
        if fault is not None:
            made.append(fault)
    return Faults(made, suite)


def _make(component: Component, suite: str, instruments: Sequence[str], seed: int) -> Fault | None:
    table = component.table()
    named = table.text("suite", "")
    sensor = table.choice("sensor", sorted(SENSORS))
    kind = table.choice("kind", KINDS)
    at = table.number("at_s", minimum=0.0)
    lasting = table.number("for_s", math.inf, above=0.0) if table.has("for_s") else math.inf
    channels = SENSORS[sensor]
    fault = Fault(
        component.name, sensor, kind, channels, at, at + lasting, seeds.generator(seed, "fault", component.name, suite)
    )
    _fill(fault, table)
    table.close()
    if named not in ("", suite):
        return None
    if INSTRUMENT[channels[0]] not in instruments:
        if not named:
            return None
        raise table.error("sensor", f"suite '{suite}' has no {sensor}; it has {', '.join(instruments)}")
    return fault


def _fill(fault: Fault, table: Table) -> None:
    """Read the keys that a kind needs besides sensor and time."""
    kind, channels = fault.kind, fault.channels
    if kind == "saturation" and fault.sensor not in RANGED:
        raise table.error("kind", f"{fault.sensor} has no range; saturation is for {', '.join(RANGED)}")
    if kind in MESSAGE and fault.sensor in ("gyro", "accelerometer", "vanes"):
        group = "imu" if fault.sensor != "vanes" else "air_data"
        raise table.error("kind", f'{fault.sensor} shares its message; say sensor = "{group}", or kind = "nan"')
    if kind in SKY and fault.sensor != "gnss":
        raise table.error("kind", f'{kind} acts on satellite reception; say sensor = "gnss"')
    if kind in FIELD and fault.sensor != "magnetometer":
        raise table.error("kind", f'{kind} is a magnetic field; say sensor = "magnetometer"')
    if kind == "wrong_fix" and fault.sensor not in ("heading", "position"):
        raise table.error("kind", 'wrong_fix is a matter of sensor = "heading" or "position"')
    if kind in ("bias", "drift", "spike", "saturation", "wrong_fix", "field_step", "field_burst"):
        fault.size = _size(fault, table)
    if kind == "spike":
        fault.every = table.number("every_s", math.inf, above=0.0) if table.has("every_s") else math.inf
    if kind == "noise":
        given = [k for k in ("variance_factor", "sigma_factor") if table.has(k)]
        sized = [k for k in table.data if k.startswith("size_")]
        if len(given) + bool(sized) != 1:
            raise table.error("noise", "give one of variance_factor, sigma_factor or a size (sigma of added noise)")
        if sized:
            fault.size = _size(fault, table)
        elif given[0] == "sigma_factor":
            fault.factor = table.number("sigma_factor", minimum=0.0)
        else:
            fault.factor = math.sqrt(table.number("variance_factor", minimum=0.0))
    if kind == "delay":
        fault.latency = table.number("latency_s", above=0.0)
    if kind == "satellites":
        fault.count = table.integer("count", minimum=0, maximum=254)
    if kind == "field_burst":
        fault.frequency = table.number("frequency_hz", above=0.0)
    if kind == "dipole":
        if fault.until == math.inf:
            raise table.error("for_s", "missing; the aircraft passes the dipole midway of this time")
        fault.moment = table.vector("moment_am2")
        fault.path = (
            table.number("distance_m", 0.0),
            table.number("below_m", 0.0),
            table.number("speed_mps", minimum=0.0),
            math.radians(table.number("bearing_deg", 0.0)),
        )
        if math.hypot(fault.path[0], fault.path[1]) < 0.1:
            raise table.error("distance_m", "the dipole is passed at less than 0.1 m; give distance_m or below_m")
    if kind in SENDING and len(channels) > 1 and fault.sensor == "air_data":
        fault.channels = ("diff_pressure", "static_pressure")


def _size(fault: Fault, table: Table) -> np.ndarray:
    """Read `size_UNIT` in a unit of the fault's sensor: SI, one number per axis."""
    quantities = {CHANNELS[c][0] for c in fault.channels}
    if len(quantities) > 1 or fault.sensor == "air_data":
        raise table.error("sensor", f"{fault.kind} needs one sensor of {', '.join(fault.channels)}")
    units = UNITS[quantities.pop()]
    for unit, factor in units.items():
        key = f"size_{unit}"
        if table.has(key):
            axes = CHANNELS[fault.channels[0]][1]
            value = table.value(key)
            size = table.vector(key, size=axes) if isinstance(value, list) else np.full(axes, table.number(key))
            if fault.kind in ("saturation", "noise") and size.min() < 0.0:
                raise table.error(key, "must not be negative")
            return size * factor
    for key in table.data:
        if key.startswith("size_"):
            raise table.error(key, f"is no size of this sensor; known: {', '.join(f'size_{unit}' for unit in units)}")
    raise table.error(f"size_{next(iter(units))}", f"missing; {fault.kind} needs a size")
