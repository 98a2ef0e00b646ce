"""The autopilot of any aircraft: the set-points of our trainer's, flown with the gains of the aircraft's `Design`.

The trainer's loops are closed in its own XML; here they are closed a hundred times a second, from outside. Attitude
and rates come from the truth or from an estimate; airspeed, angle of attack, sideslip, side force, height and climb
rate from the truth.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ahrs_sim.flight.autopilot import Autopilot, wrap
from ahrs_sim.flight.columns import FT
from ahrs_sim.flight.design import Design, Row
from ahrs_sim.flight.fdm import Fdm, indexed, start_engines, stop_engines
from ahrs_sim.world.gravity import STANDARD as G

RATE = 100.0  # Hz
LEAST_SPEED = 5.0  # m/s, in what divides by it
STALL_GUARD = math.radians(1.5)  # beyond the greatest angle of attack that was trimmed
LIFTED = 0.3  # spans above the ground: the wheels are clear of it
TOUCHDOWN = 0.5  # m/s, the sink rate that the flare ends with
FLARE_RATE = 0.35  # 1/s, sink rate per height in the flare
BRAKES = 0.3
SLOWEST_SHARE = 1.12  # of the stall, below which height gives way to speed


def clip(value: float, low: float, high: float) -> float:
    """Keep `value` within the limits."""
    return low if value < low else high if value > high else value


class _Now(NamedTuple):
    """The schedule at one dynamic pressure."""

    alpha: float
    elevator: float
    aileron: float
    rudder: float
    bank_gain: float
    pitch_gain: float
    elevator_q: float
    alpha_q: float
    aileron_p: float
    aileron_r: float
    rudder_p: float
    rudder_r: float
    pitch: tuple[float, ...]  # (4,) alpha, q, elevator, integral
    roll: tuple[float, ...]  # (7,) of the aileron
    yaw: tuple[float, ...]  # (7,) of the rudder


class _Air(NamedTuple):
    """Holds air data and weight on wheels of one step."""

    calibrated: float  # m/s
    true: float  # m/s, not below LEAST_SPEED
    qbar: float  # Pa
    alpha: float
    beta: float
    climb: float  # m/s
    altitude: float  # m
    side_force: float  # m/s2
    on_ground: bool
    ground_speed: float  # m/s
    height: float  # m, of the wheels


class Body(NamedTuple):
    """Set attitude and rates that it flies on."""

    roll: float
    pitch: float
    heading: float
    p: float
    q: float
    r: float


class DesignedAutopilot(Autopilot):
    """The loops, and the phases of take-off and landing.

    Args:
        fdm: the aircraft, ready to fly.
        design: what is known of it.
        ground: m above sea level, of the runway.
    """

    def __init__(self, fdm: Fdm, design: Design, ground: float) -> None:
        super().__init__(fdm)
        self.design = design
        self.airspeed_goal = design.cruise
        self.approach_speed, self.landing_speed = design.approach, 1.25 * design.stall
        self.approach_glide = self.landing_glide = math.radians(3.0)
        self.speeds = (1.4 * design.stall, max(0.9 * design.fastest, 1.5 * design.stall))
        self.scale = design.approach / Autopilot.approach_speed
        self.approach_distance = 60.0 * design.approach
        self.climb_limit = clip(0.5 * design.at(design.cruise, lambda row: row.climb), 0.7, 0.05 * design.cruise)
        self.climb_speed = self.climb_limit
        self.estimate: Body | None = None
        self._ground = ground + design.standing
        names = (
            "velocities/vc-kts", "velocities/vt-fps", "aero/qbar-psf", "aero/alpha-rad", "aero/beta-rad",
            "velocities/h-dot-fps", "position/h-sl-ft", "forces/fby-total-lbs", "inertia/mass-slugs", "gear/wow",
            "velocities/vg-fps",
        )  # fmt: skip
        self._air = [fdm.getter(name) for name in names]
        self._truth = [fdm.getter(f"attitude/{x}-rad") for x in ("phi", "theta", "psi")]
        self._truth += [fdm.getter(f"velocities/{x}-rad_sec") for x in "pqr"]
        self._move = [fdm.setter(f"fcs/{x}-cmd-norm") for x in ("elevator", "aileron", "rudder")]
        self._throttles = [
            fdm.setter(n) for i in range(design.engines) if fdm.has(n := indexed("fcs/throttle-cmd-norm", i))
        ]
        brakes = ("fcs/left-brake-cmd-norm", "fcs/right-brake-cmd-norm", "fcs/center-brake-cmd-norm")
        self._brakes = [fdm.setter(name) for name in brakes if fdm.has(name)]
        self._steer: Callable[[float], object] = (
            fdm.setter("fcs/steer-cmd-norm") if fdm.has("fcs/steer-cmd-norm") else float
        )
        zero = (
            "phase", "motor-on", "lateral-mode", "vertical-mode", "throttle-mode", "yaw-mode", "roll-cmd-rad",
            "heading-cmd-rad", "roll-rate-cmd-rad_sec", "pitch-cmd-rad", "altitude-cmd-m", "climb-rate-cmd-mps",
            "pitch-rate-cmd-rad_sec", "throttle-cmd-norm", "glide-angle-rad", "flare-height-m",
            *(f"{x}-{y}-norm" for x in ("aileron", "elevator", "rudder") for y in ("cmd", "add")),
        )  # fmt: skip
        self.values = dict.fromkeys(zero, 0.0)
        self.values |= {
            "brake-cmd-norm": 1.0,
            "bank-limit-rad": math.radians(30.0),
            "climb-limit-mps": self.climb_limit,
            "airspeed-cmd-mps": design.cruise,
        }
        middle = _numbers(design.rows[len(design.rows) // 2])
        self.signs = tuple(math.copysign(1.0, x) for x in (middle.elevator_q, middle.aileron_p, middle.rudder_r))
        self._qbars = [row.qbar for row in design.rows]
        self._tables = np.array([np.hstack(_numbers(row)) for row in design.rows])
        self._greatest = max(row.alpha for row in design.rows) + STALL_GUARD
        self._least_thrust = max(0.4 * float(np.mean([row.thrust for row in design.rows])), 0.1)
        self.roll_rate_limit = self._roll_limit(self._schedule(design.at(design.cruise, lambda row: row.qbar)))
        # the ground track is steered no faster than the aircraft rolls into a turn of 30 deg and out of it
        agile = self.roll_rate_limit / math.radians(60.0)
        self.steering = min(0.2 * design.at(design.approach, lambda row: row.bank_gain), agile)
        self.line_distance = 1.4 * design.approach / self.steering
        self._running = False
        self._roll_integral = self._side_integral = self._pitch_integral = self._heading_integral = 0.0
        self._climb_integral = self._speed_integral = 0.0
        self.throttle_now = 0.0
        self._flare = self._down = False

    # -- what manoeuvres use

    def set(self, name: str, value: float) -> None:
        """Change a set-point; the names are those of the trainer's autopilot."""
        if name not in self.values:
            raise KeyError(name)
        if name == "phase" and value != self.values[name]:
            self._flare = self._down = False
        self.values[name] = value

    def get(self, name: str) -> float:
        """Read a set-point."""
        return self.values[name]

    def steepest(self, airspeed: float) -> float:
        """Steepest bank that is held at an airspeed, rad."""
        return self.design.bank_limit(airspeed)

    # -- the loops

    def inputs(self) -> Body:
        """Set attitude and rates that it flies on."""
        return self.estimate or Body(*(get() for get in self._truth))

    def run(self, dt: float) -> None:
        """Read the aircraft and move the controls; every `dt` seconds."""
        air, body = self._look(), self.inputs()
        self._engine()
        phase = self.values["phase"]
        if phase == 2 and air.on_ground:
            self._down = True
        self._flare = phase == 2 and not self._down and (self._flare or air.height < self._flare_height(air))
        rolling = air.on_ground and (phase != 2 or self._down)
        now = self._schedule(air.qbar)
        load = 1.0 / max(math.cos(body.roll), 0.15)
        turning = self._schedule(air.qbar / load)
        p, r = self._roll_rates(now, air, body)
        q = self._pitch_rate(now, turning, air, body, load, dt)
        self.throttle_now = self._throttle(air, dt)
        elevator = self._elevator(now, turning, air, body, q, load, rolling, dt)
        if rolling:
            aileron, rudder, steer = self._on_wheels(now, air, body, dt)
        else:
            aileron, rudder = self._lateral(now, air, body, p, r, dt)
            steer = 0.0
        added = [
            self.values[f"{x}-add-norm"] * sign
            for x, sign in zip(("elevator", "aileron", "rudder"), self.signs, strict=True)
        ]
        for move, value, more in zip(self._move, (elevator, aileron, rudder), added, strict=True):
            move(clip(value + more, -1.0, 1.0))
        for throttle in self._throttles:
            throttle(self.throttle_now)
        self._steer(steer)
        brakes = BRAKES if self._down else 0.0 if phase == 1 else self.values["brake-cmd-norm"]
        for brake in self._brakes:
            brake(brakes)

    def _look(self) -> _Air:
        knots, true, psf, alpha, beta, climb, altitude, side, mass, wow, ground_speed = (get() for get in self._air)
        height = altitude * FT - self._ground
        return _Air(
            knots * 0.514444, max(true * FT, LEAST_SPEED), psf * 47.88026, alpha, beta, climb * FT, altitude * FT,
            side / mass * FT, wow > 0.0, ground_speed * FT, height,
        )  # fmt: skip

    def _engine(self) -> None:
        """Switch the engines on or off when that is asked for."""
        wanted = self.values["motor-on"] > 0.5
        if wanted == self._running or not self.design.engines:
            return
        self._running = wanted
        (start_engines if wanted else stop_engines)(self._fdm)

    def _schedule(self, qbar: float) -> _Now:
        """Interpolate the schedule; beyond its ends it stays as it is there."""
        qbars = self._qbars
        i = int(np.searchsorted(qbars, qbar))
        if i in (0, len(qbars)):
            row = self._tables[min(i, len(qbars) - 1)].tolist()
        else:
            part = (qbar - qbars[i - 1]) / (qbars[i] - qbars[i - 1])
            row = ((1.0 - part) * self._tables[i - 1] + part * self._tables[i]).tolist()
        return _Now._make([*row[:12], tuple(row[12:16]), tuple(row[16:23]), tuple(row[23:30])])

    # -- roll and yaw

    def _roll_limit(self, now: _Now) -> float:
        """Roll rate with half of the aileron, and not more than is usual for the size."""
        return float(min(1.0, 8.0 / self.design.span, 0.5 / max(abs(now.aileron_p), 1e-3)))

    def _roll_rates(self, now: _Now, air: _Air, body: Body) -> tuple[float, float]:
        """Roll rate and yaw rate wanted."""
        v, phase = self.values, self.values["phase"]
        yaw = G * math.sin(body.roll) * math.cos(body.pitch) / air.true
        if v["lateral-mode"] == 3 and phase == 0:
            return v["roll-rate-cmd-rad_sec"], yaw
        level = self._flare or self._down or (phase == 1 and air.height < LIFTED * self.design.span)
        if level:
            target = 0.0
        elif v["lateral-mode"] == 2 or phase == 1:
            bank = math.radians(10.0) if phase == 1 else v["bank-limit-rad"]
            error = wrap(v["heading-cmd-rad"] - body.heading)
            target = clip(math.atan(0.25 * now.bank_gain * air.true * error / G), -bank, bank)
        else:
            target = v["roll-cmd-rad"]
        limit = self._roll_limit(now)
        rate = clip(now.bank_gain * wrap(target - body.roll), -limit, limit)
        slow = math.sin(body.pitch) / max(math.cos(body.pitch), 0.5)
        return rate - slow * (body.q * math.sin(body.roll) + body.r * math.cos(body.roll)), yaw

    def _lateral(self, now: _Now, air: _Air, body: Body, p: float, r: float, dt: float) -> tuple[float, float]:
        """Aileron and rudder for a roll rate and a yaw rate, with the ball in the middle."""
        v = self.values
        errors = (air.beta, body.p - p, body.r - r, 0.0, 0.0, self._roll_integral, self._side_integral)
        aileron = now.aileron + now.aileron_p * p + now.aileron_r * r - sum(map(float.__mul__, now.roll, errors))
        rudder = now.rudder + now.rudder_p * p + now.rudder_r * r - sum(map(float.__mul__, now.yaw, errors))
        if abs(aileron) < 1.0:
            self._roll_integral += dt * (body.p - p)
        if abs(rudder) < 1.0:
            self._side_integral += dt * air.side_force
        if v["lateral-mode"] == 0 and v["phase"] == 0:
            aileron = v["aileron-cmd-norm"] * self.signs[1]
        if v["yaw-mode"] == 0 and v["phase"] == 0:
            rudder = v["rudder-cmd-norm"] * self.signs[2]
        return aileron, rudder

    def _on_wheels(self, now: _Now, air: _Air, body: Body, dt: float) -> tuple[float, float, float]:
        """Aileron, rudder and nose wheel that keep the heading on the ground."""
        self._roll_integral = self._side_integral = 0.0
        if self.values["phase"] == 0:
            return 0.0, 0.0, 0.0
        error = wrap(self.values["heading-cmd-rad"] - body.heading)
        self._heading_integral = clip(self._heading_integral + dt * error, -0.3, 0.3)
        rate = clip(0.6 * error + 0.15 * self._heading_integral, -0.2, 0.2)
        share = clip(air.calibrated / self.design.stall, 0.0, 1.0)
        rudder = self.signs[2] * (3.0 * error + 1.0 * self._heading_integral) - share * now.yaw[2] * (body.r - rate)
        wheel = math.atan(rate * self.design.wheelbase / max(air.ground_speed, 2.0)) + 0.3 * (rate - body.r)
        aileron = now.aileron * share - self.signs[1] * clip(2.0 * body.roll, -0.5, 0.5)
        return aileron, clip(rudder, -1.0, 1.0), clip(wheel / self.design.steer, -1.0, 1.0)

    # -- pitch

    def _pitch_rate(self, now: _Now, turning: _Now, air: _Air, body: Body, load: float, dt: float) -> float:
        """Pitch rate wanted."""
        v, phase = self.values, self.values["phase"]
        turn = G / air.true * math.sin(body.roll) ** 2 * load * math.cos(body.pitch)
        if v["vertical-mode"] == 4 and phase == 0:
            return v["pitch-rate-cmd-rad_sec"]
        if self._down:
            target = max(self.design.ground_pitch, body.pitch - 0.05)
        elif phase == 1:
            self._climb_integral = 0.0
            target = self._takeoff_pitch(air)
        elif v["vertical-mode"] == 1 and phase == 0:
            target = v["pitch-cmd-rad"]
        else:
            target = self._climb_pitch(now, turning, air, body, load, dt)
        target = min(target, body.pitch + self._greatest - air.alpha)
        limit = 0.8 * G / air.true
        upright = max(math.cos(body.roll), 0.0) / max(math.cos(body.roll) ** 2, 0.12)
        return clip(now.pitch_gain * (target - body.pitch), -limit, limit) * upright + turn

    def _takeoff_pitch(self, air: _Air) -> float:
        design = self.design
        if air.calibrated < design.rotate and air.height < 1.0:
            return design.ground_pitch
        speed = 1.25 * design.stall
        slope = math.asin(clip(0.6 * design.at(speed, lambda row: row.climb) / speed, 0.03, 0.2))
        return slope + design.at(speed, lambda row: row.alpha)

    def _climb_pitch(self, now: _Now, turning: _Now, air: _Air, body: Body, load: float, dt: float) -> float:
        """Pitch for a climb rate, or for the airspeed where no engine holds it."""
        v, phase = self.values, self.values["phase"]
        slow = max(0.0, SLOWEST_SHARE * self.design.stall * math.sqrt(load) - air.calibrated)
        if not self.design.powered and not self._flare:
            error = clip(air.calibrated - v["airspeed-cmd-mps"], -5.0, 5.0)
            self._climb_integral = clip(self._climb_integral + dt * 0.02 * now.pitch_gain * error / G, -0.1, 0.1)
            base = self.design.at(v["airspeed-cmd-mps"], lambda row: row.slope) + 0.2 * now.pitch_gain * error / G
        else:
            if self._flare:
                wanted = -TOUCHDOWN - FLARE_RATE * max(air.height, 0.0)
            elif phase == 2 and v["glide-angle-rad"] > 0.0:
                wanted = -air.ground_speed * math.tan(v["glide-angle-rad"])
            elif v["vertical-mode"] == 2 and phase == 0:
                limit = v["climb-limit-mps"]
                wanted = clip(0.15 * now.pitch_gain * (v["altitude-cmd-m"] - air.altitude), -limit, limit) - 1.5 * slow
            else:
                wanted = v["climb-rate-cmd-mps"] - 1.5 * slow
            error = clip(wanted - air.climb, -0.08 * air.true, 0.08 * air.true)
            self._climb_integral = clip(
                self._climb_integral + dt * 0.15 * now.pitch_gain * error / air.true, -0.12, 0.12
            )
            base = math.asin(clip(wanted / air.true, -0.5, 0.5)) + 0.6 * error / air.true
        if v["vertical-mode"] == 1 or air.on_ground:
            self._climb_integral = 0.0
        return clip(base + turning.alpha * math.cos(body.roll) + self._climb_integral, -0.5, 0.5)

    def _elevator(
        self, now: _Now, turning: _Now, air: _Air, body: Body, q: float, load: float, rolling: bool, dt: float
    ) -> float:
        v = self.values
        pull = q - G / air.true * math.sin(body.roll) ** 2 * load
        errors = (air.alpha - turning.alpha - now.alpha_q * pull, body.q - q, 0.0, self._pitch_integral)
        if rolling and not (v["phase"] == 1 and air.calibrated > self.design.rotate):
            self._pitch_integral *= 1.0 - dt
            errors = (0.0, body.q - q, 0.0, self._pitch_integral)
        elevator = turning.elevator + now.elevator_q * pull - sum(map(float.__mul__, now.pitch, errors))
        if abs(elevator) < 1.0:
            self._pitch_integral += dt * (body.q - q)
        if v["vertical-mode"] == 0 and v["phase"] == 0:
            elevator = v["elevator-cmd-norm"] * self.signs[0]
        return elevator

    def _flare_height(self, air: _Air) -> float:
        """Compute the height (m, of the wheels) at which the sink rate is that of the flare's law."""
        if self.values["flare-height-m"] > 0.0:
            return self.values["flare-height-m"]
        return max(1.0, (-air.climb - TOUCHDOWN) / FLARE_RATE - max(0.7, air.true / 90.0) * air.climb)

    # -- thrust

    def _throttle(self, air: _Air, dt: float) -> float:
        v, phase = self.values, self.values["phase"]
        if not self.design.engines or v["motor-on"] < 0.5:
            return 0.0
        if phase == 1:
            self._speed_integral = 0.0
            return min(1.0, self.throttle_now + 0.25 * dt)
        if self._flare or self._down:
            return max(0.0, self.throttle_now - 0.5 * dt)
        wanted = v["airspeed-cmd-mps"]
        thrust = max(self.design.at(wanted, lambda row: row.thrust), self._least_thrust)
        forward = self.design.at(wanted, lambda row: row.throttle) + air.climb / air.true * G / thrust
        if v["throttle-mode"] == 0 and phase == 0:
            self._speed_integral = 0.0
            return clip(v["throttle-cmd-norm"], 0.0, 1.0)
        bandwidth = clip(0.35 / self.design.throttle_lag, 0.1, 0.3)
        error = clip(wanted - air.calibrated, -0.3 * air.true, 0.3 * air.true)
        throttle = forward + bandwidth / thrust * error + self._speed_integral
        if abs(error) < 0.06 * air.true and (0.0 < throttle < 1.0 or (throttle - 0.5) * error < 0.0):
            self._speed_integral = clip(self._speed_integral + dt * 0.2 * bandwidth**2 / thrust * error, -0.8, 0.8)
        return clip(throttle, 0.0, 1.0)


def _numbers(row: Row) -> _Now:
    (ap, ar), (rp, rr) = row.turn_forward
    return _Now(
        row.alpha, row.elevator, row.aileron, row.rudder, row.bank_gain, row.pitch_gain, row.pull_forward[0],
        row.pull_forward[1], ap, ar, rp, rr, tuple(row.longitudinal), tuple(row.lateral[0]), tuple(row.lateral[1]),
    )  # fmt: skip
