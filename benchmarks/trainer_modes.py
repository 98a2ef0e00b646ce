"""Fly the trainer and write what it does into the tables of docs/trainer.md.

    python benchmarks/trainer_modes.py             print the tables
    python benchmarks/trainer_modes.py --write     put them into docs/trainer.md

Trim and performance are flown with the autopilot until nothing changes. The modes come from responses without it:
trimmed, the controls are frozen, a doublet is given, and a linear model is fitted to what follows. Beside them stand
the modes which derivatives predict: the trainer's own, and those of the aircraft whose figures it was made from.
"""

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import logm

from ahrs_sim.flight.fdm import Fdm

DT = 1.0 / 400.0
FT, LBF, DEG = 0.3048, 4.4482216, math.pi / 180.0
G, RHO = 9.806, 1.2  # at the height flown, about 300 m
MASS, AREA = 6.0, 0.62  # kg, m2
DOC = Path(__file__).resolve().parent.parent / "docs" / "trainer.md"
SPEEDS = (13.0, 15.0, 17.5, 20.0, 22.5, 25.0, 28.0)  # m/s

CHANNELS = {
    "t": ("simulation/sim-time-sec", 1.0),
    "phi": ("attitude/phi-rad", 1.0),
    "theta": ("attitude/theta-rad", 1.0),
    "p": ("velocities/p-rad_sec", 1.0),
    "q": ("velocities/q-rad_sec", 1.0),
    "r": ("velocities/r-rad_sec", 1.0),
    "tas": ("velocities/vt-fps", FT),
    "cas": ("velocities/vc-kts", 1852.0 / 3600.0),
    "alpha": ("aero/alpha-rad", 1.0),
    "beta": ("aero/beta-rad", 1.0),
    "climb": ("velocities/h-dot-fps", FT),
    "ground_speed": ("velocities/vg-fps", FT),
    "height": ("ap/height-m", 1.0),
    "elevator": ("fcs/elevator-pos-rad", 1.0),
    "aileron": ("fcs/left-aileron-pos-rad", 1.0),
    "rudder": ("fcs/rudder-pos-rad", 1.0),
    "throttle": ("ap/out/throttle-norm", 1.0),
    "rpm": ("propulsion/engine/propeller-rpm", 1.0),
    "thrust": ("propulsion/engine/thrust-lbs", LBF),
    "load": ("forces/fbz-total-lbs", -LBF / (MASS * G)),
    "wow": ("ap/main-wow", 1.0),
}
FROZEN = {"aileron": "ap/roll/demand-norm", "elevator": "ap/pitch/demand-norm", "rudder": "ap/yaw/demand-norm"}


class Rig:
    """The trainer in JSBSim, in calm air."""

    def __init__(self, speed: float | None = 20.0, height: float = 300.0) -> None:
        """In the air at `speed` (m/s) and `height` (m) above the ground, or parked when there is no speed."""
        self.fdm = fdm = Fdm(DT)
        fdm.load_aircraft("trainer", "trainer_modes")
        fdm["ic/h-agl-ft"] = (0.2712 if speed is None else height) / FT
        if speed is None:
            fdm["ic/theta-deg"] = 2.0
        else:
            fdm["ic/vt-fps"] = speed / FT
            fdm["ic/alpha-deg"] = 2.3
        fdm.exec.run_ic()
        fdm["simulation/integrator/rate/rotational"] = 3
        fdm["simulation/integrator/position/rotational"] = 7
        self._get = [(fdm.getter(name), factor) for name, factor in CHANNELS.values()]

    def ap(self, **commands: float) -> None:
        """Set properties `ap/...`, underscores for dashes."""
        for name, value in commands.items():
            self.fdm["ap/" + name.replace("_", "-").replace("rad-sec", "rad_sec")] = value

    def fly(self, seconds: float) -> dict[str, np.ndarray]:
        """Every channel, SI, at every step."""
        rows = []
        for _ in range(round(seconds / DT)):
            self.fdm.exec.run()
            rows.append([get() * factor for get, factor in self._get])
        return dict(zip(CHANNELS, np.array(rows).T, strict=True))

    def hold(self, speed: float, climb: float = 0.0) -> None:
        """Wings level at a speed and climb rate (m/s)."""
        self.ap(motor_on=1, lateral_mode=1, roll_cmd_rad=0, yaw_mode=1)
        self.ap(throttle_mode=1, airspeed_cmd_mps=speed, vertical_mode=3, climb_rate_cmd_mps=climb)

    def freeze(self) -> None:
        """Autopilot off, controls where they are."""
        for name, source in FROZEN.items():
            self.ap(**{f"{name}_cmd_norm": self.fdm[source]})
        self.ap(throttle_cmd_norm=self.fdm["ap/out/throttle-norm"])
        self.ap(lateral_mode=0, vertical_mode=0, yaw_mode=0, throttle_mode=0)

    def doublet(self, name: str, size: float, width: float, after: float) -> dict[str, np.ndarray]:
        """A doublet of a control (-1..1) and the free response to it (s)."""
        parts = []
        for value, seconds in ((size, width), (-size, width), (0.0, after)):
            self.ap(**{f"{name}_add_norm": value})
            parts.append(self.fly(seconds))
        return {name: np.concatenate([part[name] for part in parts]) for name in CHANNELS}


# -- trim and performance


def climb_curve(throttle: float, pitches: range) -> tuple[np.ndarray, np.ndarray]:
    """Steady speed and climb rate (m/s) at fixed throttle over pitch attitudes (deg), by rising speed."""
    points = []
    for pitch in pitches:
        rig = Rig(20.0, 600.0)
        rig.hold(20.0)
        rig.ap(vertical_mode=1, pitch_cmd_rad=pitch * DEG, throttle_mode=0, throttle_cmd_norm=throttle)
        rig.ap(idle_throttle_norm=0)
        end = rig.fly(30.0)
        if end["alpha"][-1] < 13.0 * DEG:
            points.append((end["cas"][-1], end["climb"][-1]))
    speed, climb = np.array(sorted(points)).T
    return speed, climb


def trim_table() -> list[str]:
    glide = climb_curve(0.0, range(-16, 4, 1))
    climb = climb_curve(1.0, range(-4, 65, 4))
    rows = [
        "| speed, m/s | angle of attack, deg | elevator, deg | throttle | propeller, rpm | thrust, N "
        "| glide | sink, motor off, m/s | climb, full throttle, m/s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for speed in SPEEDS:
        rig = Rig(speed + 1.0)
        rig.hold(speed)
        end = {name: values[-1] for name, values in rig.fly(40.0).items()}
        sink = float(np.interp(speed, *glide, left=math.nan, right=math.nan))
        up = float(np.interp(speed, *climb, left=math.nan, right=math.nan))
        rows.append(
            f"| {speed:g} | {end['alpha'] / DEG:.1f} | {end['elevator'] / DEG:.1f} | {end['throttle']:.2f} "
            f"| {end['rpm']:.0f} | {end['thrust']:.1f} | {number(speed / -sink, 1)} | {number(-sink, 2)} "
            f"| {number(up, 1)} |"
        )
    return rows


def number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def stall() -> tuple[float, float]:
    """Calibrated airspeed (m/s) of the stall at load factor 1, and CLmax, from a slow deceleration."""
    rig = Rig(16.0)
    rig.hold(15.0)
    rig.fly(15.0)
    rig.ap(throttle_mode=0, throttle_cmd_norm=0, vertical_mode=1)
    speeds, lifts = [], []
    pitch = rig.fdm["attitude/theta-rad"]
    for _ in range(150):
        pitch += 0.15 * DEG
        rig.ap(pitch_cmd_rad=pitch)
        step = rig.fly(0.1)
        speed = float(step["cas"].mean())
        load = float((step["load"] / np.cos(step["alpha"])).mean())
        if load > 0.7:
            speeds.append(speed / math.sqrt(load))
            lifts.append(load * MASS * G / (0.5 * 1.225 * speed**2 * AREA))
    return min(speeds), max(lifts)


def performance_table() -> list[str]:
    speed, lift = stall()
    climb_speed, climb = climb_curve(1.0, range(12, 57, 3))
    glide_speed, sink = climb_curve(0.0, range(-6, 4, 1))
    rig = Rig(26.0)
    rig.hold(35.0)
    fast = rig.fly(40.0)["cas"][-1]

    rig = Rig(None)
    rig.ap(motor_on=1)
    rig.fly(1.0)
    rig.ap(phase=1, heading_cmd_rad=0)
    run = rig.fly(20.0)
    off = int(np.argmax(run["height"] > 0.1))
    distance = float(np.sum(run["ground_speed"][:off]) * DT)
    rig.hold(15.0, -1.2)
    rig.ap(phase=0)
    rig.fly(15.0)
    rig.ap(phase=2)
    landing = rig.fly(100.0)
    down = int(np.argmax(landing["wow"] > 0))
    stop = int(np.argmax(landing["ground_speed"][down:] < 0.1)) + down
    roll = float(np.sum(landing["ground_speed"][down:stop]) * DT)

    rig = Rig(20.0)
    rig.hold(20.0)
    rig.fly(10.0)
    rig.ap(lateral_mode=0, aileron_cmd_norm=1.0)
    rate = float(rig.fly(1.0)["p"].max()) / DEG
    seconds = run["t"][off] - run["t"][0]
    best, least = int(np.argmax(glide_speed / -sink)), int(np.argmax(sink))
    top = int(np.argmax(climb))
    return [
        "| | |",
        "|---|---|",
        f"| stall (load factor 1, motor idling) | {speed:.1f} m/s, trimmed CLmax {lift:.2f} |",
        f"| best glide | {glide_speed[best] / -sink[best]:.1f} at {glide_speed[best]:.1f} m/s |",
        f"| least sink | {-sink[least]:.2f} m/s at {glide_speed[least]:.1f} m/s |",
        f"| best climb, full throttle | {climb[top]:.1f} m/s at {climb_speed[top]:.1f} m/s |",
        f"| top speed, level | {fast:.1f} m/s |",
        f"| take-off run, calm | {distance:.0f} m in {seconds:.1f} s, airborne at {run['cas'][off]:.1f} m/s |",
        f"| touchdown, calm | {landing['cas'][down]:.1f} m/s, sinking {-landing['climb'][down]:.2f} m/s |",
        f"| landing run, calm | {roll:.0f} m |",
        f"| roll rate, full aileron at 20 m/s | {rate:.0f} deg/s |",
    ]


# -- modes from flight


def fitted(runs: list[dict[str, np.ndarray]], states: tuple[str, ...], controls: tuple[str, ...]) -> np.ndarray:
    """System matrix (n, n), 1/s, of the linear model which fits the responses, each about a rest of its own."""
    before, after = [], []
    for k, run in enumerate(runs):
        x = np.column_stack([run[name] for name in states])
        u = np.column_stack([run[name] for name in controls])
        own = np.zeros((len(x) - 1, len(runs)))
        own[:, k] = 1.0
        before.append(np.hstack([x[:-1], u[:-1], u[1:], own]))
        after.append(x[1:])
    a, b = np.vstack(before), np.vstack(after)
    scale = np.abs(a).max(axis=0)
    solution, *_ = np.linalg.lstsq(a / scale, b, rcond=None)
    return np.real(logm((solution / scale[:, None])[: len(states)].T)) / DT


def flown_modes(speed: float) -> dict[str, complex]:
    def response(name: str, size: float, width: float, after: float) -> dict[str, np.ndarray]:
        rig = Rig(speed)
        rig.hold(speed)
        rig.fly(30.0)
        rig.freeze()
        return rig.doublet(name, size, width, after)

    runs = [response("elevator", size, 0.2, 25.0) for size in (0.06, -0.06)]
    modes = longitudinal(np.linalg.eigvals(fitted(runs, ("tas", "alpha", "q", "theta", "rpm"), ("elevator",))))
    runs = [
        response("aileron", 0.06, 0.25, 8.0),
        response("aileron", -0.06, 0.25, 8.0),
        response("rudder", 0.15, 0.4, 8.0),
    ]
    return modes | lateral(np.linalg.eigvals(fitted(runs, ("beta", "p", "r", "phi"), ("aileron", "rudder"))))


def longitudinal(values: np.ndarray) -> dict[str, complex]:
    pairs = sorted((v for v in values if v.imag > 1e-6), key=abs)
    return {"phugoid": pairs[0], "short period": pairs[-1]}


def lateral(values: np.ndarray) -> dict[str, complex]:
    real = sorted((v for v in values if abs(v.imag) <= 1e-6), key=abs)
    return {"Dutch roll": next(v for v in values if v.imag > 1e-6), "roll": real[-1], "spiral": real[0]}


# -- modes from derivatives


@dataclass(frozen=True)
class Derivatives:
    """Of one aircraft, per radian and per pb/2V, qc/2V, rb/2V; SI."""

    mass: float
    area: float
    span: float
    chord: float
    ixx: float
    iyy: float
    izz: float
    ixz: float
    cl_a: float
    cl_q: float
    cm_a: float
    cm_q: float
    cy_b: float
    cl_b: float
    cl_p: float
    cl_r: float
    cn_b: float
    cn_r: float
    cn_p: float
    cd_0: float
    k: float


# Published figures as they are. Taken from the trainer, as not given: CLq of the Rascal, drag of the UltraStick, Cnp.
FIGURES = {  # trainer, Rascal 110, Giant Big Stik, UltraStick 120
    "mass": (6.0, 6.58, 5.9, 7.41),
    "area": (0.62, 0.982, 0.979, 0.786),
    "span": (2.0, 2.795, 2.045, 1.924),
    "chord": (0.31, 0.351, 0.350, 0.383),
    "ixx": (0.41, 2.64, 0.413, 0.857),
    "iyy": (0.62, 2.10, 0.644, 1.010),
    "izz": (0.95, 2.59, 0.954, 1.700),
    "ixz": (0.03, 0.0, 0.129, 0.190),
    "cl_a": (4.8, 5.0, 5.32, 4.32),
    "cl_q": (3.9, 3.9, 3.9, 8.1),
    "cm_a": (-0.72, -0.5, -1.9, -0.84),
    "cm_q": (-12.0, -12.0, -6.8, -9.4),
    "cy_b": (-0.5, -1.0, -0.83, -0.148),
    "cl_b": (-0.075, -0.1, -0.034, -0.025),
    "cl_p": (-0.42, -0.4, -0.41, -0.44),
    "cl_r": (0.107, 0.15, 0.107, 0.021),
    "cn_b": (0.075, 0.12, 0.071, 0.069),
    "cn_r": (-0.11, -0.15, -0.120, -0.076),
    "cn_p": (-0.04, -0.04, -0.04, -0.04),
    "cd_0": (0.05, 0.028, 0.1, 0.05),
    "k": (0.0617, 0.04, 0.088, 0.0617),
}
TRAINER, RASCAL, BIG_STIK, ULTRA_STICK = (
    Derivatives(**{name: values[k] for name, values in FIGURES.items()}) for k in range(4)
)


def predicted_modes(d: Derivatives, speed: float) -> dict[str, complex]:
    """Level flight, stability axes, constant thrust, each aircraft at its own lift coefficient."""
    pressure = 0.5 * RHO * speed**2
    force = pressure * d.area
    cl = d.mass * G / force
    cd = d.cd_0 + d.k * cl**2
    c2v, b2v = d.chord / (2 * speed), d.span / (2 * speed)
    moment = force * d.chord / d.iyy
    m, v = d.mass, speed
    # u, alpha, q, theta
    a = np.array(
        [
            [-2 * force * cd / (m * v), force * (cl - 2 * d.k * cl * d.cl_a) / m, 0, -G],
            [-2 * force * cl / (m * v**2), -force * (d.cl_a + cd) / (m * v), 1 - force * d.cl_q * c2v / (m * v), 0],
            [0, moment * d.cm_a, moment * d.cm_q * c2v, 0],
            [0, 0, 1, 0],
        ]
    )
    modes = longitudinal(np.linalg.eigvals(a))
    inertia = np.array([[d.ixx, -d.ixz], [-d.ixz, d.izz]])
    torque = np.linalg.solve(
        inertia, force * d.span * np.array([[d.cl_b, d.cl_p * b2v, d.cl_r * b2v], [d.cn_b, d.cn_p * b2v, d.cn_r * b2v]])
    )
    # beta, p, r, phi
    a = np.array(
        [
            [force * d.cy_b / (m * v), 0, -1, G / v],
            [*torque[0], 0],
            [*torque[1], 0],
            [0, 1, 0, 0],
        ]
    )
    return modes | lateral(np.linalg.eigvals(a))


def described(name: str, value: complex) -> str:
    if name in ("roll", "spiral"):
        if name == "roll":
            return f"{-1 / value.real:.3f} s"
        half = math.log(2) / abs(value.real)
        return f"{'halves' if value.real < 0 else 'doubles'} in {half:.0f} s"
    rate = abs(value)
    return f"{rate:.2f} rad/s, {-value.real / rate:.2f}"


def modes_table(speed: float) -> list[str]:
    columns = {
        "flown": flown_modes(speed),
        "its derivatives": predicted_modes(TRAINER, speed),
        "Giant Big Stik": predicted_modes(BIG_STIK, speed),
        "the same, S = b c": predicted_modes(replace(BIG_STIK, area=0.716), speed),
        "UltraStick 120": predicted_modes(ULTRA_STICK, speed),
        "Rascal 110": predicted_modes(RASCAL, speed),
    }
    rows = ["| mode | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for name in ("short period", "phugoid", "Dutch roll", "roll", "spiral"):
        rows.append(f"| {name} | " + " | ".join(described(name, modes[name]) for modes in columns.values()) + " |")
    return rows


def speeds_table() -> list[str]:
    rows = ["| speed, m/s | short period | phugoid | Dutch roll | roll | spiral |", "|---|---|---|---|---|---|"]
    for speed in (15.0, 20.0, 25.0):
        modes = flown_modes(speed)
        cells = [described(name, modes[name]) for name in ("short period", "phugoid", "Dutch roll", "roll", "spiral")]
        rows.append(f"| {speed:g} | " + " | ".join(cells) + " |")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description="Tables of docs/trainer.md, flown anew.")
    parser.add_argument("--write", action="store_true", help="put them into docs/trainer.md")
    write = parser.parse_args().write
    tables = {
        "trim": trim_table(),
        "performance": performance_table(),
        "modes": modes_table(20.0),
        "speeds": speeds_table(),
    }
    text = DOC.read_text(encoding="utf-8") if write else ""
    for name, rows in tables.items():
        print(f"\n{name}\n" + "\n".join(rows))
        if write:
            start, end = f"<!-- {name} -->\n", f"<!-- end {name} -->"
            head, rest = text.split(start, 1)
            text = head + start + "\n".join(rows) + "\n" + end + rest.split(end, 1)[1]
    if write:
        DOC.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
