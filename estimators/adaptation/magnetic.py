"""Magnetic disturbance rejection: a field that cannot be the Earth's is left out, the gyro carries the heading.

    | |m|/|M| - 1 | > norm,   | dip(m) - dip(M) | > dip,   | azimuth(m) - azimuth(M) | > turn   :   refused

with the field m as the predicted attitude turns it into navigation axes and M the local field. Norm and dip are the
classical signs of iron; a disturbance from the side leaves both nearly as they are (6 uT across a horizontal field of
23 uT: 1 % and 1 deg) and turns the needle by 15 deg, which only a heading that the gyro has carried can tell. A
disturbed sample refuses those of the next `hold` as well (alternating currents pass through zero). Refused for
`patience` without a break, the field is accepted again until it fits: a heading may be wrong, too, and at the start it
is the field that shows where north is.
"""

from typing import Any

import numpy as np

from estimators.adaptation.base import KEPT, Sensors
from estimators.elementary import atan2, hypot
from estimators.models.base import Handle
from estimators.native import Flag, Number, Record, local
from estimators.records import Place, Sample
from estimators.rotations import to_nav, wrap
from estimators.settings import Setting

SETTINGS = {
    "magnetic_norm": Setting(0.06, "magnetic: allowed relative error of the field's strength", above=0.0),
    "magnetic_dip": Setting(0.07, "rad, magnetic: allowed error of its dip", above=0.0),
    "magnetic_turn": Setting(
        0.12, "rad, magnetic: allowed error of its direction against the heading carried by the gyro", above=0.0
    ),
    "magnetic_hold": Setting(1.0, "s, magnetic: refused this long after the last disturbance", minimum=0.0),
    "magnetic_patience": Setting(
        30.0, "s, magnetic: re-accept a field refused continuously for this long", minimum=0.0
    ),
}


class Parameters(Record):
    """Limits, and the field they are about."""

    norm: Number  # relative
    dip: Number  # rad
    turn: Number  # rad
    hold: Number  # s
    patience: Number  # s
    strength: Number  # T
    down: Number  # rad, dip of the local field
    azimuth: Number  # rad, its declination


class Trust(Record, size=KEPT):
    """Holds the memory of the policy. Times are stored one second late, so that 0 means "never"."""

    trusted: Sensors
    since: Number  # s, refused since (0: not)
    bad: Number  # s, last seen disturbed (0: never)
    fitted: Flag  # the field has fitted once


def admit(policy: Parameters, model: Handle, row: Sample, x: np.ndarray, trust: Trust, used: np.ndarray) -> bool:
    """Refuse a field whose norm, dip or azimuth is not the Earth's."""
    first, end, sensor = model.magnetic[0], model.magnetic[1], model.magnetic[2]
    there = end > first
    for i in range(first, end):
        there = there and used[i] != 0
    if not there:
        return False
    m, now = local(3), row.t + 1.0
    to_nav(x, row.mag_b[0], row.mag_b[1], row.mag_b[2], m)
    level = hypot(m[0], m[1])
    off = abs(hypot(level, m[2]) / policy.strength - 1.0) > policy.norm
    off |= abs(atan2(m[2], level) - policy.down) > policy.dip
    off |= abs(wrap(atan2(m[1], m[0]) - policy.azimuth)) > policy.turn
    if off:
        trust.bad = now
    elif trust.bad == 0.0 or now - trust.bad >= policy.hold:
        trust.fitted, trust.since = True, 0.0
    disturbed = trust.fitted and trust.bad > 0.0 and now - trust.bad < policy.hold
    if disturbed and trust.since == 0.0:
        trust.since = now
    refused = disturbed and now - trust.since < policy.patience
    trust.trusted[sensor] = 0.0 if refused else 1.0
    for i in range(first, end):
        used[i] = not refused
    return refused


def configure(settings: Any, site: Place, policy: Parameters) -> None:
    """Set the parameters from the settings `magnetic_*` and the local field."""
    north, east, down = site.mag_n[0], site.mag_n[1], site.mag_n[2]
    level = hypot(north, east)
    policy.norm, policy.dip, policy.turn = settings.magnetic_norm, settings.magnetic_dip, settings.magnetic_turn
    policy.hold, policy.patience = settings.magnetic_hold, settings.magnetic_patience
    policy.strength, policy.down = hypot(level, down), atan2(down, level)
    policy.azimuth = atan2(east, north)
