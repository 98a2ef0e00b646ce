"""GNSS velocity and position, differenced with the state kept from the time of the fix (latency).

A delay that the stamps do not know of is learnt beside the filter. A velocity that is `late` s older than it says is
off by -a late, a the acceleration; the delay is the scalar estimate of that from each fix, its variance bounded below
so that it goes on learning while the filter's own velocity gives way to the same error. Only an acceleration that
lasts, and is larger than the vibration, shows it. It is taken out from `SURELY_LATE` on.

A velocity or a place that is off by more than `JUMP` sigma, prediction and fix together, is no error of the attitude:
it is a receiver that is wrong, has been, or is right again after the IMU has missed something. That fix is left out,
and before the next the velocity, or the place, becomes as uncertain as it was off: it goes where the fixes are and
takes little of the attitude along. Fixes from before that step are not compared with what came after it.
"""

import math
from typing import Annotated, Any

import numpy as np

from estimators.earth import apart
from estimators.jit import inner
from estimators.models.ins.layout import BG, P_, RING_ANGLES, Kept, Motion, Shared, State, V
from estimators.models.ins.mechanisation import acceleration
from estimators.native import Flag, Number, Record, Vector3, local, shaped
from estimators.past import WIDTH, recall
from estimators.plausible import MAX_SPEED, on_earth, plausible
from estimators.records import Place, Sample, Sheet
from estimators.settings import Setting
from estimators.turned import note_fix

NAME = READS_AS = "gnss"
ANGLE, REPORTED = False, True
SPAN = 0.1  # s, over which the acceleration is taken
LATEST, LEAST_LATE = 0.6, 0.005  # s, the longest delay, and the least sigma of it
MANOEUVRE = 1.0  # m/s2, the least acceleration that shows a delay
SETTLED = 20.0  # s: the error of an attitude that was begun in flight looks like a delay for so long
SURELY_LATE = 0.08  # s: less may be a bias of the accelerometer, which a turn cannot tell from a delay
UP = 1.5  # satellites are all above: vertical errors are larger by about that
JERK = 1.0  # m/s3, of a turn: a delay of a second shows like so much of a bias of the accelerometer
JUMP = 12.0  # sigma: a real receiver with more noise than its sheet says stays below, one that lies is far above

SETTINGS = {
    "velocity_share": Setting(1.0, "of the receiver's velocity sigma", above=0.0),
    "position_share": Setting(0.2, "of the receiver's position sigma, noise from fix to fix", above=0.0),
    "position_time": Setting(60.0, "s, over which the rest of a fix's error wanders", above=0.0),
    "late_sigma": Setting(0.2, "s, of a fix's delay that is not declared: learnt; 0: there is none", minimum=0.0),
    "gnss_time": Setting(0.02, "s, error of the time of a fix: noise while accelerating", minimum=0.0),
}


Offsets = Annotated[np.ndarray, shaped(6)]


class Parameters(Record):
    """Parameters of the aid."""

    fitted: Flag
    velocity: Number  # m/s
    position: Number  # m, from fix to fix
    time2: Number  # s2, of the time of a fix
    late2: Number  # s2, prior variance of a delay that is not declared
    unsure2: Number  # s2, of a delay that has been learnt


class Memory(Record):
    """The delay that is not declared, and jumps of the fixes; NaN: no fix yet, no jump yet."""

    late: Number  # s
    late2: Number  # s2, its variance
    begun_t: Number  # s, when it was begun with
    wait_s: Number  # s, from then until it is learnt
    vel2: Vector3  # m2/s2, variance of the velocity after the last row
    place2: Vector3  # m2, of the place
    off2: Offsets  # squares of what the last fix was off, of velocity and place that jumped; 0: it did not
    opens2: Offsets  # the same, for the next step alone
    moved_t: Number  # s, when the state was last moved to fixes that had jumped


class Readings(Record):
    """Holds the innovation at the IMU: the receiver's fix less the antenna's motion at the time of the fix."""

    vel_n: Vector3  # m/s
    place_n: Vector3  # m from the origin


@inner
def configure(settings: Any, site: Place, sensors: Sheet, own: Parameters) -> None:
    """Set the parameters."""
    own.fitted = settings.aiding == 1 or settings.aiding == 3  # "gnss", "gnss+airspeed"
    own.velocity = max(settings.velocity_share * sensors.gnss_vel, 1e-3)
    own.position = max(settings.position_share * sensors.gnss_pos, 1e-3)
    own.time2 = settings.gnss_time**2
    own.late2 = settings.late_sigma**2
    own.unsure2 = max(sensors.accel_bias / JERK, LEAST_LATE) ** 2


def reads(states: int) -> tuple[int, int]:
    """Velocity and position."""
    return V, BG


@inner
def measure(
    own: Parameters, model: Shared, row: Sample, x: State, kept: Memory, memory: Kept, u: Motion, z: Readings,
    variance: Readings, used: Any,
) -> None:  # fmt: skip
    """Take every fix whose time the ring still knows."""
    if not (own.fitted and row.gnss_new):
        return
    then, there, here = local(WIDTH), local(3), local(3)
    if math.isnan(kept.late):
        kept.late, kept.late2, kept.begun_t = 0.0, own.late2, row.t
    taken = kept.late if kept.late > SURELY_LATE else 0.0
    true_t = row.gnss_t - taken
    memory.late2 = own.unsure2 if taken > 0.0 else 0.0
    if true_t < kept.moved_t or not recall(memory.ring, true_t, RING_ANGLES, then):
        return
    north, east, down = acceleration(model, x, u)
    accelerating2 = north * north + east * east + down * down
    apart(row.lla, then[3:6], there)
    apart(x.lla, model.origin, here)
    place, complete = on_earth(row.lla[0], row.lla[1], row.lla[2]), True
    for i in range(3):
        speed, wide = row.vel_n[i], UP if i == 2 else 1.0
        # innovation against the state of then, put on top of the state of now
        z.vel_n[i] = x.vel_n[i] + (speed - then[i])
        z.place_n[i] = here[i] + there[i]
        variance.vel_n[i] = (wide * own.velocity) ** 2 + own.time2 * accelerating2
        variance.place_n[i] = (wide * own.position) ** 2
        known = plausible(speed, MAX_SPEED)
        used.vel_n[i], used.place_n[i] = known, place and plausible(there[i], 1e6)
        complete &= known
    agreed = agrees(row, then, there, accelerating2, kept, variance, used)
    if agreed and own.late2 > 0.0 and row.t - kept.begun_t >= kept.wait_s:
        learn_delay(own, memory, row, taken, then, kept)
    memory.fixed = used.vel_n[0] != 0
    if complete:
        if agreed:
            note_fix(memory.turned, true_t, row.vel_n[0], row.vel_n[1], then[7], then[8])
        v = row.vel_n
        memory.speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        memory.aid_t = memory.fix_t = row.t


@inner
def agrees(
    row: Sample, then: np.ndarray, there: np.ndarray, accelerating2: float, kept: Memory, variance: Readings, used: Any
) -> bool:  # fmt: skip
    """Leave out velocity or place that jumped; the step after this row opens them, and the next fix is taken."""
    opened, speed2 = False, 0.0
    for i in range(6):
        opened |= kept.off2[i] > 0.0
        kept.off2[i] = 0.0
    if opened:
        kept.moved_t = row.t
        return False
    for i in range(3):
        speed2 += then[i] * then[i]
    unknown2 = kept.late2 - min(LEAST_LATE**2, kept.late2)  # of the delay, while it is being learnt
    speed_jumps = place_jumps = False
    for i in range(3):
        off, offset = row.vel_n[i] - then[i], there[i]
        within = kept.vel2[i] + variance.vel_n[i] + unknown2 * accelerating2
        speed_jumps |= used.vel_n[i] != 0 and off * off > JUMP**2 * within
        within = kept.place2[i] + variance.place_n[i] + unknown2 * speed2
        place_jumps |= used.place_n[i] != 0 and offset * offset > JUMP**2 * within
    for i in range(3):
        if speed_jumps:
            kept.off2[i] = kept.opens2[i] = (row.vel_n[i] - then[i]) ** 2
            used.vel_n[i] = False
        if place_jumps:
            kept.off2[3 + i] = kept.opens2[3 + i] = there[i] ** 2
            used.place_n[i] = False
    return not (speed_jumps or place_jumps)


@inner
def learn_delay(own: Parameters, memory: Kept, row: Sample, taken: float, then: np.ndarray, kept: Memory) -> None:
    """Improve the delay by what a velocity is off along the acceleration of its time."""
    before = local(WIDTH)
    if not recall(memory.ring, row.gnss_t - taken - SPAN, RING_ANGLES, before):
        return
    information, along, square = 0.0, 0.0, 0.0  # of what the delay is beyond its estimate
    for i in range(3):
        wide = UP if i == 2 else 1.0
        a = (then[i] - before[i]) / SPAN
        variance = 4.0 * (wide * own.velocity) ** 2  # the filter's own error with it
        if not plausible(row.vel_n[i], MAX_SPEED):
            return
        square += a * a
        information += a * a / variance
        along -= a * (row.vel_n[i] - then[i]) / variance
    steady = memory.steady_n
    lasting = steady[0] ** 2 + steady[1] ** 2 + steady[2] ** 2 - memory.shaky  # vibration is not in the receiver
    if min(square, lasting) < MANOEUVRE**2:
        return
    along += (taken - kept.late) * information
    late2 = kept.late2 / (1.0 + kept.late2 * information)
    kept.late = min(max(kept.late + late2 * along, 0.0), LATEST)
    kept.late2 = max(late2, min(LEAST_LATE**2, own.late2))


@inner
def observe(own: Parameters, model: Shared, x: State, u: Motion, y: np.ndarray) -> None:
    """Velocity, and place from the origin."""
    metres = local(3)
    apart(x.lla, model.origin, metres)
    for i in range(3):
        y[i] = x.vel_n[i]
        y[3 + i] = metres[i]


@inner
def slope(own: Parameters, model: Shared, x: State, u: Motion, H: np.ndarray) -> None:
    """Identity."""
    for i in range(3):
        H[i, V + i] = H[3 + i, P_ + i] = 1.0
