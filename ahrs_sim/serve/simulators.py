"""PX4 and ArduPilot with this flight as their simulator: they estimate in lockstep; what they steer is not flown.

Both are started by the user (docs/doors.md). Their attitude comes back by MAVLink as ATTITUDE_QUATERNION.
"""

import contextlib
import json
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.flight.truth import Event, Truth
from ahrs_sim.sensors.records import Answers, SuiteBlock
from ahrs_sim.serve.book import Book
from ahrs_sim.serve.links import LinkLost, Tcp
from ahrs_sim.serve.protocols import Answer
from ahrs_sim.serve.protocols.mavlink import Messages, attitude_of, hil_gps, sensors
from ahrs_sim.serve.readings import SWITCHED_ON_NS, Reading, Readings
from ahrs_sim.serve.timing import Timing
from ahrs_sim.world import wgs84
from estimators.types import Samples

_RESOLUTION_NS = 1_000_000  # of ATTITUDE_QUATERNION
_STEP_S = 0.1  # real time that an autopilot has for a step, before the next sample is sent all the same
_SILENT_S = 10.0  # after which it is lost
_LAST_S = 0.3  # real time for the last attitudes


class Autopilot:
    """An autopilot that takes each sample and says when it wants the next one.

    Args:
        name: of its estimates in the log.
        suite: whose sensors it gets.
        zero_ns: of the stamps, ns since 1970.
        stopped: true ends all waiting.
    """

    def __init__(self, name: str, suite: str, zero_ns: int, stopped: Callable[[], bool]) -> None:
        self.name, self.suite = name, suite
        self.timing = Timing()
        self.error: str | None = None
        self._zero_ns, self._stopped = zero_ns, stopped
        self._readings = Readings()
        self._book = Book(_RESOLUTION_NS, self.timing)
        self._reached = 0.0  # s of flight

    @property
    def where(self) -> str:
        """Return the address that the autopilot connects to."""
        raise NotImplementedError

    def wait(self, seconds: float) -> bool:
        """Wait until the autopilot is there; return False after so many seconds without it, or when stopped first."""
        raise NotImplementedError

    def _step(self, reading: Reading, truth: Truth) -> None:
        """Hand over a reading and the block of truth it comes from; wait for the autopilot.

        Raises:
            LinkLost: it has gone.
        """
        raise NotImplementedError

    def _attitudes(self) -> list[Answer]:
        """Return the attitudes that have come, on the clock of the stamps."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the connections."""
        raise NotImplementedError

    def exchange(self, truth: Truth, records: SuiteBlock, samples: Samples) -> Answers:
        """Send the readings of a block, each when the autopilot has done with the one before."""
        for reading in self._readings.make(samples, records):
            if self.error or self._stopped():
                break
            now = time.monotonic()
            self._book.sent(reading.t_ns, now, now)
            self._reached = reading.arrival_ns / 1e9
            try:
                self._step(reading, truth)
                self._receive()
            except LinkLost as error:
                self.error = f"{self.name}: link lost at {self._reached:.1f} s of flight ({error})"
        return self._book.take()

    def _receive(self) -> None:
        for answer in self._attitudes():
            self._book.received(answer, time.monotonic(), self._reached)

    def finish(self) -> Answers:
        """Return the last answers, and close the connections."""
        if not self.error:
            time.sleep(_LAST_S)
            with contextlib.suppress(LinkLost):
                self._receive()
        self.close()
        return self._book.take()

    def take_events(self) -> list[Event]:
        """Return what is worth knowing at the end: how many answers there were, or why the link was lost."""
        events = [Event(self._reached, "info", self.name, line) for line in self.timing.lines()]
        return events + ([Event(self._reached, "error", self.name, self.error)] if self.error else [])


class Px4(Autopilot):
    """PX4's simulator interface: HIL_SENSOR and HIL_GPS over TCP, HIL_ACTUATOR_CONTROLS as the call for the next.

    PX4 connects to us, has its time from HIL_SENSOR, and counts it from the first of them; until its first
    HIL_ACTUATOR_CONTROLS samples go out in real time (https://docs.px4.io/main/en/simulation, "Lockstep simulation").

    Args:
        name, suite, zero_ns, stopped: as for `Autopilot`.
        port: TCP, 4560 of PX4's first instance.
        answers: UDP port of its onboard MAVLink, 14540 of the first instance.

    Raises:
        InputError: a port is in use.
    """

    PORTS = 4560, 14540

    def __init__(
        self, name: str, suite: str, zero_ns: int, stopped: Callable[[], bool], *, port: int, answers: int
    ) -> None:
        super().__init__(name, suite, zero_ns, stopped)
        self._answers = _udp(answers, "--mavlink")
        try:
            self._link = Tcp(port, "--port")
        except InputError:
            self._answers.close()
            raise
        self._wire, self._theirs = Messages(), Messages()
        self._offset_us: int | None = None  # of the stamps from PX4's time
        self._begun: float | None = None  # real clock at t = 0 of the stamps
        self._heard = time.monotonic()

    @property
    def where(self) -> str:
        """Return the address that PX4 connects to."""
        return self._link.name

    def wait(self, seconds: float) -> bool:
        """Wait until PX4 has connected; return False after so many seconds without it, or when stopped first."""
        until = time.monotonic() + seconds
        return self._link.wait(lambda: self._stopped() or time.monotonic() > until)

    def _step(self, reading: Reading, truth: Truth) -> None:
        data = self._wire.pack("HIL_SENSOR", reading.t_ns // 1000, *sensors(reading), 0)
        if reading.position:
            data += self._wire.pack("HIL_GPS", *hil_gps(reading.position, reading.heading, self._zero_ns))
        now = time.monotonic()
        if self._begun is None:
            self._begun, self._heard = now - reading.t_ns / 1e9, now
        if self._offset_us is None:  # it is still starting: at the pace of a real clock
            time.sleep(max(0.0, self._begun + reading.t_ns / 1e9 - now))
        self._link.write(data)
        until = time.monotonic() + (_STEP_S if self._offset_us is not None else 0.0)
        while not self._called(reading.t_ns // 1000) and time.monotonic() < until:
            pass
        if self._offset_us is not None and time.monotonic() - self._heard > _SILENT_S:
            raise LinkLost(f"no HIL_ACTUATOR_CONTROLS for {_SILENT_S:g} s")

    def _called(self, t_us: int) -> bool:
        """Read what has come; tell whether it calls for the next sample after that of `t_us`."""
        called = False
        for name, fields in self._wire.feed(self._link.read(0.0 if self._offset_us is None else _STEP_S)):
            if name == "HIL_ACTUATOR_CONTROLS":
                offset = t_us - fields[0]  # too large by what the message is late
                self._offset_us = offset if self._offset_us is None else min(offset, self._offset_us)
                self._heard = time.monotonic()
                called = fields[0] + self._offset_us >= t_us
        return called

    def _attitudes(self) -> list[Answer]:
        found = []
        with contextlib.suppress(BlockingIOError):
            while True:
                for name, fields in self._theirs.feed(self._answers.recv(65536)):
                    if name == "ATTITUDE_QUATERNION" and self._offset_us is not None:
                        found.append(_moved(name, fields, self._offset_us * 1000))
        return found

    def close(self) -> None:
        """Close the ports."""
        self._link.close()
        self._answers.close()


class ArduPilot(Autopilot):
    """ArduPilot's JSON interface over UDP: servos are the call for a sample; the truth goes along.

    Gyro and accelerometer are those of the suite; GNSS, barometer and compass ArduPilot makes from the true position,
    velocity and attitude. Its time is the sum of the steps of our stamps, cut to whole microseconds
    (libraries/SITL/examples/JSON/readme.md and SIM_JSON.cpp). The attitude comes by MAVLink, to which we connect.

    Args:
        name, suite, zero_ns, stopped: as for `Autopilot`.
        port: UDP, 9002.
        answers: TCP port of its MAVLink, 5760.

    Raises:
        InputError: the port is in use.
    """

    PORTS = 9002, 5760

    def __init__(
        self, name: str, suite: str, zero_ns: int, stopped: Callable[[], bool], *, port: int, answers: int
    ) -> None:
        super().__init__(name, suite, zero_ns, stopped)
        self._servos = _udp(port, "--port")
        self._answers = answers
        self._mavlink: socket.socket | None = None
        self._wire = Messages(system=255)
        self._call: tuple[int, Any] | None = None  # number and address of the frame that waits for a sample
        self._reply = b""
        self._time_us, self._last_s = 0, 0.0  # as ArduPilot counts
        self._times: deque[tuple[int, int]] = deque(maxlen=500)  # its time, us, and our stamp, ns
        self._origin: np.ndarray | None = None
        self._asked = -10.0

    @property
    def where(self) -> str:
        """Return the address that ArduPilot sends its servo outputs to."""
        return f"udp:{self._servos.getsockname()[1]}"

    def wait(self, seconds: float) -> bool:
        """Wait until servos have come and MAVLink is connected; return False after so many seconds, or when stopped."""
        until = time.monotonic() + seconds
        while self._call is None or self._mavlink is None:
            if self._stopped() or time.monotonic() > until:
                return False
            if self._mavlink is None:
                with contextlib.suppress(OSError):
                    self._mavlink = socket.create_connection(("127.0.0.1", self._answers), timeout=0.5)
                    self._mavlink.setblocking(False)
            self._listen(0.2)
        return True

    def _listen(self, seconds: float) -> bool:
        """Wait for servos; tell whether they call for a new sample. An old call gets the old sample again."""
        self._servos.settimeout(seconds)
        try:
            packet, address = self._servos.recvfrom(4096)
            self._servos.setblocking(False)
            while True:  # the newest counts: it repeats itself while nobody answers
                packet, address = self._servos.recvfrom(4096)
        except TimeoutError:
            return False
        except BlockingIOError:
            pass
        if len(packet) < 8 or struct.unpack_from("<H", packet)[0] not in (18458, 29569):
            return False
        (number,) = struct.unpack_from("<I", packet, 4)
        if self._call is not None and number == self._call[0] and self._reply:
            self._servos.sendto(self._reply, address)
            return False
        self._call = number, address
        return True

    def _step(self, reading: Reading, truth: Truth) -> None:
        begun = time.monotonic()
        while self._reply and not self._listen(_STEP_S):
            if time.monotonic() - begun > _SILENT_S:
                raise LinkLost(f"no servos for {_SILENT_S:g} s")
            if self._stopped():
                return
        assert self._call is not None
        self._reply = self._sample(reading, truth)
        self._servos.sendto(self._reply, self._call[1])
        if self._reached - self._asked > 1.0 and not self._book.count:
            self._asked = self._reached
            self._ask()

    def _sample(self, reading: Reading, truth: Truth) -> bytes:
        stamp_s = reading.t_ns / 1e9
        self._time_us = int(self._time_us + (stamp_s - self._last_s) * 1e6)
        self._last_s = stamp_s
        self._times.append((self._time_us, reading.t_ns))
        if self._origin is None:
            self._origin = truth.lla[0]
        at = (reading.t_ns + SWITCHED_ON_NS) / 1e9
        row = min(int(np.searchsorted(truth.t, at)), len(truth) - 1)
        state = {
            "timestamp": stamp_s,
            "imu": {"gyro": reading.gyro_b.tolist(), "accel_body": reading.accel_b.tolist()},
            "position": wgs84.offset_n(truth.lla[row : row + 1], self._origin)[0].tolist(),
            "quaternion": truth.q_nb[row].tolist(),
            "velocity": truth.vel_n[row].tolist(),
            "airspeed": float(truth.airspeed[row]),
        }
        return b"\n" + json.dumps(state, separators=(",", ":")).encode() + b"\n"

    def _ask(self) -> None:
        """Ask for ATTITUDE_QUATERNION, 50 Hz (MAV_CMD_SET_MESSAGE_INTERVAL)."""
        assert self._mavlink is not None
        data = self._wire.pack("HEARTBEAT", 0, 6, 8, 0, 4, 3)
        data += self._wire.pack("COMMAND_LONG", 31.0, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0, 511, 1, 1, 0)
        try:
            self._mavlink.sendall(data)
        except OSError as error:
            raise LinkLost(error.strerror or "closed") from None

    def _attitudes(self) -> list[Answer]:
        assert self._mavlink is not None
        try:
            data = self._mavlink.recv(65536)
        except BlockingIOError:
            return []
        except OSError as error:
            raise LinkLost(error.strerror or "closed") from None
        if not data:
            raise LinkLost("closed by ArduPilot")
        return [self._stamped(f) for name, f in self._wire.feed(data) if name == "ATTITUDE_QUATERNION"]

    def _stamped(self, fields: tuple[float, ...]) -> Answer:
        """Give an attitude the stamp that ArduPilot's time stands for; one of another clock keeps its time."""
        theirs_us = int(fields[0]) * 1000
        near = min(self._times, key=lambda pair: abs(pair[0] - theirs_us - 500))  # cut to whole ms
        offset = near[1] - near[0] * 1000 if abs(near[0] - theirs_us - 500) <= 1500 else 10**15
        return _moved("ATTITUDE_QUATERNION", fields, offset)

    def close(self) -> None:
        """Close the ports."""
        self._servos.close()
        if self._mavlink is not None:
            self._mavlink.close()


AUTOPILOTS: dict[str, type[Px4] | type[ArduPilot]] = {"px4": Px4, "ardupilot": ArduPilot}
"""By the name that `--simulator` takes."""


def _moved(name: str, fields: tuple[float, ...], offset_ns: int) -> Answer:
    answer = attitude_of(name, fields)
    assert answer is not None
    return Answer(answer.t_ns + offset_ns, answer.q_nb)


def _udp(port: int, option: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind(("127.0.0.1", port))
    except (OSError, OverflowError) as error:
        made.close()
        raise InputError(f"{option} {port}: {getattr(error, 'strerror', None) or error}; choose another port") from None
    made.setblocking(False)
    return made
