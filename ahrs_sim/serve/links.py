"""The wire to a unit: a pseudo-terminal, a TCP port of this machine, or a serial device.

pty                     a new pseudo-terminal; its name is printed, the unit opens it
tcp:PORT                waits on 127.0.0.1 for the unit to connect
/dev/ttyUSB0[@BAUD]     a device, raw, 8N1; 115200 baud unless said otherwise
"""

import contextlib
import os
import re
import select
import socket
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path

from ahrs_sim.errors import InputError

_POLL_S = 0.2
_BAUD = 115200


class LinkLost(Exception):
    """The other side has gone: why, as part of a line."""


class Link:
    """A wire that is read and written at the same time.

    Args:
        name: for messages.
        fd: of the open wire; -1: not connected yet.
    """

    baud: int | None = None
    """Bits a second that go through, eight bits as ten; None: as many as are sent."""

    def __init__(self, name: str, fd: int = -1) -> None:
        self.name, self._fd = name, fd

    def wait(self, stopped: Callable[[], bool]) -> bool:
        """Wait until the unit is there; return False when `stopped` first."""
        return not stopped()

    def read(self, seconds: float = _POLL_S) -> bytes:
        """Return what has come, empty after so many seconds without anything.

        Raises:
            LinkLost: nothing will come any more.
        """
        try:
            ready, _, _ = select.select([self._fd], [], [], seconds)
            data = os.read(self._fd, 65536) if ready else b""
        except (OSError, ValueError) as error:
            raise LinkLost(getattr(error, "strerror", None) or "closed") from None
        if ready and not data:
            raise LinkLost("closed by the other side")
        return data

    def write(self, data: bytes) -> None:
        """Send, and wait while the wire is full.

        Raises:
            LinkLost: the other side has gone, or takes nothing for two seconds.
        """
        while data:
            try:
                _, ready, _ = select.select([], [self._fd], [], 2.0)
                if not ready:
                    raise LinkLost("the unit takes no more data")
                data = data[os.write(self._fd, data) :]
            except (OSError, ValueError) as error:
                raise LinkLost(getattr(error, "strerror", None) or "closed") from None

    def close(self) -> None:
        """Close the wire."""
        fd, self._fd = self._fd, -1
        with contextlib.suppress(OSError):
            os.close(fd)


class Pty(Link):
    """A pseudo-terminal whose other end, `name`, the unit opens."""

    def __init__(self) -> None:
        fd, other = os.openpty()
        tty.setraw(other)
        os.set_blocking(fd, False)
        super().__init__(os.ttyname(other), fd)
        os.close(other)

    def wait(self, stopped: Callable[[], bool]) -> bool:
        """Wait until the unit has opened its end; return False when `stopped` first."""
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        while any(event & select.POLLHUP for _, event in poll.poll(0)):
            if stopped():
                return False
            time.sleep(_POLL_S / 10)
        return True


class Device(Link):
    """A serial device, raw, 8N1."""

    def __init__(self, path: str, baud: int) -> None:
        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise InputError(f"--serial {path}@{baud}: no such speed; try 115200, 460800, 921600")
        fd = -1
        try:
            fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            super().__init__(path, fd)
            tty.setraw(fd)
            settings = termios.tcgetattr(fd)
            settings[4] = settings[5] = speed
            termios.tcsetattr(fd, termios.TCSANOW, settings)
        except (OSError, termios.error) as error:
            if fd >= 0:
                os.close(fd)
            why = error.strerror if isinstance(error, OSError) else "is no serial device"
            raise InputError(f"--serial {path}: {why}; give the device of the unit, pty or tcp:PORT") from None
        self.baud = baud


class Tcp(Link):
    """A TCP port of this machine, to which one unit connects."""

    def __init__(self, port: int, option: str = "--serial") -> None:
        if port > 65535:
            raise InputError(f"{option} tcp:{port}: ports go up to 65535; choose another port")
        try:
            self._server = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            why = os.strerror(error.errno) if error.errno else error
            raise InputError(f"{option} tcp:{port}: {why}; choose another port") from None
        super().__init__(f"tcp:{self._server.getsockname()[1]}")

    def wait(self, stopped: Callable[[], bool]) -> bool:
        """Wait until the unit has connected; return False when `stopped` first."""
        self._server.settimeout(_POLL_S)
        while not stopped():
            with contextlib.suppress(TimeoutError):
                peer, _ = self._server.accept()
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                peer.setblocking(False)
                self._fd = peer.detach()
                return True
        return False

    def close(self) -> None:
        """Close the connection and the port."""
        super().close()
        self._server.close()


def open_link(text: str) -> Link:
    """Open the wire that `--serial` names.

    Raises:
        InputError: not one of the three forms, a port in use, a device that cannot be opened.
    """
    if text == "pty":
        return Pty()
    if match := re.fullmatch(r"tcp:(\d{1,5})", text):
        return Tcp(int(match[1]))
    path, _, baud = text.partition("@")
    if path.startswith("/") and (not baud or baud.isdecimal()):
        if not Path(path).exists():
            raise InputError(f"--serial {path}: no such device; connect the unit, or give pty or tcp:PORT")
        return Device(path, int(baud or _BAUD))
    raise InputError(f"--serial {text}: unknown; give pty, tcp:PORT or a device like /dev/ttyUSB0@115200")
