"""Reading the log of a flight back into the blocks that were written.

    with FlightReader("flight.mcap") as log:
        truth, imu, estimates = log.truth(), log.record("chr", "imu"), log.estimates("ekf")

Values are identical to the last bit, except for the columns that `ahrs_sim.log.topics` rounds.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import fields

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.reader import LogReader, quaternion, stamps, vector
from ahrs_sim.log.messages import LATER, LONGEST_S
from ahrs_sim.log.topics import (
    EVENTS,
    INSTRUMENTS,
    ODOMETRY,
    RECEIVED,
    REFERENCE,
    SETPOINTS,
    STATE,
    STATUS,
    TEMPERATURE,
    TRUTH,
    Route,
)
from ahrs_sim.sensors.records import AttitudeRecord, FixRecord, ImuRecord, Record, SuiteBlock
from estimators.types import Estimates, blank

_TYPES = {route.topic: route.type_name for route in (*TRUTH, REFERENCE, SETPOINTS, EVENTS)}


class FlightReader(LogReader):
    """A log of ours, read as the blocks that were written.

    Start and end are seconds of flight in log time; `end` itself is left out.
    """

    @property
    def suites(self) -> dict[str, list[str]]:
        """Instruments by suite."""
        found: dict[str, list[str]] = {}
        for topic in self.topics:
            for instrument, (_, route) in INSTRUMENTS.items():
                suite = topic[1 : -len(route.topic)]
                if topic.endswith(route.topic) and suite and "/" not in suite and suite != "truth":
                    found.setdefault(suite, []).append(instrument)
        return found

    @property
    def estimators(self) -> list[str]:
        """Names of the estimators."""
        ends = "/est/", STATE.topic
        return [t[len(ends[0]) : -len(ends[1])] for t in self.topics if t.startswith(ends[0]) and t.endswith(ends[1])]

    def _plan(self, topic: str) -> list[int]:
        """Plan as any reader does, but check that our topics and types have the form that we write."""
        numbers = super()._plan(topic)
        found, expected = self._type_name(numbers[0]), _TYPES.get(topic)
        if topic.startswith("/est/") and topic.endswith(STATE.topic):
            expected = STATE.type_name
        if expected is not None and found != expected:
            raise InputError(f"{self.path}: topic {topic} is a {found}; it must be a {expected}")
        if wrong := messages.difference(found, self._dtype(numbers)):
            raise InputError(f"{self.path}: topic {topic} is not a {found} as it is known: {wrong}")
        return numbers

    def seconds(self, ns: np.ndarray) -> np.ndarray:
        """Convert times in ns since 1970 to time of flight (s).

        Raises:
            InputError: one is further from the beginning than any flight is long.
        """
        t: np.ndarray = (ns - self.epoch_ns) / 1e9
        if len(t) and (furthest := float(np.abs(t).max())) > LONGEST_S:
            raise InputError(
                f"{self.path}: a stamp is {furthest / 86400:.0f} days from the beginning of the log; "
                f"no flight is longer than {LONGEST_S / 86400:.0f} days"
            )
        return t

    def truth(self, start: float | None = None, end: float | None = None) -> Truth:
        """Read the truth at its logged rate.

        Raises:
            InputError: not in this log.
        """
        arrays = self.read([route.topic for route in TRUTH], *self._span(start, end))
        n = min(len(array) for array in arrays.values())  # a recovered log may end between two
        columns = blank(Truth, n)
        for route in TRUTH:
            route.put(columns, arrays[route.topic][:n])
        columns["t"][:] = self.seconds(stamps(arrays[ODOMETRY.topic][:n]))
        return Truth(**columns)

    def record(self, suite: str, instrument: str, start: float | None = None, end: float | None = None) -> Record:
        """Read what an instrument has sent, in the order of arrival.

        Raises:
            InputError: not in this log.
        """
        if instrument not in INSTRUMENTS:
            raise InputError(f"{self.path}: no instrument '{instrument}'{nearest(instrument, INSTRUMENTS)}")
        kind, route = INSTRUMENTS[instrument]
        span = self._span(start, end)
        self._expect(f"/{suite}{route.topic}", route)
        array = self.read(f"/{suite}{route.topic}", *span)
        columns = self._columns(kind, route, array)
        if instrument in STATUS and f"/{suite}{STATUS[instrument].topic}" in self.topics:  # a bag's suite has none
            # The last status with a stamp not after the message's.
            status = self.read(f"/{suite}{STATUS[instrument].topic}", None, span[1])
            rows = np.searchsorted(stamps(status), stamps(array), "right") - 1
            if len(status):
                STATUS[instrument].put(columns, status[np.maximum(rows, 0)])
        if kind is ImuRecord and f"/{suite}{TEMPERATURE.topic}" in self.topics:
            array = self.read(f"/{suite}{TEMPERATURE.topic}", *span)
            if len(array):
                kelvin = array["temperature"] + 273.15
                columns["temperature"][:] = np.interp(columns["stamp_ns"], stamps(array) - self.epoch_ns, kelvin)
        return kind(**columns)

    def suite_blocks(
        self, names: Sequence[str], beside: Callable[[dict[str, np.ndarray]], None] | None = None, *topics: str
    ) -> Iterator[dict[str, SuiteBlock]]:
        """Read what several suites have sent, by suite, portion by portion in the order of arrival.

        Only what estimators see: states of saturation and temperatures are left out. The first suite also has the true
        attitude, as `reference`, where the log has it.

        Args:
            names: the suites.
            beside: callback that receives the messages of `topics` of each portion before the portion itself; there is
                no `reference` then.
            topics: see `beside`.

        Raises:
            InputError: a suite is not in this log.
        """
        if unknown := [name for name in names if name not in self.suites]:
            raise InputError(f"{self.path}: no suite '{unknown[0]}'{nearest(unknown[0], self.suites)}")
        received = [(suite, i) for suite in names for i in self.suites[suite] if i in RECEIVED]
        for suite, instrument in received:
            for route in (INSTRUMENTS[instrument][1], *([STATUS[instrument]] if instrument == "fix" else [])):
                self._expect(f"/{suite}{route.topic}", route)
        instruments = {f"/{suite}{INSTRUMENTS[i][1].topic}": (suite, i) for suite, i in received}
        satellites = {f"/{suite}{STATUS[i].topic}": suite for suite, i in received if i == "fix"}
        truth = [ODOMETRY.topic] if ODOMETRY.topic in self.topics and not beside else []
        for portion in self.blocks([*instruments, *satellites, *truth, *topics]):
            if beside:
                beside(portion)
            found: dict[str, SuiteBlock] = {suite: {} for suite in names}
            for topic in truth:
                found[names[0]]["reference"] = AttitudeRecord(**self._columns(AttitudeRecord, ODOMETRY, portion[topic]))
            for topic, (suite, instrument) in instruments.items():
                kind, route = INSTRUMENTS[instrument]
                columns = self._columns(kind, route, portion[topic])
                if kind is FixRecord:  # one status a fix, sent with it
                    status = portion[f"/{suite}{STATUS[instrument].topic}"]
                    rows = np.searchsorted(stamps(status), columns["stamp_ns"] + self.epoch_ns, "right") - 1
                    if len(status):
                        STATUS[instrument].put(columns, status[np.maximum(rows, 0)])
                found[suite][instrument] = kind(**columns)
            yield found

    def _expect(self, topic: str, route: Route) -> None:
        """Check the type of a topic that others name likewise."""
        if topic in self.topics and (found := self.topics[topic].type_name) != route.type_name:
            raise InputError(f"{self.path}: topic {topic} is a {found}; it must be a {route.type_name}")

    def _columns(self, kind: type[Record], route: Route, array: np.ndarray) -> dict[str, np.ndarray]:
        columns = blank(kind, len(array))
        route.put(columns, array)
        columns["stamp_ns"][:] = stamps(array) - self.epoch_ns
        columns["arrival_ns"][:] = array["log_time"] - self.epoch_ns
        if kind is FixRecord:
            columns["sigma"][:] = np.sqrt(array["position_covariance"][:, [4, 0, 8]])
        return columns

    def estimates(self, name: str, start: float | None = None, end: float | None = None) -> Estimates:
        """Read what an estimator reported.

        Raises:
            InputError: not in this log.
        """
        array = self.read(f"/est/{name}{STATE.topic}", *self._span(start, end))
        columns = blank(Estimates, len(array))
        STATE.put(columns, array)
        columns["t"][:] = self.seconds(stamps(array))
        return Estimates(**columns)

    def estimates_in(self, messages: np.ndarray, columns: Collection[str]) -> Estimates:
        """Make estimates of messages of a state topic, only with the columns that are needed.

        Args:
            messages: of a `/est/NAME/state`, as `blocks` gives them.
            columns: names; the others are NaN, or zero. Numbers keep the type that they have in the log.
        """
        n = len(messages)
        found: dict[str, np.ndarray] = {}
        for f in fields(Estimates):
            missing = np.array(np.nan if f.metadata["dtype"] is float else 0)
            found[f.name] = np.broadcast_to(missing, (n, *f.metadata["shape"]))
        for path, name in STATE.fields.items():
            if name in columns and (path not in LATER or path in (messages.dtype.names or ())):
                values = messages[path]
                if values.dtype.names:
                    values = quaternion(values) if "w" in values.dtype.names else vector(values)
                found[str(name)] = values.reshape(found[str(name)].shape)
        return Estimates(**{**found, "t": self.seconds(stamps(messages))})

    def setpoints(self, start: float | None = None, end: float | None = None) -> Setpoints:
        """Read the set-points of the pilot."""
        array = self.read(SETPOINTS.topic, *self._span(start, end))
        columns = blank(Setpoints, len(array))
        SETPOINTS.put(columns, array)
        columns["t"][:] = self.seconds(stamps(array))
        return Setpoints(**columns)

    def events(self) -> list[Event]:
        """Read all events in order."""
        array = self.read(EVENTS.topic)
        return [
            Event(float(t), row["level"], row["name"], row["text"])
            for t, row in zip(self.seconds(stamps(array)), array, strict=True)
        ]

    def _span(self, start: float | None, end: float | None) -> tuple[int | None, int | None]:
        first, last = (None if t is None else self.epoch_ns + round(t * 1e9) for t in (start, end))
        return first, last
