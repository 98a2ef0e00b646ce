"""How soon an attitude is there and how good it is, however a recording begins: twelve starts, twenty seeds each.

    python benchmarks/starts.py [--seeds N] [--save FILE] [--before FILE]

Each start goes over into the same minute of flight with turns, climbs and changes of speed, true in closed form, and is
measured by a consumer-grade unit: biases, noise and hard iron are those of its data sheet. `--save` keeps
the figures, `--before` puts those of another version beside them. The output is the table of docs/replay.md.
"""

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import estimators
from estimators.types import Samples, SensorInfo, Site

G = 9.80665
RATE, GNSS, FLIGHT_S = 100, 5, 60.0
SITE = Site((math.radians(43.57), math.radians(1.47), 150.0), G, (2.4e-5, 0.05e-5, 3.9e-5))
SENSORS = SensorInfo()
METHODS = ("marg-ckf", "ins21")


@dataclass
class Way:
    """Truth at times (n,): heading (rad), speed and climb (m/s), and what shakes the attitude beside."""

    t: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    climb: np.ndarray
    shake: np.ndarray  # (n, 3) rad, roll, pitch and yaw
    gnss_error: np.ndarray  # (n, 3) m/s


def smooth(t: np.ndarray, at: float, over: float) -> np.ndarray:
    """A step from 0 to 1 without a jump of the acceleration."""
    x = np.clip((t - at) / over, 0.0, 1.0)
    step: np.ndarray = x * x * x * (10 - 15 * x + 6 * x * x)
    return step


def tremor(t: np.ndarray, rng: np.random.Generator, size: float) -> np.ndarray:
    """Angles (n, 3) rad of a hand: some of them slow and wide, some fast and small."""
    total = np.zeros((len(t), 3))
    for hertz, part in ((0.2, 1.0), (0.7, 0.6), (2.0, 0.2), (8.0, 0.03)):
        total += part * np.sin(2 * np.pi * hertz * t[:, None] * rng.uniform(0.8, 1.2, 3) + rng.uniform(0, 6.28, 3))
    return size * total


def start(kind: str, rng: np.random.Generator) -> Way:
    """A start, and the flight after it."""
    name, _, number = kind.partition(" ")
    ground = {"standing": float(number or 0), "hand-held": 15.0, "taxiing": 20.0, "hand": 4.0, "catapult": 3.0,
              "turn": 0.0, "wandering": 30.0}[name]  # fmt: skip
    t = np.arange(round((ground + FLIGHT_S) * RATE)) / RATE
    after = t - ground
    heading = np.full_like(t, rng.uniform(0, 6.28))
    for at, over, turn in ((6.0, 8.0, 1.5), (20.0, 10.0, -2.5), (38.0, 6.0, 1.0), (48.0, 8.0, -1.5)):
        heading += rng.choice([-1, 1]) * turn * smooth(after, at, over)
    speed = 20.0 * smooth(after, 0.0, 8.0) + 4.0 * smooth(after, 30.0, 5.0)
    climb = 2.0 * smooth(after, 4.0, 4.0) - 2.5 * smooth(after, 34.0, 6.0)
    shake, error = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    held = (1.0 - smooth(t, ground - 0.5, 1.0))[:, None]
    if kind == "standing 0":  # already flying, straight on
        speed = speed - 20.0 * smooth(after, 0.0, 8.0) + 20.0
    elif name == "hand-held":
        shake = held * tremor(t, rng, math.radians(6.0))
    elif name == "taxiing":
        speed = np.maximum(speed, 6.0 * smooth(t, -2.0, 2.0) * (1.0 - smooth(after, 0.0, 4.0)) + speed)
        heading = heading + 1.2 * smooth(t, 3.0, 6.0) - 0.8 * smooth(t, 11.0, 6.0)
        shake = held * tremor(t, rng, math.radians(0.6)) + 0.004 * held * rng.standard_normal((len(t), 3))
    elif name == "hand":
        speed = 9.0 * smooth(after, -0.7, 0.7) + 11.0 * smooth(after, 0.0, 8.0) + 4.0 * smooth(after, 30.0, 5.0)
        shake = held * tremor(t, rng, math.radians(4.0))
    elif name == "catapult":
        speed = 18.0 * smooth(after, 0.0, 0.8) + 2.0 * smooth(after, 2.0, 8.0) + 4.0 * smooth(after, 30.0, 5.0)
    elif name == "turn":
        speed = np.full_like(t, 20.0)
        heading = heading + 0.3 * np.minimum(t, 15.0)
    elif name == "wandering":
        error = 3.0 * np.exp(-t / 15.0)[:, None] * _unit(rng)
    return Way(t, heading, speed, climb, shake, error)


def _unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.standard_normal(3)
    direction: np.ndarray = v / np.linalg.norm(v)
    return direction


def matrices(roll: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """C_nb (n, 3, 3) of Euler angles (n,) rad."""
    (sr, sp, sy), (cr, cp, cy) = ([f(x) for x in (roll, pitch, yaw)] for f in (np.sin, np.cos))
    rows = [[cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp]]  # fmt: skip
    return np.moveaxis(np.array(rows), 2, 0)


def truth(way: Way) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """C_nb (n, 3, 3), velocity (n, 3) m/s NED, rate (n, 3) rad/s and specific force (n, 3) m/s2 in body axes."""
    dt = 1.0 / RATE
    level = np.sqrt(np.maximum(way.speed**2 - way.climb**2, 0.0))
    velocity = np.column_stack([level * np.cos(way.heading), level * np.sin(way.heading), -way.climb])
    bank = np.where(way.speed > 12.0, np.arctan(way.speed * np.gradient(way.heading, dt) / G), 0.0)
    pitch = np.where(way.speed > 1.0, np.arcsin(np.clip(way.climb / np.maximum(way.speed, 1.0), -0.4, 0.4)), 0.0)
    window = np.hanning(51) / np.hanning(51).sum()
    bank, pitch = (np.convolve(np.pad(x, 25, mode="edge"), window, "valid") for x in (bank, pitch))
    C = matrices(bank + way.shake[:, 0], pitch + 0.05 + way.shake[:, 1], way.heading + way.shake[:, 2])
    force_n = np.gradient(velocity, dt, axis=0) - [0.0, 0.0, G]
    turn = np.einsum("nji,njk->nik", C[:-2], C[2:])  # from the row before to the row after
    middle = np.column_stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]]
    )
    rate = np.pad(middle / (4.0 * dt), ((1, 1), (0, 0)), mode="edge")
    return C, velocity, rate, np.einsum("nji,nj->ni", C, force_n)


def measured(way: Way, seed: int) -> tuple[Samples, np.ndarray]:
    """What the sensors read, and C_nb (n, 3, 3)."""
    rng = np.random.default_rng([seed, 7])
    C, velocity, rate, force = truth(way)
    n, s = len(way.t), SENSORS
    white = math.sqrt(RATE / 2)
    moving = np.clip(way.speed / 10.0, 0.0, 1.0)[:, None]  # the air and the motor shake it
    gyro = (
        rate
        + s.gyro_bias * rng.standard_normal(3)
        + (s.gyro_noise * white + 5e-3 * moving) * rng.standard_normal((n, 3))
    )
    accel = (
        force
        + s.accel_bias * rng.standard_normal(3)
        + (s.accel_noise * white + 0.3 * moving) * rng.standard_normal((n, 3))
    )
    field = np.einsum("nji,j->ni", C, np.array(SITE.mag_n))
    field = field + s.mag_bias * rng.standard_normal(3) + s.mag_noise * rng.standard_normal((n, 3))
    fresh = np.arange(n) % (RATE // GNSS) == 7
    last = np.maximum.accumulate(np.where(fresh, np.arange(n), -1))
    known = last >= 0
    noisy = velocity + way.gnss_error + s.gnss_vel * rng.standard_normal((n, 3))
    place = np.cumsum(velocity, axis=0) / RATE + np.cumsum(way.gnss_error, axis=0) / RATE
    place = place + s.gnss_pos * rng.standard_normal(3) + 0.2 * s.gnss_pos * rng.standard_normal((n, 3))
    north, east = place[:, 0] / 6.37e6, place[:, 1] / 6.37e6 / math.cos(SITE.lla[0])
    lla = np.column_stack([SITE.lla[0] + north, SITE.lla[1] + east, SITE.lla[2] - place[:, 2]])
    latched = {name: np.where(known[:, None], column[np.maximum(last, 0)], np.nan)
               for name, column in (("vel_n", noisy), ("lla", lla))}  # fmt: skip
    samples = Samples.make(
        way.t, gyro, accel, mag_b=field, mag_new=np.arange(n) % 2 == 0, **latched,
        gnss_t=np.where(known, way.t[np.maximum(last, 0)], np.nan), gnss_new=fresh,
    )  # fmt: skip
    return samples, C


@dataclass
class Result:
    """Of one method from one start: by seed."""

    first_s: list[float]  # of the first attitude; inf: none
    then: list[float]  # deg, total error three seconds later
    rms: list[float]  # deg, from the first attitude to the end
    last: list[float]  # deg, RMS of the last twenty seconds


def error_deg(q: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Angle (n,) between attitudes (n, 4) and C_nb (n, 3, 3)."""
    w, x, y, z = q.T
    rows = [[w*w + x*x - y*y - z*z, 2 * (x*y - w*z), 2 * (x*z + w*y)],
            [2 * (x*y + w*z), w*w - x*x + y*y - z*z, 2 * (y*z - w*x)],
            [2 * (x*z - w*y), 2 * (y*z + w*x), w*w - x*x - y*y + z*z]]  # fmt: skip
    cosine = (np.einsum("nij,ijn->n", C, np.array(rows)) - 1.0) / 2.0
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def run(method: str, kind: str, seeds: int) -> Result:
    """Start so many times."""
    out = Result([], [], [], [])
    for seed in range(seeds):
        samples, C = measured(start(kind, np.random.default_rng([seed, *kind.encode()])), seed)
        settings = {"aiding": "gnss"} if method.startswith("marg") else {}
        estimates = estimators.create(method, site=SITE, sensors=SENSORS, **settings).process(samples)
        error = error_deg(estimates.q_nb, C)
        known = np.flatnonzero(np.isfinite(error))
        if not len(known):
            out.first_s.append(math.inf)
            continue
        first = int(known[0])
        out.first_s.append(float(samples.t[first]))
        out.then.append(float(error[min(first + 3 * RATE, len(error) - 1)]))
        out.rms.append(float(np.sqrt(np.nanmean(error[first:] ** 2))))
        out.last.append(float(np.sqrt(np.nanmean(error[-20 * RATE :] ** 2))))
    return out


STARTS = {
    "standing 0": "in the air, straight on",
    "standing 1": "stands 1 s, then takes off",
    "standing 3": "stands 3 s",
    "standing 10": "stands 10 s",
    "standing 20": "stands 20 s",
    "hand-held": "turned in the hand for 15 s",
    "taxiing": "taxies for 20 s",
    "hand": "held for 4 s, thrown",
    "catapult": "stands 3 s, catapult",
    "turn": "in the air, in a turn",
    "wandering": "stands 30 s, GNSS 3 m/s off at first",
}


def figures(result: Result) -> dict[str, float]:
    """Medians over the seeds and the latest first attitude."""

    def middle(values: list[float]) -> float:
        return float(np.median(values)) if values else math.inf

    return {"first": middle(result.first_s), "latest": max(result.first_s), "then": middle(result.then),
            "rms": middle(result.rms), "last": middle(result.last)}  # fmt: skip


def table(now: dict[str, dict[str, float]], before: dict[str, dict[str, float]]) -> str:
    """Markdown: a row for each start and method; `before` may be empty."""

    def cell(key: str, what: str, shape: Callable[[float], str]) -> str:
        value = now[key][what]
        text = shape(value) if math.isfinite(value) else "none"
        if key not in before:
            return text
        old = before[key][what]
        return f"{text} ({shape(old) if math.isfinite(old) else 'none'})"

    head = (
        "start",
        "method",
        "first attitude, s",
        "at the latest",
        "error 3 s later, deg",
        "RMS from then on",
        "last 20 s",
    )
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for kind, text in STARTS.items():
        for method in METHODS:
            key = f"{kind} {method}"
            cells = [cell(key, "first", lambda x: f"{x:.1f}"), cell(key, "latest", lambda x: f"{x:.1f}"),
                     *(cell(key, what, lambda x: f"{x:.2f}") for what in ("then", "rms", "last"))]  # fmt: skip
            name = f"`{method}`, GNSS" if method.startswith("marg") else f"`{method}`"
            lines.append(f"| {text if method == METHODS[0] else ''} | {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Run all starts and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--save", type=Path, help="keep the figures as JSON")
    parser.add_argument("--before", type=Path, help="figures of another version, put in brackets")
    arguments = parser.parse_args()
    now = {f"{kind} {method}": figures(run(method, kind, arguments.seeds)) for method in METHODS for kind in STARTS}
    if arguments.save:
        arguments.save.write_text(json.dumps(now, indent=1))
    print(table(now, json.loads(arguments.before.read_text()) if arguments.before else {}))


if __name__ == "__main__":
    main()
