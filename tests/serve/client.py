"""A unit under test: opens the wire, decodes the stream with a reader that is not ours, estimates and answers.

    python client.py PATH-OR-PORT PROTOCOL SITE.json

It runs in a process of its own, as a flight computer would.
"""

import json
import os
import select
import socket
import sys
import termios
import tty
from pathlib import Path
from typing import Any

import numpy as np
from readers import READERS

import estimators
from ahrs_sim import attitude
from estimators.types import Samples, SensorInfo, Site, blank


def sample(row: dict[str, Any]) -> Samples:
    """One row of samples."""
    columns = blank(Samples, 1)
    for name, value in row.items():
        if name in columns:
            columns[name][0] = value
    return Samples(**columns)


def warm_up(estimator: Any, site: Site) -> None:
    """Have everything compiled, or read from the disk, before the first sample."""
    n = 4000
    still = {"mag_b": np.tile(site.mag_n, (n, 1)), "mag_new": np.ones(n, bool)}
    accel = np.tile([0.0, 0.0, -site.gravity], (n, 1))
    estimator.process(Samples.make(np.arange(n) * 0.01, np.zeros((n, 3)), accel, **still))
    estimator.reset()


def open_wire(name: str) -> int:
    if name.startswith("fd:"):
        return int(name[3:])
    if name.isdigit():
        wire = socket.create_connection(("127.0.0.1", int(name)))
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return wire.detach()
    fd = os.open(name, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd, termios.TCSANOW)
    return fd


def main(wire: str, protocol: str, known: str, most: float = np.inf) -> None:
    given = json.loads(Path(known).read_text())
    site = Site(**{k: tuple(v) if isinstance(v, list) else v for k, v in given["site"].items()})
    sensors = SensorInfo(**{k: tuple(v) if isinstance(v, list) else v for k, v in given["sensors"].items()})
    estimator = estimators.create(given["method"], site=site, sensors=sensors, **given["settings"])
    warm_up(estimator, site)
    fd, reader, count = open_wire(wire), READERS[protocol](), 0
    while count < most:
        ready, _, _ = select.select([fd], [], [], 30.0)
        try:
            data = os.read(fd, 4096) if ready else b""
        except OSError:
            return
        if not data:
            return
        for row in reader.rows(data):
            estimates = estimator.process(sample(row))
            count += 1
            if np.isfinite(estimates.q_nb[0, 0]):
                os.write(fd, reader.answer(row, estimates.q_nb[0], attitude.euler(estimates.q_nb)[0]))


if __name__ == "__main__":
    main(*sys.argv[1:4], *map(float, sys.argv[4:5]))
