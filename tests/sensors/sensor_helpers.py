"""Truths from formulas and suites made in one line."""

import dataclasses
import datetime
import math
from typing import Any

import numpy as np

from ahrs_sim.flight.truth import Truth
from ahrs_sim.scenario import Component
from ahrs_sim.sensors import Suite, make_suite
from ahrs_sim.sensors.records import SuiteBlock
from estimators.types import Columns, blank

EPOCH = datetime.datetime(2026, 6, 1, 10, tzinfo=datetime.UTC)
START = np.array([0.76, 0.025, 150.0])
DT = 1.0 / 400.0


def truth(n: int, *, dt: float = DT, first: int = 0, **columns: Any) -> Truth:
    """Level, at rest, facing north; `columns` replace, broadcast to (n, ...)."""
    made = blank(Truth, n)
    for name, value in made.items():
        if value.dtype == float:
            value[:] = 0.0
        if name in columns:
            value[:] = columns[name]
    made["t"][:] = (np.arange(n) + first) * dt
    defaults = {
        "lla": START, "q_nb": [1.0, 0.0, 0.0, 0.0], "accel_b": [0.0, 0.0, -9.81], "pressure": 99000.0,
        "temperature": 288.15,
    }  # fmt: skip
    for name, value in defaults.items():
        if name not in columns:
            made[name][:] = value
    return Truth(**made)


def wild(n: int, *, dt: float = DT) -> Truth:
    """Everything moves: for properties that must hold in any flight."""
    t = np.arange(n) * dt
    roll, heading = 0.5 * np.sin(0.7 * t), 0.3 * t
    q = np.column_stack(
        [
            np.cos(roll / 2) * np.cos(heading / 2),
            np.sin(roll / 2) * np.cos(heading / 2),
            np.sin(roll / 2) * np.sin(heading / 2),
            np.cos(roll / 2) * np.sin(heading / 2),
        ]
    )
    wave = np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t), np.sin(t + 1.0)])
    return truth(
        n, dt=dt, q_nb=q, rate_ib_b=wave, rate_dot_b=2.0 * wave[:, ::-1], accel_b=9.81 * wave - [0, 0, 9.81],
        vel_n=20.0 * wave, lla=START + np.column_stack([t * 3e-6, t * 2e-6, 10.0 * np.sin(0.1 * t)]),
        cg_b=np.column_stack([0.01 * np.sin(t), 0 * t, 0 * t]), airspeed=22.0 + 3.0 * np.sin(t), alpha=0.05 * np.sin(t),
        beta=0.02 * np.cos(t), rpm=5000.0 + 500.0 * np.sin(t), throttle=0.5 + 0.4 * np.sin(0.3 * t),
        temperature=285.0 + np.sin(0.1 * t), pressure=98000.0 + 100.0 * np.sin(0.1 * t),
    )  # fmt: skip


def component(grade: str, name: str = "chr", **settings: Any) -> Component:
    return Component(name, {"grade": grade, **settings}, f"test.toml: [suite.{name}]")


def fault(**settings: Any) -> Component:
    return Component("fault", settings, "test.toml: [[fault]] 1")


def suite(grade: str, name: str = "chr", *, seed: int = 1, dt: float = DT, faults: Any = (), **settings: Any) -> Suite:
    return make_suite(component(grade, name, **settings), seed=seed, dt=dt, epoch=EPOCH, start_lla=START, faults=faults)


def run(s: Suite, flight: Truth, block: int = 0) -> SuiteBlock:
    """All records of a flight, processed in blocks of `block` rows (0: at once)."""
    size = block or len(flight)
    blocks = [s.sense(flight[i : i + size]) for i in range(0, len(flight), size)]
    return {k: type(v).concatenate([b[k] for b in blocks]) for k, v in blocks[0].items()}


def same(a: Columns, b: Columns) -> bool:
    """Bit for bit."""
    names = [f.name for f in dataclasses.fields(a)]
    return all(getattr(a, n).tobytes() == getattr(b, n).tobytes() for n in names)


def quaternion(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    cr, sr, cp, sp, cy, sy = (f(x / 2) for x in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
