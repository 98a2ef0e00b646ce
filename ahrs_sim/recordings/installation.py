"""How sensors are installed, found from the recording: delays, lever arm, boresight, orientation, scale of airspeed.

Each is reported with its sigma, or as not shown by the recording, and as lines for a map. IMU and GNSS velocity give
the motion (`inertial`); against it

* GNSS positions are integrals of the velocity, later by their delay;
* the field keeps its direction when the gyro's turning is taken out, at the right time;
* airspeed is the length of velocity less wind, the wind being one of a minute and a half;
* the velocity in the air points along the nose in straight flight, apart from incidence, and the wings are level.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.recordings import checks, inertial
from ahrs_sim.recordings.inertial import Groups, Track, Windows
from ahrs_sim.recordings.mapping import Map
from ahrs_sim.recordings.survey import Survey
from ahrs_sim.world.gravity import STANDARD as G

SEEN_DELAY, SEEN_AIR_DELAY = 0.06, 0.12  # s: a greater sigma is no answer
SEEN_LEVER = 0.6  # m
SEEN_ANGLE = math.radians(3.0)
SEEN_SCALE = 0.05
_WIND_S = 90.0
_FLYING = 8.0  # m/s
_STRAIGHT = math.radians(4.0)  # rad/s
_LEVEL = 1.0  # m/s2 off gravity
_LEVEL_ASSUMED = math.radians(0.5)  # how level, and how free of sideslip, straight flight is
_SIGNIFICANT = 3.0


_OFF_DIAGONAL = [np.eye(3)[[a, b]].T @ np.eye(3)[[b, a]] for a, b in ((0, 1), (0, 2), (1, 2))]


@dataclass(frozen=True)
class Estimate:
    """A quantity and its sigma; `seen`: whether the recording shows it."""

    value: np.ndarray
    sigma: np.ndarray
    seen: bool


@dataclass
class Installation:
    """Holds the installation found, as text for the user and as lines of a map."""

    lines: list[str] = field(default_factory=list)
    entries: dict[str, dict[str, str]] = field(default_factory=dict)  # key and value by table of a map
    found: dict[str, Estimate] = field(default_factory=dict)

    def put(self, table: str, key: str, value: str) -> None:
        """Add an entry of a map."""
        self.entries.setdefault(table, {})[key] = value

    def toml(self) -> str:
        """Write the entries as lines of a map."""
        return "\n".join(
            f"[{table}]\n" + "\n".join(f"{key} = {value}" for key, value in entries.items())
            for table, entries in self.entries.items()
        )


def find(s: Survey, mag_b: np.ndarray, mapping: Map, gravity: float, dip: float | None) -> Installation:
    """Find how the sensors of a recording are installed.

    Args:
        s: the survey.
        mag_b: (n, 3) T, the magnetometer in FRD, calibrated.
        mapping: the map that the survey was made with.
        gravity: m/s2.
        dip: rad, of the field at the place; None: not known.
    """
    out = Installation()
    made = inertial.windows(s)
    track = inertial.track(s, gravity, lever=True, made=made) if made else None
    _gnss(out, s, track, mapping)
    _magnetometer(out, s, made, mag_b, mapping, dip)
    _airspeed(out, s, track, mapping)
    _boresight(out, s, track, mapping)
    return out


# ----------------------------------------------------------------------------------------------- one by one


def _gnss(out: Installation, s: Survey, track: Track | None, mapping: Map) -> None:
    if track is None:
        out.lines.append(f"GNSS: {'no velocity' if not len(s.t_velocity) else 'too little motion'}: {_UNSEEN}")
        return
    value = np.array([track.delay])
    found = Estimate(value, np.array([track.delay_sigma]), track.delay_sigma < SEEN_DELAY)
    _delay(out, "velocity", "GNSS velocity", found, mapping)
    if found.seen and (late := position_delay(s, track)) is not None:
        sigma = np.hypot(late.sigma, track.delay_sigma)  # of the time of the velocity that it is held against
        late = replace(late, sigma=sigma, seen=bool(sigma[0] < SEEN_DELAY))
        _delay(out, "fix", "GNSS position", late, mapping)
    seen = bool((track.lever_sigma < SEEN_LEVER).all())
    out.found["lever"] = Estimate(track.lever_b, track.lever_sigma, seen)
    if not seen:
        out.lines.append(
            f"GNSS lever arm: {_UNSEEN} (+- {_numbers(track.lever_sigma)} m): it takes turns of changing rate"
        )
        return
    out.lines.append(
        f"GNSS lever arm: {_numbers(track.lever_b)} +- {_numbers(track.lever_sigma)} m forward, right, down"
    )
    if (np.abs(track.lever_b) > _SIGNIFICANT * track.lever_sigma).any():
        out.put("sensors", "antenna_b", _list(track.lever_b))


def _magnetometer(
    out: Installation, s: Survey, made: Windows | None, mag_b: np.ndarray, mapping: Map, dip: float | None
) -> None:
    if not np.isfinite(mag_b).any():
        out.lines.append(f"magnetometer: none: {_UNSEEN}")
        return
    sits = checks.orientation(s, mag_b, dip)
    fits = sits is not None and sits.unique and not sits.mirrored and sits.misfit < 0.35
    matrix = np.eye(3)
    if sits is None or not fits:
        out.lines.append(f"magnetometer orientation: {_UNSEEN}: it takes turns about two axes")
    elif sits.name == "x y z":
        out.lines.append("magnetometer orientation: as it is read")
    else:
        matrix = sits.matrix
        out.lines.append(f"magnetometer orientation: axes read as ({sits.name})")
        text = checks.mounting_lines(sits.matrix @ mapping.mag_mount, mapping.mag_axes("FRD"))
        for entry in text.removeprefix("[magnetometer] ").split(", ") if "[" not in text[1:] else [text[15:]]:
            key, value = entry.split(" = ", 1)
            out.put("magnetometer", key, value)
    late = mag_delay(s, made, mag_b @ matrix.T) if made else None
    if late is None:
        out.lines.append(f"magnetometer delay: {_UNSEEN}: it takes turning")
    else:
        _delay(out, "mag", "magnetometer", late, mapping)


def _airspeed(out: Installation, s: Survey, track: Track | None, mapping: Map) -> None:
    if not len(s.t_air):
        return
    found = air(s, track) if track else None
    if found is None:
        out.lines.append(f"airspeed: {_UNSEEN}: it takes GNSS velocity in flight")
        return
    late, scale = found
    out.found["air_scale"] = scale
    _delay(out, "air", "airspeed", late, mapping)
    if not scale.seen:
        out.lines.append(f"airspeed scale: {_UNSEEN} (+- {100 * scale.sigma[0]:.0f} %): it takes flight to and fro")
        return
    out.lines.append(f"airspeed scale: true airspeed is {scale.value[0]:.3f} +- {scale.sigma[0]:.3f} of what is read")
    if abs(scale.value[0] - 1.0) > _SIGNIFICANT * scale.sigma[0]:
        out.put("air", "scale", f"{mapping.air_scale * scale.value[0]:.3f}")


def _boresight(out: Installation, s: Survey, track: Track | None, mapping: Map) -> None:
    found = boresight(s, track) if track else None
    if found is None:
        out.lines.append(f"boresight: {_UNSEEN}: it takes straight flight with GNSS, between turns")
        return
    roll, pitch, yaw = found
    out.found |= {"roll": roll, "incidence": pitch, "yaw": yaw}
    parts = []
    for name, estimate in (("roll", roll), ("yaw", yaw)):
        value, sigma = (math.degrees(float(x[0])) for x in (estimate.value, estimate.sigma))
        parts.append(f"{name} {value:.1f} +- {sigma:.1f} deg" if estimate.seen else f"{name} {_UNSEEN}")
    value, sigma = (math.degrees(float(x[0])) for x in (pitch.value, pitch.sigma))
    both = f"{value:.1f} +- {sigma:.1f} deg" if pitch.seen else _UNSEEN
    out.lines.append(
        f"boresight, flying straight without sideslip: {', '.join(parts)}; pitch and incidence together {both}"
    )
    angles = [float(e.value[0]) if e.seen and abs(e.value[0]) > _SIGNIFICANT * e.sigma[0] else 0.0 for e in (roll, yaw)]
    if any(angles):
        turned = attitude.matrix(angles[0], 0.0, angles[1]) @ mapping.mount
        for axis, angle in zip(("roll", "pitch", "yaw"), np.degrees(attitude.euler_of(turned)), strict=True):
            out.put("mounting", f"{axis}_deg", f"{angle:.1f}")


_UNSEEN = "not observable in this recording"


def _delay(out: Installation, kind: str, name: str, found: Estimate, mapping: Map) -> None:
    out.found[kind] = found
    value, sigma = float(found.value[0]), float(found.sigma[0])
    if not found.seen:
        out.lines.append(f"{name}: delay {_UNSEEN} (+- {sigma:.2f} s): it takes changes of speed or of turn rate")
        return
    word = "late" if value >= 0 else "early"
    out.lines.append(f"{name} is {word} by {abs(value):.3f} +- {sigma:.3f} s")
    if abs(value) > _SIGNIFICANT * sigma:
        out.put("time", f"{kind}_s", f"{mapping.shifts[kind] * 1e-9 - value:.3f}")


def _numbers(values: np.ndarray) -> str:
    return "(" + " ".join(f"{x:.2f}" for x in values) + ")"


def _list(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{x:.3g}" for x in values) + "]"


# ----------------------------------------------------------------------------------------------- fits


def position_delay(s: Survey, track: Track) -> Estimate | None:
    """Estimate by how many s positions are later than the velocity of IMU and GNSS."""
    w = track.windows
    vel_n, known = _velocities(track)
    moved = inertial.cumulated(w.t, np.where(known[:, None], vel_n, 0.0), w.number)
    rows, number = w.at(s.t_fix, (-inertial.EARLIEST_DELAY, inertial.LONGEST_DELAY))
    keep = np.isin(number, track.which)
    rows, number = rows[keep], number[keep]
    if len(rows) < 20:
        return None
    t, place = s.t_fix[rows], _local(s.fixes[rows])

    def parts(at: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return w.between(moved, at) - place, -w.between(vel_n, at)[:, :, None]

    return _late(t, number, parts, 0.5)


def _late(t: np.ndarray, number: np.ndarray, parts: object, noise: float) -> Estimate:
    """Estimate a delay from vectors that differ by a constant in each window."""
    x, prior = np.zeros(1), np.ones(1)
    groups = Groups(1)
    for _ in range(6):
        values, slope = parts(t - x[0], x)  # type: ignore[operator]
        groups, sizes = Groups(1), []
        for k in np.unique(number):
            g = np.flatnonzero(number == k)
            if len(g) < 4:
                continue
            left = -(values[g] - values[g].mean(axis=0))
            weight = _weights(left, noise)[:, None]
            own = (weight[:, :, None] * np.eye(3)).reshape(-1, 3)
            groups.add((weight * left).ravel(), (weight[:, :, None] * slope[g]).reshape(-1, 1), own)
            sizes.append(math.sqrt(float(np.mean(left**2))))
        if not sizes:
            return Estimate(x, np.array([math.inf]), False)
        noise = max(1e-3, float(np.median(sizes)))
        x = np.clip(x + groups.step(x, prior), inertial.EARLIEST_DELAY, inertial.LONGEST_DELAY)
    sigma = np.hypot(groups.sigma(x, prior), 3e-3)
    return Estimate(x, sigma, bool(sigma[0] < SEEN_DELAY))


def _weights(left: np.ndarray, noise: float) -> np.ndarray:
    """Square roots of Huber's weights (n,) of residuals (n, k), over their noise."""
    size = np.linalg.norm(left, axis=1) / (math.sqrt(left.shape[1]) * noise)
    weights: np.ndarray = np.sqrt(np.minimum(1.0, 2.0 / np.maximum(size, 1e-9))) / noise
    return weights


def mag_delay(s: Survey, w: Windows, mag_b: np.ndarray) -> Estimate | None:
    """Estimate by how many s the magnetometer is later than the gyro, with hard and soft iron and gyro bias."""
    rows = np.flatnonzero(np.isfinite(mag_b).all(axis=1))
    inside, number = w.at(s.t_mag[rows], (0.3, 0.3))
    rows = rows[inside]
    if len(rows) < 100:
        return None
    t, m = s.t_mag[rows], mag_b[rows]
    scale = float(np.median(np.linalg.norm(m, axis=1)))
    m = m / scale
    basis = np.array([np.diag([1.0, -1.0, 0.0]), np.diag([0.0, 1.0, -1.0]), *_OFF_DIAGONAL])
    prior = np.r_[0.3, [1.0] * 3, [0.1] * 5, [0.05] * 3]  # delay, hard and soft iron, gyro bias
    x, noise, groups = np.zeros(12), 0.02, Groups(12)
    sets = [g for g in (np.flatnonzero(number == k) for k in np.unique(number)) if len(g) >= 20]
    for _ in range(8):
        at = t - x[0]
        C, rate, turned = w.between(w.C_wb, at), w.between(w.rate_b, at), w.between(w.turned_w, at)
        soft = np.eye(3) + np.tensordot(x[4:9], basis, 1)
        raw = m - x[1:4]
        u = raw @ soft.T
        fixed = np.einsum("nij,nj->ni", C, u)
        slope = np.concatenate(
            [
                -np.einsum("nij,nj->ni", C, np.cross(rate, u))[:, :, None],
                -C @ soft,
                np.stack([np.einsum("nij,nj->ni", C, raw @ b.T) for b in basis], axis=2),
                attitude.cross_matrices(fixed) @ turned,
            ],
            axis=2,
        )
        groups, sizes = Groups(12), []
        for g in sets:
            left = -(fixed[g] - fixed[g].mean(axis=0))
            weight = _weights(left, noise)[:, None, None]
            groups.add((weight[:, :, 0] * left).ravel(), (weight * slope[g]).reshape(-1, 12),
                       (weight * np.eye(3)).reshape(-1, 3))  # fmt: skip
            sizes.append(math.sqrt(float(np.mean(left**2))))
        if not sizes:
            return None
        noise = max(1e-4, float(np.median(sizes)))
        x = x + groups.step(x, prior)
        x[0] = min(max(x[0], -0.3), 0.3)
    sigma = float(np.hypot(groups.sigma(x, prior)[0], 3e-3))
    return Estimate(x[:1], np.array([sigma]), sigma < SEEN_DELAY)


def _velocities(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """Compute the velocity (n, 3) m/s at every bin, and where it is known."""
    w = track.windows
    known = np.isin(w.number, track.which)
    vel_n = np.full((len(w.t), 3), np.nan)
    vel_n[known] = track.velocity(np.flatnonzero(known))
    return vel_n, known


def air(s: Survey, track: Track) -> tuple[Estimate, Estimate] | None:
    """Delay (s) and scale of airspeed: the length of velocity less a wind for each `_WIND_S`."""
    w = track.windows
    vel_n, _ = _velocities(track)
    rows, number = w.at(s.t_air, (-inertial.EARLIEST_DELAY, inertial.LONGEST_DELAY))
    keep = np.isin(number, track.which) & (s.airspeed[rows] > _FLYING)
    rows = rows[keep][:: max(1, int(keep.sum()) // 20000)]
    t, speed = s.t_air[rows], s.airspeed[rows]
    spell = np.floor(t / _WIND_S).astype(int)
    sets = [g for g in (np.flatnonzero(spell == k) for k in np.unique(spell)) if len(g) >= 50]
    if not sets:
        return None
    x, prior, noise, groups = np.array([0.0, 1.0]), np.array([1.0, 0.5]), 1.0, Groups(2)
    winds = [np.zeros(2) for _ in sets]
    for _ in range(12):
        at = t - x[0]
        v = w.between(vel_n, at)
        accel = (w.between(vel_n, at + 0.05) - w.between(vel_n, at - 0.05)) / 0.1
        accel = np.where(np.isfinite(accel), accel, 0.0)
        groups, sizes, steps = Groups(2), [], []
        for g, wind in zip(sets, winds, strict=True):
            through = v[g] - [wind[0], wind[1], 0.0]
            length = np.linalg.norm(through, axis=1)
            u = through / length[:, None]
            left = -(length - x[1] * speed[g])
            weight = _weights(left[:, None], noise)
            common = np.column_stack([-np.sum(u * accel[g], axis=1), -speed[g]])
            own = np.concatenate([weight[:, None] * -u[:, :2], np.eye(2) / 15.0])
            right = np.r_[weight * left, -wind / 15.0]
            both = np.concatenate([weight[:, None] * common, np.zeros((2, 2))])
            steps.append((groups.add(right, both, own), right, both))
            sizes.append(math.sqrt(float(np.mean(left**2))))
        step = groups.step(x - [0.0, 1.0], prior)
        x = x + step
        x[0] = min(max(x[0], inertial.EARLIEST_DELAY), inertial.LONGEST_DELAY)
        winds = [
            wind + inverse @ (right - both @ step) for wind, (inverse, right, both) in zip(winds, steps, strict=True)
        ]
        noise = max(0.05, float(np.median(sizes)))
    arm = float(track.lever_sigma.max())
    turning = np.sqrt(np.mean(np.sum(w.between(w.rate_b, t) ** 2, axis=1)))  # the antenna's own speed
    sigma = np.hypot(groups.sigma(x - [0.0, 1.0], prior), [5e-3, 1e-3 + arm * turning / float(np.median(speed))])
    return (
        Estimate(x[:1], sigma[:1], bool(sigma[0] < SEEN_AIR_DELAY)),
        Estimate(x[1:], sigma[1:], bool(sigma[1] < SEEN_SCALE)),
    )


def boresight(s: Survey, track: Track) -> tuple[Estimate, Estimate, Estimate] | None:
    """Roll, pitch with incidence, and yaw (rad) of the IMU's axes against the aircraft's, from straight flight."""
    w = track.windows
    vel_n, known = _velocities(track)
    straight = known & (np.linalg.norm(s.gyro_b - track.gyro_bias, axis=1) < _STRAIGHT)
    straight &= np.abs(np.linalg.norm(s.accel_b, axis=1) - G) < _LEVEL
    straight &= np.where(known, np.linalg.norm(np.nan_to_num(vel_n), axis=1), 0.0) > _FLYING
    sure = track.heading_sigma[np.maximum(w.number, 0)] < inertial.HEADING_KNOWN
    rows = np.flatnonzero(straight & sure)
    if len(rows) < 100:
        return None
    C = track.attitude(rows)
    force = s.accel_b[rows] - track.accel_bias  # without sideslip it has no part to the side of the aircraft
    roll = np.arctan2(-force[:, 1], -force[:, 2])
    spell = np.floor(s.t[rows] / _WIND_S).astype(int)
    speed = np.interp(s.t[rows], s.t_air, s.airspeed) if len(s.t_air) > 10 else np.full(len(rows), math.nan)
    x, noise, groups = np.zeros(2), 1.0, Groups(2)  # sideways and downward part of a unit vector along the velocity
    sets = [g for g in (np.flatnonzero(spell == k) for k in np.unique(spell)) if len(g) >= 30]
    if not sets:
        return None
    has_speed = bool(np.isfinite(speed).all())
    v = vel_n[rows]
    states = [np.r_[np.zeros(3), 1.0 if has_speed else np.median(np.linalg.norm(v, axis=1))] for _ in sets]
    weak = np.diag([1 / 15.0, 1 / 15.0, 1 / 0.3, 1 / 0.1 if has_speed else 1 / 15.0])
    centres = [state.copy() for state in states]
    prior = np.full(2, 0.5)
    for _ in range(6):
        groups, sizes, steps = Groups(2), [], []
        for g, state, centre in zip(sets, states, centres, strict=True):
            size = state[3] * (speed[g] if has_speed else 1.0) * np.ones(len(g))
            nose = C[g] @ np.array([1.0, x[0], x[1]])
            left = v[g] - state[:3] - size[:, None] * nose
            weight = _weights(left, noise)[:, None, None]
            common = size[:, None, None] * C[g][:, :, 1:3]
            length = (size / state[3])[:, None, None] * nose[:, :, None]
            own = np.concatenate([np.broadcast_to(np.eye(3), (len(g), 3, 3)), length], axis=2)
            right = np.r_[(weight[:, :, 0] * left).ravel(), weak @ (centre - state)]
            both = np.concatenate([(weight * common).reshape(-1, 2), np.zeros((4, 2))])
            inverse = groups.add(right, both, np.concatenate([(weight * own).reshape(-1, 4), weak]))
            steps.append((inverse, right, both))
            sizes.append(math.sqrt(float(np.mean(left**2))))
        step = groups.step(x, prior)
        x = x + step
        states = [
            st + inverse @ (right - both @ step) for st, (inverse, right, both) in zip(states, steps, strict=True)
        ]
        noise = max(0.05, float(np.median(sizes)))
    spread = np.array([np.median(roll[g]) for g in sets])
    roll_sigma = np.std(spread, ddof=1) / math.sqrt(len(spread)) if len(spread) > 1 else math.radians(1.0)
    sigma = np.hypot(groups.sigma(x, prior), _LEVEL_ASSUMED)
    roll_sigma = math.hypot(float(roll_sigma), _LEVEL_ASSUMED)

    def estimate(value: float, of: float) -> Estimate:
        return Estimate(np.array([value]), np.array([of]), of < SEEN_ANGLE)

    return estimate(float(np.median(roll)), roll_sigma), estimate(x[1], sigma[1]), estimate(-x[0], sigma[0])


def _local(lla: np.ndarray) -> np.ndarray:
    """Convert positions (n, 3) rad, rad, m to metres north, east, down of the first."""
    from ahrs_sim.world import wgs84

    meridian, prime = wgs84.radii(np.array(lla[0, 0]))
    north = (lla[:, 0] - lla[0, 0]) * float(meridian)
    east = (lla[:, 1] - lla[0, 1]) * float(prime) * math.cos(lla[0, 0])
    return np.column_stack([north, east, lla[0, 2] - lla[:, 2]])
