"""What an aircraft can do, found from its model: stall, speeds, trims, derivatives, gains, margins, modes."""

import math
import re
from dataclasses import replace

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.flight import gains
from ahrs_sim.flight.columns import FT, INCH
from ahrs_sim.flight.design import DT, Design, Row, load
from ahrs_sim.flight.fdm import Fdm, indexed
from ahrs_sim.flight.tunnel import CONTROLS, Point, Trim, Tunnel
from ahrs_sim.world.gravity import STANDARD as G

TOLERANCE = 0.05  # m/s2: a trim is one
SPEEDS = 8
STEEPEST = math.radians(25.0)  # angle of attack beyond which nothing is flown, stalled or not
BANKS = tuple(math.radians(x) for x in (30.0, 45.0, 60.0, 70.0, 75.0, 78.5, 80.0))
LIGHT = 0.2  # share of the fuel with which the margins are looked at again
FASTEST = 4.0  # times the stall, and
MACH = 0.85  # beyond which no speed is scheduled
SINKING = math.radians(-14.0)  # the steepest glide that is scheduled


class _Cannot(Exception):
    """Why an aircraft cannot be flown."""


def analyse(name: str, where: str, digest: str, fdm: Fdm) -> Design:
    """Find all about an aircraft that has just been loaded.

    Raises:
        InputError: it does not fly as an aeroplane does: the reason.
    """
    try:
        missing = [x for x in CONTROLS[:3] if not fdm.has(f"fcs/{x}-cmd-norm")]
        if missing or fdm["metrics/Sw-sqft"] <= 0.0 or fdm["metrics/cbarw-ft"] <= 0.0:
            raise _Cannot("it has no wing or no controls")
        return _analyse(fdm.exec.get_model_name(), digest, Tunnel(fdm), Tunnel(load(name, where), LIGHT))
    except (_Cannot, RuntimeError, ArithmeticError, np.linalg.LinAlgError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{where}: aircraft: '{name}' cannot be flown by the autopilot: {reason}; take another (docs/aircraft.md "
            "lists those that can), or a script of JSBSim's"
        ) from None


def _analyse(name: str, digest: str, tunnel: Tunnel, light: Tunnel) -> Design:
    powered = _thrust(tunnel) > 0.3
    slowest, first = _slowest(tunnel, powered)
    fastest = _fastest(tunnel, first, slowest, powered)
    trims: list[Trim] = []
    for speed in np.geomspace(1.06 * slowest.point.speed, fastest, SPEEDS):
        trims += _trimmed(tunnel, speed, trims[-1].point if trims else first.point, powered)
    if len(trims) < 3:
        raise _Cannot("it can be trimmed at hardly any speed")
    rows = []
    reason = ""
    for trim in trims:
        try:
            rows.append(_row(tunnel, light, trim, powered))
        except gains.NoGains as error:
            reason = str(error)
    if len(rows) < 3:
        raise _Cannot(f"no gains stabilise it ({reason})")
    stall = slowest.calibrated
    limit = rows[-1].airspeed
    wheels, refusals = _gear(tunnel, powered)
    ends = sorted(wheels)[:: len(wheels) - 1] if len(wheels) > 1 else [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    base = max(ends[1][0] - ends[0][0], 0.2)
    return Design(
        name=name, digest=digest, mass=tunnel.mass, area=tunnel.area, span=tunnel.span, engines=tunnel.engines,
        powered=powered, wheels=wheels, ground_pitch=math.atan2(ends[1][2] - ends[0][2], base),
        standing=max((wheel[2] for wheel in wheels), default=0.0), wheelbase=base, steer=_steering(tunnel.fdm),
        stall=stall,
        cruise=min(max(0.8 * limit, 1.5 * stall), (2.2 if powered else 1.5) * stall, limit), fastest=limit,
        throttle_lag=min(tunnel.lag(trims[len(trims) // 2].point, "throttle", 0.05), 8.0) if powered else 1.0,
        rows=rows, refusals=refusals,
    )  # fmt: skip


def _thrust(tunnel: Tunnel) -> float:
    """Compute the acceleration by the throttle, m/s2."""
    if not tunnel.engines:
        return 0.0
    speed = math.sqrt(2.0 * tunnel.mass * G / (tunnel.density * tunnel.area * 0.6))
    ends = [tunnel.accelerations(Point(speed, alpha=0.05, theta=0.05, throttle=x))[0] for x in (0.05, 1.0)]
    return float(ends[1] - ends[0])


def _slowest(tunnel: Tunnel, powered: bool) -> tuple[Trim, Trim]:
    """Find the slowest trim, and one to begin with."""
    first = None
    for lift in (0.6, 0.4, 0.8, 0.3, 0.2, 1.0, 0.1):
        speed = math.sqrt(2.0 * tunnel.mass * G / (tunnel.density * tunnel.area * lift))
        begin = Point(speed, alpha=0.05, theta=0.05, throttle=0.5)
        if found := _trimmed(tunnel, speed, begin, powered, thorough=True):
            first = found[0]
            break
    if first is None:
        if powered:
            raise _Cannot("no speed is found at which it flies level, its engines may not give enough thrust")
        if tunnel.engines:
            raise _Cannot("its engines give no thrust when they are started, and it does not glide")
        raise _Cannot("it has no engine, and no glide is found")
    slope = _lift_slope(tunnel, first)
    good, factor = first, 0.94
    while factor < 0.995:
        found = _trimmed(tunnel, good.point.speed * factor, good.point, powered)
        if found and found[0].point.alpha < STEEPEST and _lift_slope(tunnel, found[0]) > 0.25 * slope:
            good = found[0]
        else:
            factor = math.sqrt(factor)
    return good, first


def _lift_slope(tunnel: Tunnel, trim: Trim) -> float:
    """Lift per angle of attack over the dynamic pressure."""
    d = tunnel.derivatives(trim.point, ["alpha"], [0.01])
    return float(-d[2, 0] / trim.qbar)


def _fastest(tunnel: Tunnel, first: Trim, slowest: Trim, powered: bool) -> float:
    """Find the fastest level flight (m/s, true), within the schedule's limits."""
    sound = tunnel.fdm["atmosphere/a-fps"] * FT
    limit = min(FASTEST * slowest.point.speed, MACH * sound)
    good, factor = first, 1.12
    while factor > 1.01:
        found = _trimmed(tunnel, min(good.point.speed * factor, limit), good.point, powered)
        if found and good.point.speed < limit:
            good = found[0]
        else:
            factor = math.sqrt(factor)
    return good.point.speed


def _trimmed(tunnel: Tunnel, speed: float, guess: Point, powered: bool, thorough: bool = False) -> list[Trim]:
    """Find the trim at a speed, if there is one."""
    trim = tunnel.trim(speed, guess=guess, throttle=None if powered else 0.0, thorough=thorough)
    controls = [abs(getattr(trim.point, x)) for x in CONTROLS[:3]]
    steep = not powered and trim.slope < SINKING
    return [trim] if trim.residual < TOLERANCE and max(controls) < 0.98 and not steep else []


def _row(tunnel: Tunnel, light: Tunnel, trim: Trim, powered: bool) -> Row:
    at = trim.point
    lags = [max(tunnel.lag(at, x, 0.03), 2.0 * DT) for x in CONTROLS[:3]]
    if max(lags) > 2.0:
        raise gains.NoGains("a control has no effect, or acts after seconds")
    pitching, rolling, ahead, aside, slow = _models(tunnel, at, lags)
    less = light.trim(at.speed, guess=at, throttle=None if powered else 0.0)
    thin_pitching, thin_rolling, *_ = _models(light, less.point, lags)
    pitch, roll = gains.longitudinal(pitching, thin_pitching), gains.lateral(rolling, thin_rolling)
    turning = ahead[[3, 5]][:, 3:5]
    forward = -np.linalg.solve(turning, ahead[[3, 5]][:, 1:3])
    pull = np.linalg.solve(np.array([[aside[2, 0], aside[2, 2]], [aside[4, 0], aside[4, 2]]]), -aside[[2, 4], 1])
    thrust = float(slow[0, 1])
    full = tunnel.accelerations(replace(at, throttle=1.0))[0] if powered else 0.0
    return Row(
        qbar=trim.qbar, speed=at.speed, airspeed=trim.calibrated, alpha=at.alpha, theta=at.theta, elevator=at.elevator,
        aileron=at.aileron, rudder=at.rudder, throttle=at.throttle, slope=trim.slope,
        lateral=roll[0].inner.tolist(), bank_gain=roll[0].outer, turn_forward=forward.tolist(),
        longitudinal=pitch[0].inner[0].tolist(), pitch_gain=pitch[0].outer,
        pull_forward=[float(pull[1]), float(pull[0])],
        thrust=thrust, climb=float(at.speed * full / G), bank=_steepest(tunnel, trim, powered),
        modes=_modes(ahead, aside, slow, at), margins=_margins(pitch[0], roll[0]),
        margins_light=_margins(pitch[1], roll[1]),
        damping=min(loop.damping for loop in (*pitch, *roll)),
    )  # fmt: skip


def _models(
    tunnel: Tunnel, at: Point, lags: list[float]
) -> tuple[gains.Model, gains.Model, np.ndarray, np.ndarray, np.ndarray]:
    ahead = tunnel.derivatives(at, ["beta", "p", "r", "aileron", "rudder"], [0.01, 0.02, 0.02, 0.03, 0.03])
    aside = tunnel.derivatives(at, ["alpha", "q", "elevator"], [0.01, 0.02, 0.03])
    slow = tunnel.derivatives(at, ["speed", "throttle"], [0.02 * at.speed, 0.03], patience=8.0)
    longitudinal = gains.longitudinal_model(aside, at.speed, lags[0])
    return longitudinal, gains.lateral_model(ahead, at.speed, at.theta, (lags[1], lags[2])), ahead, aside, slow


def _margins(pitch: gains.Loop, roll: gains.Loop) -> dict[str, list[float]]:
    loops = zip(("elevator", "aileron", "rudder"), (*pitch.margins, *roll.margins), strict=True)
    return {name: [m.gain_db, m.phase_deg, m.crossover] for name, m in loops}


def _steepest(tunnel: Tunnel, trim: Trim, powered: bool) -> float:
    """Find the steepest of `BANKS` at which it turns level without losing speed."""
    if not powered:
        return BANKS[-1]  # it sinks in any turn
    steepest, guess = 0.0, trim.point
    for bank in BANKS:
        turn = tunnel.trim(trim.point.speed, load=1.0 / math.cos(bank), guess=guess)
        if turn.residual > TOLERANCE or turn.point.alpha > STEEPEST or turn.point.throttle > 0.99:
            break
        steepest, guess = bank, turn.point
    return steepest


def _modes(ahead: np.ndarray, aside: np.ndarray, slow: np.ndarray, at: Point) -> dict[str, list[float]]:
    """Compute modes of the aircraft without autopilot: real and imaginary part, 1/s."""
    v, cos, sin = at.speed, math.cos(at.alpha), math.sin(at.alpha)
    along = np.zeros((4, 4))  # speed, alpha, q, theta
    columns = np.column_stack([slow[:, 0], aside[:, 0], aside[:, 1]])
    along[0, :3] = cos * columns[0] + sin * columns[2]
    along[1, :3] = (cos * columns[2] - sin * columns[0]) / v
    along[0, 3] = -G * math.cos(at.theta - at.alpha)
    along[1, 3] = -G * math.sin(at.theta - at.alpha) / v
    along[2, :3] = columns[4]
    along[3, 2] = 1.0
    across = np.zeros((4, 4))  # beta, p, r, phi
    across[:3, :3] = np.array([ahead[1, :3] / v, ahead[3, :3], ahead[5, :3]])
    across[0, 3] = G * math.cos(at.theta) / v
    across[3, 1:3] = 1.0, math.tan(at.theta)
    fast = sorted(np.linalg.eigvals(along), key=lambda x: -abs(x))
    found = {"short period": fast[0], "phugoid": fast[2]}
    sideways = np.linalg.eigvals(across)
    pair = [x for x in sideways if x.imag > 1e-9]
    alone = sorted((x for x in sideways if abs(x.imag) < 1e-9), key=lambda x: -abs(x))
    found |= {"Dutch roll": max(pair, key=abs)} if pair else {}
    found |= {"roll": alone[0], "spiral": alone[-1]} if len(alone) > 1 else {}
    return {name: [float(x.real), abs(float(x.imag))] for name, x in found.items()}


def _gear(tunnel: Tunnel, powered: bool) -> tuple[list[list[float]], dict[str, str]]:
    """Locate the wheels about the centre of gravity, and find what they do not allow."""
    fdm = tunnel.fdm
    cg = [fdm[f"inertia/cg-{x}-in"] for x in "xyz"]
    wheels = []
    i = 0
    while fdm.has(unit := indexed("gear/unit", i) + "/z-position"):
        x, y, z = (fdm[unit.replace("z-pos", f"{axis}-pos")] - c for axis, c in zip("xyz", cg, strict=True))
        wheels.append([-x * INCH, y * INCH, -z * INCH])
        i += 1
    refusals = {}
    if not powered:
        refusals["takeoff"] = "it has no engine that drives it; start it in the air ([start] on_ground = false)"
        refusals["approach"] = "it has no engine that keeps it on a glide path; leave this step out"
    if len(wheels) < 3:
        refusals |= dict.fromkeys(("takeoff", "land"), f"it has {len(wheels)} wheels; start and end in the air")
    return wheels, refusals


def _steering(fdm: Fdm) -> float:
    """Find the angle that the steered wheel reaches, rad; a castering wheel is not steered."""
    text = fdm.sources[0].read_text(encoding="utf-8", errors="replace")
    found = [float(x) for x in re.findall(r"<max_steer[^>]*>\s*([-\d.]+)\s*<", text)]
    return math.radians(min((x for x in map(abs, found) if 0.0 < x < 360.0), default=30.0))
