"""Findings from the estimates of a recording: no attitude and why, innovations that are not of the predicted size."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ahrs_sim.chain import Chain
from estimators.alignment import MOVING_S
from estimators.types import Estimates

SETTLED_S = 30.0
"""Innovations of this time after the first attitude are left out: the filter still converges."""

LEAST_S = 20
"""Least seconds with innovations for a finding about them."""

LOW, HIGH = 0.02, 4.0
"""Limits of NIS per degree of freedom, median over the seconds, outside of which it is a finding. The lower one holds
for a velocity only: filters take measurements whose errors are correlated in time with a larger sigma on purpose."""

GIVEN_UP = 0.2
"""Share of the rows for which a sensor may be given up without a finding."""

_NAMES = {
    "vel_n": ("GNSS velocity", "gnss_vel"),
    "place_n": ("GNSS position", "gnss_pos"),
    "azimuth": ("magnetometer", "mag_bias"),
    "mag_b": ("magnetometer", "mag_bias"),
    "heading": ("two-antenna heading", "heading"),
    "course": ("course of GNSS", "gnss_vel"),
    "vel_b": ("airspeed", "airspeed"),
    "accel_b": ("accelerometer", "accel_noise"),
    "down_b": ("accelerometer", "accel_noise"),
    "gyro_b": ("gyro", "gyro_noise"),
}
"""By the last part of a measurement's name: what it is to the user, and its figure in `[sensors]`."""


@dataclass
class _Seen:
    """Collects what one estimator has reported so far."""

    measurements: Mapping[str, slice]
    from_ground: bool  # it takes its noise from the standing vehicle
    notes: Mapping[int, tuple[str, str]]  # what 1 in a column of `Estimates.adaptation` means
    rows: int = 0  # with an attitude
    noted: dict[int, int] = field(default_factory=dict)  # of them, by column of `notes`: with a 1
    first: float = math.nan  # s, of its rows
    last: float = math.nan
    aligned: float = math.nan  # s, of its first attitude
    squares: dict[str, dict[int, list[float]]] = field(default_factory=dict)  # by measurement and second: sum, count


class Outcome:
    """Watches the estimates of a replay.

    Args:
        chains: by suite; estimators from outside are watched for an attitude only.
    """

    def __init__(self, chains: Mapping[str, Chain]) -> None:
        self._seen = {name: _seen(e) for chain in chains.values() for name, e in chain.estimators.items()}

    def add(self, name: str, estimates: Estimates) -> None:
        """Take note of a block of estimates."""
        if not len(estimates):
            return
        seen = self._seen[name]
        seen.first = float(estimates.t[0]) if math.isnan(seen.first) else seen.first
        seen.last = float(estimates.t[-1])
        if math.isnan(seen.aligned):
            known = np.flatnonzero(np.isfinite(estimates.down_b).all(axis=1))
            seen.aligned = float(estimates.t[known[0]]) if len(known) else math.nan
        settled = estimates.t > seen.aligned + SETTLED_S  # none while it is NaN
        seen.rows += int(settled.sum())
        for column in seen.notes:
            ones = int((estimates.adaptation[settled, column] == 1.0).sum())
            seen.noted[column] = seen.noted.get(column, 0) + ones
        for measured, columns in seen.measurements.items():
            innovation, variance = estimates.innovation[:, columns], estimates.innovation_var[:, columns]
            with np.errstate(invalid="ignore", divide="ignore"):
                nis = np.mean(innovation**2 / variance, axis=1)
            rows = np.flatnonzero(settled & np.isfinite(nis))
            seconds = seen.squares.setdefault(measured, {})
            for second, value in zip(estimates.t[rows].astype(int).tolist(), nis[rows].tolist(), strict=True):
                pair = seconds.setdefault(second, [0.0, 0.0])
                pair[0] += value
                pair[1] += 1.0

    def lines(self, *, suspected: bool = False) -> list[str]:
        """Say what is wrong, a line each; nothing where all is as it should be.

        Args:
            suspected: checks have named a wrong unit, axis or delay, of which innovations are the consequence.
        """
        found = []
        for name, seen in self._seen.items():
            if math.isnan(seen.aligned):
                seconds = 0.0 if math.isnan(seen.first) else seen.last - seen.first
                found.append(
                    f"{name}: no attitude: never aligned in {seconds:.0f} s; it takes {MOVING_S:.0f} s of motion, or "
                    "align_s of standing ([estimator.NAME] in a map)"
                )
            for column, count in seen.noted.items():
                if count > GIVEN_UP * seen.rows:
                    found.append(f"check: {name}: {seen.notes[column][0]}, {100 * count / seen.rows:.0f} % of the time")
            nis = {measured.rpartition(".")[2]: value for measured, value in self.nis(name).items()}
            high = {m: value for m, value in nis.items() if value > HIGH}
            if high:
                cause = "late, disturbed, or worse than [sensors] says"
                if suspected:
                    cause = "first mend what the checks above name"
                elif seen.from_ground:
                    cause = 'noise as of the standing vehicle is too small in motion: noise = "practical"'
                found.append(f"check: {name}: {_listed(high)}, right is 1: {cause}")
            if nis.get("vel_n", 1.0) < LOW:
                found.append(
                    f"check: {name}: {_listed({'vel_n': nis['vel_n']})}, right is 1: better than [sensors] says"
                )
        return found

    def nis(self, name: str) -> dict[str, float]:
        """Compute NIS per degree of freedom of each measurement of an estimator, median over the seconds with one."""
        return {
            measured: float(np.median([total / count for total, count in seconds.values()]))
            for measured, seconds in self._seen[name].squares.items()
            if len(seconds) >= LEAST_S
        }


def _seen(estimator: Any) -> _Seen:
    settings = getattr(estimator, "settings", {})
    measured = getattr(estimator, "measurements", {})
    if settings.get("aiding") == "none":  # there a place and a velocity are supposed, not measured
        measured = {name: columns for name, columns in measured.items() if not name.startswith("gnss.")}
    stated = settings.get("noise")
    ground = stated == "from-ground" or (stated == "auto" and settings.get("aiding") == "none")
    return _Seen(measured, ground, getattr(estimator, "notes", {}))


def _listed(nis: Mapping[str, float]) -> str:
    """List NIS of each sensor with its figure in `[sensors]`, the worst first."""
    worst = sorted(nis.items(), key=lambda item: -item[1])
    return "NIS of " + ", ".join(f"{_NAMES[m][0]} {value:.3g} ({_NAMES[m][1]})" for m, value in worst)
