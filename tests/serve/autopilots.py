"""PX4 and ArduPilot as their sides of the exchange are documented: for tests, since neither can be installed.

    python autopilots.py px4 PORT ANSWERS KNOWN.json
    python autopilots.py ardupilot PORT ANSWERS KNOWN.json

The fake PX4 estimates with `marg-ekf`; the fake ArduPilot reports the attitude it was given.
"""

import json
import os
import select
import socket
import struct
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from client import sample, warm_up

import estimators
from estimators.types import SensorInfo, Site

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common

STARTING = 50  # samples that pass before the first actuators
SETTLING = 20  # samples after the first answer by which the two go in step


def px4(port: int, answers: int, known: dict[str, Any]) -> None:
    """The order of SimulatorMavlink.cpp: heartbeat, a request, then actuators for each HIL_SENSOR."""
    site = Site(**{k: tuple(v) if isinstance(v, list) else v for k, v in known["site"].items()})
    info = SensorInfo(**{k: tuple(v) if isinstance(v, list) else v for k, v in known["sensors"].items()})
    estimator = estimators.create(known["method"], site=site, sensors=info, **known["settings"])
    warm_up(estimator, site)
    wire = socket.create_connection(("127.0.0.1", port))
    wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    mav, other = common.MAVLink(None, srcSystem=1), common.MAVLink(None, srcSystem=1)
    wire.sendall(mav.heartbeat_encode(0, 12, 0, 0, 0).pack(mav))
    request = mav.command_long_encode(0, 0, common.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 115, 5e3, 0, 0, 0, 0, 0)
    wire.sendall(request.pack(mav))
    start, count, fixes = None, 0, 0
    while data := wire.recv(4096):
        for m in mav.parse_buffer(data) or []:
            if m.get_type() == "HIL_GPS":
                fixes += 1
                assert m.fix_type == 3 and abs(m.lat * 1e-7 - np.degrees(site.lla[0])) < 0.1 and m.eph < 1000
                assert abs(m.time_usec * 1e-6 - known["epoch"]) < 1000.0
                continue
            assert m.get_type() == "HIL_SENSOR" and m.id == 0
            start = m.time_usec if start is None else start
            count += 1
            row = {"t": m.time_usec * 1e-6, "gyro_b": [m.xgyro, m.ygyro, m.zgyro], "accel_b": [m.xacc, m.yacc, m.zacc]}
            if m.fields_updated & 448:
                row |= {"mag_b": np.array([m.xmag, m.ymag, m.zmag]) * 1e-4, "mag_new": True}
            q = estimator.process(sample(row)).q_nb[0]
            now = m.time_usec - start
            if count < STARTING:
                continue
            if np.isfinite(q[0]):
                answer = other.attitude_quaternion_encode(now // 1000, *q, 0, 0, 0).pack(other)
                ground.sendto(
                    other.attitude_encode(now // 1000, 0, 0, 0, 0, 0, 0).pack(other) + answer, ("127.0.0.1", answers)
                )
            ready, _, _ = select.select([wire], [], [], 0.0)
            # Until the first answer has arrived, samples come at the pace of a clock, and may cross it.
            assert not ready or count < STARTING + SETTLING, "a sample before the actuators"
            wire.sendall(mav.hil_actuator_controls_encode(now, [0.0] * 16, 65, 1).pack(mav))
    assert fixes > 10 and count > 1000


def ardupilot(port: int, answers: int, known: dict[str, Any]) -> None:
    """The order of SIM_JSON.cpp: servos out, a frame in; time counted as there."""
    server = socket.create_server(("127.0.0.1", answers))
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.settimeout(0.5)
    ground, _ = server.accept()  # SITL waits for it, too
    ground.setblocking(False)
    mav = common.MAVLink(None, srcSystem=1)
    number, time_us, last_s, wanted, before = 0, 0, 0.0, False, b""
    while True:
        packet = struct.pack("<HHI16H", 18458, 1200, number, *[1500] * 16)
        udp.sendto(packet, ("127.0.0.1", port))
        try:
            frame = udp.recv(65000)
        except TimeoutError:
            if number and wanted:
                break  # the flight is over
            continue
        if frame == before:
            continue  # the answer to what was asked twice, because it took more than half a second
        assert frame[:1] == frame[-1:] == b"\n"
        for key in (
            b'{"timestamp":',
            b'"imu":{"gyro":[',
            b'"accel_body":[',
            b'"position":[',
            b'"velocity":[',
            b'"quaternion":[',
        ):
            assert key in frame  # its parser looks for the text
        state = json.loads(frame)
        if number == 20:  # a frame that was lost: asked for again, and the same comes again
            udp.sendto(packet, ("127.0.0.1", port))
            assert udp.recv(65000) == frame
        number += 1
        before = frame
        step = state["timestamp"] - last_s
        assert step > 0.0
        time_us, last_s = int(time_us + step * 1e6), state["timestamp"]
        try:
            for m in mav.parse_buffer(ground.recv(4096)) or []:
                wanted |= m.get_type() == "COMMAND_LONG" and (m.command, m.param1) == (511, 31.0)
        except BlockingIOError:
            pass
        if wanted and number % 2 == 0:  # 50 Hz
            ground.sendall(mav.attitude_quaternion_encode(time_us // 1000, *state["quaternion"], 0, 0, 0).pack(mav))
    assert np.linalg.norm(state["position"]) > 50.0 and state["airspeed"] > 5.0
    time.sleep(0.1)


if __name__ == "__main__":
    {"px4": px4, "ardupilot": ardupilot}[sys.argv[1]](
        int(sys.argv[2]), int(sys.argv[3]), json.loads(Path(sys.argv[4]).read_text())
    )
