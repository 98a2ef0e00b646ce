"""What in a recording contradicts the conventions assumed, a line each: units, axes, signs, delays.

A line names a cause only when the data single it out: the wrong assumption fits badly, one other fits well, and no
third comes near. With too little motion to tell there is no line.
"""

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

import estimators as library
from ahrs_sim import attitude
from ahrs_sim.attitude import interpolate
from ahrs_sim.evaluation.sync import rates
from ahrs_sim.recordings import inertial
from ahrs_sim.recordings.calibration import Turns, turns
from ahrs_sim.recordings.inertial import Track
from ahrs_sim.recordings.survey import BIN_S, Survey
from ahrs_sim.scenario import Component
from ahrs_sim.world import magnetic, wgs84
from ahrs_sim.world.gravity import STANDARD as G

GYRO_RANGE = 70.0  # rad/s, 4000 deg/s: no gyro of a vehicle measures more
_CALM = 0.6  # m/s2 off gravity up to which an accelerometer shows the vertical
_LATE = 0.05  # s: smaller delays of GNSS are not worth a line
_MISFIT = 1.0  # m/s: IMU and GNSS velocity agree to less than this
_DIP = math.radians(20.0)
_COURSE = math.radians(8.0)
_TURN_BINS = 5
_STUCK_S = 1.0
_LEG_S, _FEWEST_LEGS, _FASTEST = 4.0, 10, 350.0  # s; m/s
_SETTLING_S, _SETTLING, _SETTLED_S = 20.0, math.radians(30.0), 60.0  # an attitude that is being aligned, and is
_AIDS = {"gnss": "GNSS velocity", "airspeed": "airspeed"}


@dataclass(frozen=True)
class Assumed:
    """Holds what the checks test: axes, field and delay that the map assumes."""

    body: str  # axes of the IMU's messages
    reference: tuple[str, str] | None  # body and world axes of the reference attitude, when there is one
    mag_axes: np.ndarray  # (3, 3) from the axes of the magnetometer's messages to FRD
    mag_b: np.ndarray  # (n, 3) T in FRD, calibrated
    field_n: np.ndarray | None  # (3,) T NED, field of the place; None: not known
    delay: float  # s, by which the reference is later than the gyro


def suspicions(s: Survey, assumed: Assumed, track: Track | None) -> list[str]:
    """List what contradicts the assumptions, a line each.

    Args:
        s: the survey.
        assumed: what is taken to be so.
        track: IMU and GNSS velocity together, where there is enough of both.
    """
    if stuck := _stuck(s):
        return stuck
    found = _accelerometer(s, assumed.body) or _at_rest(s, assumed.body)
    found += _bias(s)
    velocity = _velocity(s)
    units = _gyro_unit(s) + _field_unit(s, assumed.field_n) + velocity
    found += units
    if not found:
        found += _orientation(s, assumed, track) or _dip(s, assumed)
    if track is not None and track.misfit < _MISFIT and not velocity:
        if track.delay_sigma < _LATE and abs(track.delay) > _LATE + 3.0 * track.delay_sigma:
            found.append(late_line(track))
        if not found:
            found += _course(assumed, track)
    if assumed.reference:
        found += _against_reference(s, assumed.reference, assumed.delay, bool(units))
    return found


def missing(chosen: Collection[str], s: Survey) -> list[str]:
    """List sensors that are missing and what that makes of the errors, a line each."""
    found = []
    moved = np.ptp(s.fixes[:, :2], axis=0).max() if len(s.fixes) else 0.0
    if moved > 1e-5 and "velocity" not in chosen:
        found.append("positions without a velocity: no GNSS aid for estimators; [topics] velocity names its topic")
    if not {"mag", "heading", "velocity"} & set(chosen):
        found.append("nothing in it measures heading: its error is that of the start; --align heading takes it out")
    return found


def unaided(components: Iterable[Component], chosen: Collection[str]) -> list[str]:
    """List estimators with an aid that is not among the kinds chosen, a line each."""
    methods = {m.name: m for m in library.describe() if m.own}
    there = {"gnss": "velocity" in chosen, "airspeed": bool({"air", "diff_pressure"} & set(chosen))}
    found = []
    for component in components:
        method = methods.get(str(component.settings["method"]))
        if method is None:
            continue
        stated = method.settings.get("aiding")
        aiding = str(component.settings.get("aiding", stated.default if stated else method.aiding))
        lacks = " and ".join(_AIDS[word] for word, has in there.items() if word in aiding and not has)
        if lacks:
            found.append(
                f"{component.name} is aided by {lacks}, which is not in this recording: "
                "its attitude drifts, or is wrong while something accelerates it"
            )
        if there["gnss"] and "gnss" not in aiding and not {"mag", "heading"} & set(chosen):
            found.append(f"{component.name} has nothing that measures heading: its error is that of the start")
    return found


def late_line(track: Track) -> str:
    """Describe a delay of the GNSS velocity in a line."""
    word = "late" if track.delay > 0 else "early"
    shift = -round(track.delay, 2)
    return (
        f"GNSS velocity is {word} by {abs(track.delay):.2f} +- {max(track.delay_sigma, 0.005):.2f} s: "
        f"[time] velocity_s = {shift:g} (and fix_s, of the same receiver)"
    )


def _stuck(s: Survey) -> list[str]:
    """Find an IMU that repeats one reading while the field turns."""
    readings = np.column_stack([s.gyro_b, s.accel_b])
    same = (np.abs(np.diff(readings, axis=0)).max(axis=1, initial=0.0) < 1e-12) & (s.scatter[1:].max(axis=1) < 1e-12)
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(int)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if s.t[last] - s.t[first] < _STUCK_S:
            continue
        field = s.mag[first : last + 1]
        field = field[np.isfinite(field).all(axis=1)]
        if len(field) > 2 and np.ptp(field, axis=0).max() > 0.1 * np.median(np.linalg.norm(field, axis=1)):
            found.append((float(s.t[first]), float(s.t[last] - s.t[first])))
    if not found:
        return []
    times = f", {len(found)} times" if len(found) > 1 else ""
    return [
        f"the IMU repeats one reading for {sum(d for _, d in found):.1f} s (from {found[0][0]:.1f} s on{times}) while "
        "the field turns: it was stuck; --skip or --until leave that out"
    ]


# ----------------------------------------------------------------------------------------------- accelerometer


def _accelerometer(s: Survey, body: str) -> list[str]:
    """Unit, missing gravity and sign of the accelerometer, by its norm over the whole recording."""
    norm = np.linalg.norm(s.accel_b, axis=1)
    if len(norm) < 50:
        return []
    low, middle, high = np.quantile(norm, [0.25, 0.5, 0.75])
    for unit, size in (("g", 1.0), ("mg", 1000.0)):
        if 0.8 * size < middle < 1.3 * size and high < 1.5 * low:
            return [f"accelerometer reads {middle:.2f} in the median: unit is {unit}? ([imu] accel_unit)"]
    as_gravity = np.mean((norm > 0.8 * G) & (norm < 1.2 * G))
    if middle < 0.5 * G and as_gravity < 0.1:
        return [f"accelerometer reads {middle:.2f} m/s2 in the median: gravity removed from it? It has to read it"]
    if middle > 30.0 or (middle < 0.7 * G and high < 1.3 * low):
        return [f"accelerometer reads {middle:.4g} m/s2 in the median: unit? ([imu] accel_unit)"]
    if s.still.sum() >= 5:
        return []  # `_at_rest` looks closer
    up = s.accel_b[:, 2] / np.maximum(norm, 1e-9)
    if np.mean(up > 0.5) > 0.9:
        sign, other = ("-g", "FRD") if body == "FLU" else ("+g", "FLU")
        return [f"accelerometer reads {sign} on z almost always: frame is {other}, or its sign? ([frames] body)"]
    return []


def _at_rest(s: Survey, body: str) -> list[str]:
    still = s.still
    if still.sum() < 5:
        return []
    force = np.median(s.accel_b[still], axis=0)
    norm = float(np.linalg.norm(force))
    other = {"FLU": "FRD", "FRD": "FLU"}[body]
    if not 0.9 * G < norm < 1.1 * G:
        return [f"accelerometer reads {norm:.2f} m/s2 at rest: unit or gravity removed?"]
    if force[2] > 0.7 * norm:
        sign = "-g" if body == "FLU" else "+g"
        return [f"accelerometer reads {sign} on z at rest: frame is {other}? ([frames] body)"]
    if abs(force[2]) < 0.7 * norm:
        return ["accelerometer's z is not vertical at rest: mounting? ([mounting])"]
    return []


# ----------------------------------------------------------------------------------------------- gyro


def _bias(s: Survey) -> list[str]:
    """Find a gyro bias that no data sheet has, while it stands."""
    still = s.still
    if still.sum() < 10:
        return []
    bias = np.median(s.gyro_b[still], axis=0)
    if float(np.linalg.norm(bias)) < math.radians(3.0):
        return []
    text = " ".join(f"{x:.1f}" for x in np.degrees(bias))
    return [f"gyro reads ({text}) deg/s at rest: a bias that estimators take for turning; --calibrate gyro removes it"]


def _gyro_unit(s: Survey) -> list[str]:
    """Detect degrees for radians, by the range of any gyro and by the turning of field and gravity."""
    rate = np.linalg.norm(s.gyro_b, axis=1)
    if len(rate) and np.quantile(rate, 0.99) > GYRO_RANGE:
        return [f"gyro reads up to {rate.max():.0f} rad/s: unit is deg/s? ([imu] gyro_unit)"]
    calm = np.abs(np.linalg.norm(s.accel_b, axis=1) - G) < _CALM
    for seen, of, offset in ((s.mag, "field", True), (np.where(calm[:, None], s.accel_b, np.nan), "gravity", False)):
        slope, share = _turning(s, seen, offset)
        if share > 0.7 and 0.5 < slope * 180.0 / math.pi < 2.0:
            return [f"gyro reads {1 / slope:.0f} times the turning of the {of}: unit is deg/s? ([imu] gyro_unit)"]
    return []


def _turning(s: Survey, seen: np.ndarray, offset: bool) -> tuple[float, float]:
    """Fit the share of the gyro's rate with which a vector (n, 3) fixed in the world turns, and what it explains."""
    dt = np.diff(s.t)
    change, middle = np.diff(seen, axis=0), 0.5 * (seen[1:] + seen[:-1])
    turn = 0.5 * (s.gyro_b[1:] + s.gyro_b[:-1]) * dt[:, None]
    good = np.isfinite(change).all(axis=1) & (dt < 2.5 * BIN_S)
    change, middle, turn = change[good], middle[good], turn[good]
    if len(change) < 50:
        return math.nan, 0.0
    columns = [-np.cross(turn, middle).ravel()]
    if offset:
        columns += [np.cross(turn, e).ravel() for e in np.eye(3)]
    A = np.column_stack(columns)
    x = np.linalg.lstsq(A, change.ravel(), rcond=1e-9)[0]
    left, total = change.ravel() - A @ x, float(np.sum(change**2))
    return float(x[0]), 1.0 - float(left @ left) / total if total > 0 else 0.0


def signed_axes() -> Iterator[tuple[str, np.ndarray]]:
    """List all 48 signed permutations of three axes: name and matrix (3, 3); 24 of them are rotations."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            for row, (column, sign) in enumerate(zip(order, signs, strict=True)):
                matrix[row, column] = sign
            yield " ".join(("" if x > 0 else "-") + "xyz"[k] for k, x in zip(order, signs, strict=True)), matrix


# ----------------------------------------------------------------------------------------------- velocity


def _velocity(s: Survey) -> list[str]:
    """Unit and axes of the GNSS velocity (n, 3) NED, by the way between its own fixes."""
    way, run = _legs(s)
    if len(way) < _FEWEST_LEGS or np.sum(np.linalg.norm(way, axis=1)) < 20.0 * _LEG_S:
        return []

    def misfit(velocity: np.ndarray) -> float:
        return float(np.sum((way - velocity) ** 2) / np.sum(way**2))

    now = misfit(run)
    if now < 0.3 or not np.any(run):
        return []
    exchanged = run[:, ::-1]
    if misfit(exchanged) < min(0.1, 0.2 * now):
        return [
            "GNSS velocity has north and east exchanged, by the way between the fixes: NED for ENU? ([frames] world)"
        ]
    for name, size in (("km/h", 3.6), ("kt", 3600 / 1852), ("cm/s", 100.0), ("ft/s", 1 / 0.3048)):
        if misfit(run / size) < min(0.02, 0.1 * now):
            return [f"GNSS velocity is {size:.3g} times the way between the fixes: its unit is {name}, not m/s"]
    speeds = [np.linalg.norm(v, axis=1) for v in (way, run)]
    if np.sum((speeds[0] - speeds[1]) ** 2) < 0.05 * np.sum(speeds[0] ** 2):
        return ["GNSS velocity has the speed of the way between the fixes, not its direction: in the vehicle's axes?"]
    return []


def _legs(s: Survey) -> tuple[np.ndarray, np.ndarray]:
    """North and east (n, 2) m from fix to fix a few seconds apart, and the same by the velocity."""
    nothing = np.empty((0, 2))
    if len(s.t_fix) < 2 or len(s.t_velocity) < 2:
        return nothing, nothing
    at = np.arange(max(s.t_fix[0], s.t_velocity[0]), min(s.t_fix[-1], s.t_velocity[-1]), _LEG_S)
    if len(at) < 2:
        return nothing, nothing
    meridian, prime = (float(r) for r in wgs84.radii(s.fixes[0, 0]))
    metres = np.array([meridian, prime * math.cos(s.fixes[0, 0])])
    north_east = (s.fixes[:, :2] - s.fixes[0, :2]) * metres
    gone = np.cumsum(
        np.r_[np.zeros((1, 2)), 0.5 * np.diff(s.t_velocity)[:, None] * (s.vel_n[1:, :2] + s.vel_n[:-1, :2])], axis=0
    )
    way, run = (
        np.diff(np.column_stack([np.interp(at, t, column) for column in values.T]), axis=0)
        for t, values in ((s.t_fix, north_east), (s.t_velocity, gone))
    )
    near = np.linalg.norm(way, axis=1) < _FASTEST * _LEG_S  # single fixes may be anywhere
    return way[near], run[near]


# ----------------------------------------------------------------------------------------------- field


def _field_unit(s: Survey, field_n: np.ndarray | None) -> list[str]:
    norm = float(np.nanmedian(np.linalg.norm(s.mag, axis=1))) if np.isfinite(s.mag).any() else math.nan
    field = float(np.linalg.norm(field_n)) if field_n is not None else 5e-5
    if not math.isfinite(norm) or norm <= 0.0 or (field_n is None and 1e-5 < norm < 2e-4):
        return []
    if 1 / 3 < norm / field < 3:
        return []
    units = (("G", 1e-4), ("mG", 1e-7), ("uT", 1e-6), ("nT", 1e-9))
    unit = next((u for u, f in units if 0.3 < norm * f / field < 3), "")
    place = "the field of the place" if field_n is not None else "the Earth's field"
    says = f"unit is {unit}? ([magnetometer] unit)" if unit else (
        f"counts? soft_iron = [k, 0, 0, 0, k, 0, 0, 0, k] with k = {field / norm:.3g} scales them ([magnetometer])"
    )  # fmt: skip
    return [f"magnetometer reads {norm:.3g} T, {place} is {field:.3g} T: {says}"]


@dataclass(frozen=True)
class Orientation:
    """Find the magnetometer's orientation relative to the gyro among the signed permutations of axes."""

    name: str
    matrix: np.ndarray  # (3, 3) takes its readings to those that fit
    mirrored: bool  # fits with the rates of the gyro reversed: `matrix` is a rotation then
    misfit: float  # share of the turning that is left
    before: float  # the same of the readings as they are
    unique: bool  # no other comes near


def orientation(s: Survey, mag_b: np.ndarray, dip: float | None) -> Orientation | None:
    """Find the signed permutation of axes with which the field turns with the gyro and has the dip of the place.

    A vector and its opposite turn alike, so without a dip only the 24 rotations are tried.

    Args:
        s: the survey.
        mag_b: (n, 3) T.
        dip: rad, of the field below the horizon; None: not known.
    """
    s = replace(s, mag=mag_b)
    pairs = turns(s, np.eye(3), _TURN_BINS)
    against = turns(inertial.scaled(s, -np.eye(3), np.eye(3)), np.eye(3), _TURN_BINS)
    if len(pairs.C) < 100 or not _about_all_axes(pairs):
        return None
    results = []
    for name, matrix in signed_axes():
        rotates = np.linalg.det(matrix) > 0
        if rotates or dip is not None:
            off = _dip_misfit(s, mag_b @ matrix.T, dip)
            results.append((_turn_misfit(pairs, matrix) + off, name, matrix, False))
        if rotates:
            results.append((_turn_misfit(against, matrix) + _dip_misfit(s, mag_b, dip), name, matrix, True))
    results.sort(key=lambda r: r[0])
    now = next(left for left, name, _, mirrored in results if name == "x y z" and not mirrored)
    (best, name, matrix, mirrored), (second, *_) = results[:2]
    return Orientation(name, matrix, mirrored, best, now, second > max(3.0 * best, best + 0.05))


def _dip_misfit(s: Survey, mag_b: np.ndarray, dip: float | None) -> float:
    """Grade a dip that is off by more than 15 deg, from 0 to 2; 0 where nothing is known."""
    angle = _dip_of(s, mag_b) if dip is not None else None
    if angle is None or dip is None or abs(angle - dip) < math.radians(15.0):
        return 0.0
    return 1.0 - math.cos(angle - dip)


def _about_all_axes(pairs: Turns) -> bool:
    """Test whether the turns are about more than one axis."""
    axis = np.stack(
        [pairs.C[:, 2, 1] - pairs.C[:, 1, 2], pairs.C[:, 0, 2] - pairs.C[:, 2, 0], pairs.C[:, 1, 0] - pairs.C[:, 0, 1]],
        axis=1,
    )
    spread = np.linalg.eigvalsh(axis.T @ axis)
    return bool(spread[1] > 0.03 * spread[2])


def _turn_misfit(pairs: Turns, matrix: np.ndarray) -> float:
    """Share of the change of the field, turned by a matrix (3, 3), that the gyro does not explain, hard iron apart."""
    turned = np.einsum("ji,njk,kl->nil", matrix, pairs.C, matrix)  # as the magnetometer's axes see it
    A = (turned - np.eye(3)).reshape(-1, 3)
    b = (np.einsum("nij,nj->ni", turned, pairs.before) - pairs.after).ravel()
    left = b - A @ np.linalg.lstsq(A, b, rcond=1e-6)[0]
    size = np.linalg.norm(left.reshape(-1, 3), axis=1)
    moved = np.linalg.norm(pairs.after - pairs.before, axis=1)
    return float(np.median(size) / max(np.median(moved), 1e-12))


def _dip_of(s: Survey, mag_b: np.ndarray) -> float | None:
    """Measure the dip (rad) of the field where the accelerometer shows the vertical; None: nowhere."""
    norm = np.linalg.norm(s.accel_b, axis=1)
    calm = s.still if s.still.sum() > 50 else np.abs(norm - G) < _CALM
    calm = calm & np.isfinite(mag_b).all(axis=1)
    if calm.sum() < 50:
        return None
    down = -s.accel_b[calm] / norm[calm, None]
    sine = np.sum(mag_b[calm] * down, axis=1) / np.linalg.norm(mag_b[calm], axis=1)
    return float(np.arcsin(np.clip(np.median(sine), -1.0, 1.0)))


def _orientation(s: Survey, assumed: Assumed, track: Track | None) -> list[str]:
    """Detect a magnetometer that is mounted in other axes than the gyro."""
    if not np.isfinite(assumed.mag_b).any():
        return []
    dip = magnetic.dip(assumed.field_n) if assumed.field_n is not None else None
    found = orientation(s, assumed.mag_b, dip)
    if found is None or not found.unique or (found.name == "x y z" and not found.mirrored):
        return []
    if found.misfit > 0.35 or found.before < 3.0 * found.misfit or found.before < 0.4:
        return []
    handed = "" if np.linalg.det(found.matrix) > 0 else ", a left-handed frame,"
    sign = -1.0 if found.mirrored else float(np.linalg.det(found.matrix))
    gyro = sign * found.matrix.T  # the same turning, if it is the gyro that is wrong
    if found.mirrored or _fits_better(s, gyro, track):
        name = next(name for name, matrix in signed_axes() if (matrix == gyro).all())
        handed = ", a left-handed frame," if found.mirrored else ""
        return [f"the field turns as the gyro says with gyro axes read as ({name}){handed} not as they are: mounting?"]
    return [
        f"the field turns as the gyro says with magnetometer axes read as ({found.name}){handed} not as they are: "
        f"{mounting_lines(found.matrix, assumed.mag_axes)}"
    ]


def _fits_better(s: Survey, gyro: np.ndarray, track: Track | None) -> bool:
    """Test whether accelerometer and GNSS, or gravity alone, agree better with a gyro turned by a matrix (3, 3)."""
    other = inertial.scaled(s, gyro, np.eye(3))
    if track is not None:
        made = inertial.windows(other)
        fit = inertial.track(other, track.gravity, made=made, delay=track.delay)
        return fit is not None and fit.misfit < 0.5 * track.misfit
    calm = np.abs(np.linalg.norm(s.accel_b, axis=1) - G) < _CALM
    seen = np.where(calm[:, None], s.accel_b, np.nan)
    return _turning(other, seen, offset=False)[1] > max(0.7, 2.0 * _turning(s, seen, offset=False)[1])


def mounting_lines(matrix: np.ndarray, mag_axes: np.ndarray) -> str:
    """Make the lines of a map for a magnetometer whose readings in FRD a matrix (3, 3) corrects."""
    if np.linalg.det(matrix) > 0:
        angles = np.degrees(attitude.euler_of(matrix))
        return "[magnetometer] " + ", ".join(
            f"{a}_deg = {round(x):d}" for a, x in zip(("roll", "pitch", "yaw"), angles, strict=True) if abs(x) > 0.5
        )
    own = mag_axes.T @ matrix @ mag_axes
    return f"[magnetometer] soft_iron = [{', '.join(f'{x:g}' for x in (own + 0.0).ravel())}]"


def _dip(s: Survey, assumed: Assumed) -> list[str]:
    """Detect an angle between field and gravity that the place does not have."""
    if assumed.field_n is None:
        return []
    dip = magnetic.dip(assumed.field_n)
    angle = _dip_of(s, assumed.mag_b)
    if angle is None or abs(angle - dip) < _DIP:
        return []
    text = f"field is {math.degrees(angle):.0f} deg below the horizon, at this place it is {math.degrees(dip):.0f}"
    if abs(angle + dip) < 0.5 * _DIP and abs(dip) > _DIP:
        return [f"{text}: sign of the accelerometer or of the magnetometer?"]
    return [f"{text}: hard iron (--calibrate mag), mounting or place?"]


def _course(assumed: Assumed, track: Track) -> list[str]:
    if assumed.field_n is None or not np.isfinite(assumed.mag_b).any():
        return []
    found = inertial.course_of(assumed.mag_b, track, math.atan2(assumed.field_n[1], assumed.field_n[0]))
    if found is None:
        return []
    off, sigma, spread = (abs(math.degrees(x)) for x in (found.offset, found.sigma, found.spread))
    if spread > math.degrees(_COURSE):
        return [
            f"magnetic north scatters by {spread:.0f} deg about where GNSS and IMU have it, from heading to heading: "
            "hard iron? (--calibrate mag)"
        ]
    if abs(found.offset) < _COURSE + 3.0 * found.sigma:
        return []
    side = "right" if found.offset > 0 else "left"
    return [
        f"magnetic north is {off:.0f} +- {sigma:.0f} deg to the {side} of where GNSS and IMU have it: "
        "mounting or declination? ([magnetometer] yaw_deg, [place] declination_deg)"
    ]


# ----------------------------------------------------------------------------------------------- reference


def _unaligned(s: Survey, t: np.ndarray, q_nb: np.ndarray) -> list[str]:
    """Find a reference whose heading turns against the gyro at first and never again: it was not aligned before."""
    dt = np.diff(s.t)[:, None]
    q = interpolate(t, q_nb, s.t)
    turned_b = attitude.rotation_vector(q[:-1], q[1:]) - 0.5 * (s.gyro_b[1:] + s.gyro_b[:-1]) * dt
    known = np.isfinite(turned_b).all(axis=1) & (dt[:, 0] < 2.5 * BIN_S)
    if known.sum() < _SETTLED_S / BIN_S:
        return []
    turned_b -= np.median(turned_b[known] / dt[known], axis=0) * dt  # the gyro's bias
    off = np.cumsum(np.where(known[:, None], attitude.to_nav(q[:-1], turned_b), 0.0), axis=0)
    rows = round(_SETTLING_S / BIN_S)
    change = np.abs(off[rows:] - off[:-rows])
    large = np.flatnonzero(change[:, 2] > _SETTLING)
    if not len(large) or 2.0 * change[change[:, 2].argmax(), :2].max() > change[:, 2].max():
        return []  # nothing, or not about down alone
    settled = int(large[-1]) + rows
    end, after = float(s.t[settled + 1]), change[large[-1] + rows :]
    if s.t[-1] - end < _SETTLED_S or (after[:, 2] > 0.5 * _SETTLING).any():
        return []
    size = math.degrees(np.ptp(off[: settled + 1, 2]))
    return [
        f"heading of the reference turns by {size:.0f} deg against the gyro up to {end:.0f} s and not after: it was "
        f"not aligned before; --from {math.ceil(end)} leaves that out of the errors"
    ]


def _against_reference(s: Survey, axes: tuple[str, str], delay: float, units: bool) -> list[str]:
    t, q = s.t_reference - delay, s.q_nb
    if len(t) < 20 or len(s.t) < 20:
        return []
    found = []
    force_n = attitude.to_nav(interpolate(t, q, s.t), s.accel_b)
    up = np.nanmean(force_n, axis=0) if np.isfinite(force_n).any() else np.zeros(3)
    if np.linalg.norm(up) > 0.5 * G and up[2] > 0:
        found.append(f"gravity points up by the reference attitude: its axes are not {axes[0]}, {axes[1]}? ([frames])")
    reference_rate = rates(t, q, s.t, BIN_S)
    good = np.isfinite(reference_rate).all(axis=1)
    moving = good & (np.linalg.norm(np.nan_to_num(reference_rate), axis=1) > math.radians(5.0))
    if moving.sum() < 20:
        return found
    mine, theirs = s.gyro_b[moving], reference_rate[moving]
    slope = np.sum(mine * theirs, axis=0) / np.maximum(np.sum(theirs**2, axis=0), 1e-12)
    strong = np.sqrt(np.mean(theirs**2, axis=0)) > 0.2 * np.sqrt(np.mean(theirs**2))
    if 20 < np.median(np.abs(slope[strong])) < 100:
        line = "gyro reads 57 times the rate of the reference attitude: unit is deg/s? ([imu] gyro_unit)"
        return found if units else [*found, line]
    wrong = [a for a, k, use in zip("xyz", slope, strong, strict=True) if use and k < -0.3]
    if wrong:
        found.append(f"gyro {' and '.join(wrong)} turn against the reference attitude: frame or mounting? ([frames])")
    elif (slope[strong] < 0.5).any():
        found.append("gyro does not follow the reference attitude: mounting, or another body? ([mounting])")
    return found or _unaligned(s, t, q)
