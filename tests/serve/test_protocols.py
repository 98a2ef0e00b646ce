"""Single messages: every quantity of a reading against readers that are not ours, and answers in every form."""

import datetime
import struct
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from readers import READERS, sbg_crc

from ahrs_sim import attitude
from ahrs_sim.serve import protocols
from ahrs_sim.serve.protocols import mavlink, sbg, vectornav
from ahrs_sim.serve.protocols.framing import gps_time
from ahrs_sim.serve.readings import SWITCHED_ON_NS, Heading, Position, Reading, pressure_altitude

EPOCH = datetime.datetime(2026, 6, 1, 10, tzinfo=datetime.UTC)
EPOCH_NS = int(EPOCH.timestamp()) * 10**9
RPY = np.radians([[12.5, -7.25, 301.0]])
Q = attitude.from_euler(RPY)[0]


def reading(t_ns: int = 12_340_000_000) -> Reading:
    return Reading(
        t_ns=t_ns,
        arrival_ns=t_ns + SWITCHED_ON_NS,
        gyro_b=np.array([0.1, -0.2, 0.3]),
        accel_b=np.array([0.5, -0.25, -9.75]),
        temperature=300.0,
        mag_b=np.array([21e-6, -3e-6, 42e-6]),
        position=Position(
            t_ns - 100_000_000,
            np.array([0.76, 0.0257, 151.5]),
            np.array([20.0, -3.0, 0.5]),
            np.array([1.0, 2.0, 3.0]),
            9,
        ),
        heading=Heading(t_ns - 100_000_000, 5.25, 0.004),
        static_pressure=99_000.0,
        diff_pressure=250.0,
        airspeed=21.5,
    )


def rows_of(name: str, *readings: Reading) -> list[dict[str, Any]]:
    protocol, reader = protocols.make(name, EPOCH_NS), READERS[name]()
    return [row for r in readings for row in reader.rows(protocol.encode(r))]


@pytest.mark.parametrize("name", protocols.NAMES)
def test_every_quantity_arrives(name: str) -> None:
    first, last = rows_of(name, reading(12_330_000_000), reading())
    sent = reading()
    assert last["t"] - first["t"] == pytest.approx(0.01, abs=1e-9)
    np.testing.assert_allclose(last["gyro_b"], sent.gyro_b, atol=3e-6)
    np.testing.assert_allclose(last["accel_b"], sent.accel_b, atol=6e-4)
    assert sent.position is not None and sent.heading is not None
    np.testing.assert_allclose(last["lla"], sent.position.lla, atol=2e-9 if name != "sbg" else 1e-12, rtol=1e-7)
    np.testing.assert_allclose(last["vel_n"], sent.position.vel_n, atol=6e-4)
    assert last["gnss_new"] and last["gnss_satellites"] == 9
    assert last["t"] - last["gnss_t"] == pytest.approx(0.1, abs=1e-6)
    if name != "ubx+nmea":
        np.testing.assert_allclose(last["mag_b"], sent.mag_b, rtol=1e-6)
    if name in ("sbg", "ubx+nmea"):
        assert last["heading"] == pytest.approx(5.25, abs=1e-5)
    if name == "sbg":
        assert last["airspeed"] == 21.5 and last["heading_sigma"] == pytest.approx(0.004)
    few = replace(
        sent, mag_b=None, position=None, heading=None, static_pressure=None, diff_pressure=None, airspeed=None
    )
    assert set(rows_of(name, few)[0]) == {"t", "stamp", "gyro_b", "accel_b"}


@pytest.mark.parametrize("name", protocols.NAMES)
def test_an_answer_comes_back_whatever_is_around_it(name: str) -> None:
    protocol, reader = protocols.make(name, EPOCH_NS), READERS[name]()
    sent = reading()
    (row,) = reader.rows(protocol.encode(sent))
    answer = reader.answer(row, Q, RPY[0])
    stream = b"\xfa\xfe\xff\x5a\xb5\x62\xfd" + answer[:-1] + b"\x00noise" + answer
    found = [a for i in range(len(stream)) for a in protocol.feed(stream[i : i + 1])]
    found += protocol.feed(bytes(600))  # what a false beginning waits for
    assert len(found) == 1
    assert abs(found[0].t_ns - sent.t_ns) <= protocol.resolution_ns
    assert np.degrees(np.linalg.norm(attitude.rotation_vector(found[0].q_nb[None], Q[None]))) < 2e-5
    if name in ("sbg", "ubx+nmea"):
        expected = [0.01, 0.02, 0.03] if name == "sbg" else np.radians([0.1, 0.2, 0.3])
        np.testing.assert_allclose(found[0].sigma, expected, atol=2e-7)


def test_mavlink_fields_are_those_of_pymavlink() -> None:
    from pymavlink.dialects.v20 import common

    for name, (number, form, extra) in mavlink.MESSAGES.items():
        theirs = getattr(common, f"MAVLink_{name.lower()}_message")
        assert (number, extra) == (theirs.id, theirs.crc_extra)
        assert struct.calcsize(form) == struct.calcsize(theirs.unpacker.format), name
        assert struct.unpack(form, bytes(range(struct.calcsize(form)))) == pytest.approx(
            struct.unpack(theirs.unpacker.format, bytes(range(struct.calcsize(form)))), nan_ok=True
        )
    sent, mav = reading(), common.MAVLink(None)
    wire = protocols.make("mavlink", EPOCH_NS)
    heartbeat, gps, imu = mav.parse_buffer(wire.encode(sent))
    assert heartbeat.get_type() == "HEARTBEAT" and heartbeat.autopilot == common.MAV_AUTOPILOT_INVALID
    assert imu.fields_updated == 0x1FFF and imu.abs_pressure == pytest.approx(990.0)
    assert imu.diff_pressure == 2.5 and imu.pressure_alt == pytest.approx(pressure_altitude(99_000.0))
    assert gps.ignore_flags == 2 | 4 | 32 and gps.yaw == pytest.approx(np.degrees(5.25) * 100, abs=0.5)
    assert (gps.time_week, gps.time_week_ms) == (2421, (10 * 3600 + 24 * 3600 + 18) * 1000 + 11_240)
    lost = replace(sent, heading=None, position=replace(sent.position, lla=np.full(3, np.nan)))
    gps, _ = mav.parse_buffer(wire.encode(lost))
    assert gps.fix_type == 0 and gps.ignore_flags & (1 | 64 | 128) and gps.yaw == 0 and gps.vn == 20.0


def test_mavlink_answers_of_every_kind() -> None:
    from pymavlink.dialects.v10 import common as first
    from pymavlink.dialects.v20 import common

    wire, mav, old = protocols.make("mavlink", 0), common.MAVLink(None), first.MAVLink(None)
    cov = [0.01, 0, 0, 0, 0.04, 0, 0, 0, 0.09]
    stream = mav.attitude_encode(5000, *RPY[0], 0, 0, 0).pack(mav)
    stream += mav.statustext_encode(6, b"not in the table").pack(mav)
    stream += mav.attitude_quaternion_cov_encode(6_000_000, list(Q), 0, 0, 0, cov).pack(mav)
    stream += old.attitude_quaternion_encode(7000, *Q, 0, 0, 0).pack(old)
    answers = wire.feed(stream)
    assert [a.t_ns for a in answers] == [5 * 10**9, 6 * 10**9, 7 * 10**9]
    for answer in answers:
        np.testing.assert_allclose(np.abs(answer.q_nb @ Q), 1.0, atol=1e-6)
    np.testing.assert_allclose(answers[1].sigma, [0.1, 0.2, 0.3], rtol=1e-6)
    assert answers[0].sigma is None


def test_vectornav_angles_with_sigmas() -> None:
    wire = protocols.make("vectornav", 0)
    ypr = np.degrees(RPY[0][::-1])
    both = vectornav.message((0, (0,)), (4, (1, 8)), payload=struct.pack("<Q6f", 77, *ypr, 3.0, 2.0, 1.0))
    unknown = vectornav.message((5, (12,)), payload=bytes(8))
    (answer,) = wire.feed(unknown + both + vectornav.message((0, (0, 5)), payload=bytes(20)))
    assert answer.t_ns == 77
    np.testing.assert_allclose(np.abs(answer.q_nb @ Q), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.degrees(answer.sigma), [1.0, 2.0, 3.0], rtol=1e-6)


def test_sbg_stamps_that_begin_anew_and_fast_rates() -> None:
    wire, late = protocols.make("sbg", EPOCH_NS), 2**32 * 1000 + 5_000_000
    body = wire.encode(
        replace(reading(late), gyro_b=np.array([40.0, 0.0, 0.0]), mag_b=None, position=None, heading=None)
    )
    stamp, status = struct.unpack_from("<IH", body, len(body) - 35)
    assert stamp == 5000 and status & 1 << 10
    assert struct.unpack_from("<6i", body, len(body) - 29)[3] == 40 * 12304174
    euler = struct.pack("<I6fIff", 2**32 - 1000, *RPY[0], 0.0, 0.0, 0.0, 0, 0.0, 0.0)
    (answer,) = wire.feed(sbg.message(6, euler))
    assert answer.t_ns == (2**32 - 1000) * 1000 and answer.sigma is None
    np.testing.assert_allclose(np.abs(answer.q_nb @ Q), 1.0, atol=1e-6)
    assert sbg_crc(b"123456789") == 0x2189  # CRC-16/KERMIT's check value


def test_nmea_beside_ubx() -> None:
    from pynmeagps import NMEAReader

    packets = protocols.make("ubx+nmea", EPOCH_NS).encode(reading())
    text = [NMEAReader(BytesIO(b"$GN" + part.split(b"\n")[0] + b"\n")).read()[1] for part in packets.split(b"$GN")[1:]]
    gga, rmc, hdt = text
    assert (gga.identity, rmc.identity, hdt.identity) == ("GNGGA", "GNRMC", "GNHDT")
    assert gga.lat == pytest.approx(np.degrees(0.76), abs=1e-7) and gga.alt == 151.5 and gga.numSV == 9
    assert rmc.lon == pytest.approx(np.degrees(0.0257), abs=1e-7) and rmc.date == datetime.date(2026, 6, 1)
    assert rmc.time.replace(microsecond=0) == datetime.time(10, 0, 11)
    assert rmc.spd == pytest.approx(np.hypot(20.0, 3.0) / 0.514444, abs=1e-3)


def test_gps_time_of_known_instants() -> None:
    assert gps_time(int(datetime.datetime(2024, 1, 7, tzinfo=datetime.UTC).timestamp()) * 10**9) == (2296, 18 * 10**9)
    assert pressure_altitude(101325.0) == 0.0
    assert pressure_altitude(89874.6) == pytest.approx(1000.0, abs=1.0)  # ICAO table


@pytest.mark.parametrize("name", protocols.NAMES)
def test_noise_on_the_wire_is_no_answer(name: str) -> None:
    rng = np.random.default_rng(5)
    protocol, reader = protocols.make(name, EPOCH_NS), READERS[name]()
    (row,) = reader.rows(protocol.encode(reading()))
    whole = reader.answer(row, Q, RPY[0])
    for _ in range(300):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), 3):
            damaged[at] = rng.integers(0, 256)
        if bytes(damaged) != whole:
            assert protocol.feed(bytes(damaged) + rng.bytes(rng.integers(0, 40))) == []
    protocol.feed(bytes(600))
    assert len(protocol.feed(whole)) == 1
