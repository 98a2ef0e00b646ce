"""The trainer flies like an aircraft of its size, and its autopilot holds what it is asked to hold."""

import math
import re

import numpy as np
import pytest

from ahrs_sim.flight.fdm import Fdm
from ahrs_sim.flight.turbulence import RoughAir
from ahrs_sim.scenario import Wind
from ahrs_sim.scenario.shipped import aircraft_dir

DT = 1.0 / 400.0
FT, DEG = 0.3048, math.pi / 180.0
GROUND = 150.0  # m above sea level
HEIGHT = 250.0  # m above sea level where flights in the air begin
MASS, G, AREA = 6.0, 9.806, 0.62

CHANNELS = {
    "phi": ("attitude/phi-rad", 1 / DEG),
    "theta": ("attitude/theta-rad", 1 / DEG),
    "psi": ("attitude/psi-rad", 1 / DEG),
    "p": ("velocities/p-rad_sec", 1 / DEG),
    "q": ("velocities/q-rad_sec", 1 / DEG),
    "r": ("velocities/r-rad_sec", 1 / DEG),
    "fx": ("forces/fbx-total-lbs", 4.4482216 / MASS),
    "fy": ("forces/fby-total-lbs", 4.4482216 / MASS),
    "fz": ("forces/fbz-total-lbs", 4.4482216 / MASS),
    "cas": ("velocities/vc-kts", 1852 / 3600),
    "alpha": ("aero/alpha-rad", 1 / DEG),
    "beta": ("aero/beta-rad", 1 / DEG),
    "altitude": ("position/h-sl-ft", FT),
    "climb": ("velocities/h-dot-fps", FT),
    "ground_speed": ("velocities/vg-fps", FT),
    "elevator": ("ap/out/elevator-norm", 1.0),
    "throttle": ("ap/out/throttle-norm", 1.0),
    "rpm": ("propulsion/engine/propeller-rpm", 1.0),
    "height": ("ap/height-m", 1.0),
    "wow": ("ap/main-wow", 1.0),
    "phase": ("ap/phase-now", 1.0),
    "crashed": ("ap/crashed", 1.0),
}


class Trainer:
    """The trainer in JSBSim, angles in degrees."""

    def __init__(self, *, speed=None, wind=(0.0, 0.0), turbulence=0.0, seed=1, **initial):
        """Parked heading north when there is no `speed` (m/s); wind blows towards north, east."""
        self.fdm = fdm = Fdm(DT)
        fdm.load_aircraft("trainer", "test")
        fdm["simulation/randomseed"] = seed
        fdm["ic/lat-geod-deg"] = 43.57
        fdm["ic/terrain-elevation-ft"] = GROUND / FT
        fdm["ic/h-agl-ft"] = (0.2712 if speed is None else HEIGHT - GROUND) / FT
        if speed is None:
            fdm["ic/theta-deg"] = 2.075
        else:
            fdm["ic/vt-fps"] = speed / FT
            fdm["ic/alpha-deg"] = 2.3
        for name, value in initial.items():
            fdm["ic/" + name.replace("_", "-").replace("rad-sec", "rad_sec")] = value
        fdm.exec.run_ic()
        fdm["simulation/integrator/rate/rotational"] = 3
        fdm["simulation/integrator/position/rotational"] = 7
        fdm["atmosphere/wind-north-fps"], fdm["atmosphere/wind-east-fps"] = wind[0] / FT, wind[1] / FT
        rough = Wind(math.hypot(*wind), math.atan2(-wind[1], -wind[0]), "light", turbulence, ())
        self.air = RoughAir(fdm, rough, seed, 4) if turbulence else None
        self._seen = [fdm.getter("position/h-agl-ft")]
        self._seen += [fdm.getter(f"velocities/v-{x}-fps") for x in ("north", "east", "down")]
        self._seen += [fdm.getter(f"attitude/{x}-rad") for x in ("phi", "theta", "psi")]
        self._get = [(fdm.getter(name), factor) for name, factor in CHANNELS.values()]

    def ap(self, **commands):
        for name, value in commands.items():
            self.fdm["ap/" + name.replace("_", "-").replace("rad-sec", "rad_sec")] = value
        return self

    def fly(self, seconds, each=None):
        """Channels at 100 Hz; `each` is called before every sample."""
        rows = []
        for _ in range(round(seconds * 100)):
            if each is not None:
                each()
            if self.air is not None:
                height, *motion = (get() for get in self._seen)
                self.air.ahead(FT * height, [FT * v for v in motion[:3]], motion[3:])
            for _ in range(4):
                if self.air is not None:
                    self.air.step()
                self.fdm.exec.run()
            rows.append([get() * factor for get, factor in self._get])
        return dict(zip(CHANNELS, np.array(rows).T, strict=True))


def cruising(speed=20.0, settle=12.0, **options):
    """Trimmed level flight to the north at HEIGHT."""
    trainer = Trainer(speed=speed, **options)
    trainer.ap(motor_on=1, lateral_mode=1, yaw_mode=1, vertical_mode=2, altitude_cmd_m=HEIGHT)
    trainer.ap(throttle_mode=1, airspeed_cmd_mps=speed)
    trainer.fly(settle)
    return trainer


# On the ground


@pytest.mark.parametrize("wind", [(0, 0), (-4, 0), (4, 0), (0, 4), (-3, -3)])
def test_parked_aircraft_stands_still_in_wind(wind):
    trainer = Trainer(wind=wind)
    trainer.fly(4)
    rest = trainer.fly(5)
    force = np.sqrt(rest["fx"] ** 2 + rest["fy"] ** 2 + rest["fz"] ** 2)
    assert np.abs(force - 9.8046).max() < 0.001  # gravity there
    assert max(np.abs(rest[name]).max() for name in "pqr") < 0.002  # deg/s
    assert max(np.ptp(rest[name]) for name in ("phi", "theta")) < 0.001
    assert np.ptp(np.unwrap(rest["psi"], period=360)) < 0.001
    assert rest["ground_speed"].max() < 1e-4
    assert rest["rpm"].max() == 0
    assert rest["crashed"].max() == 0


def test_parked_aircraft_hardly_moves_in_turbulence():
    trainer = Trainer(wind=(-2, 3.5), turbulence=4.0)
    trainer.fly(4)
    rest = trainer.fly(15)
    assert max(np.sqrt((rest[name] ** 2).mean()) for name in "pqr") < 0.06  # deg/s, from side gusts of 0.8 m/s RMS
    assert max(np.ptp(rest[name]) for name in ("phi", "theta")) < 0.05


def test_motor_turns_only_when_it_is_on():
    trainer = Trainer()
    trainer.ap(throttle_cmd_norm=0.5)
    assert trainer.fly(1)["rpm"].max() == 0
    trainer.ap(throttle_cmd_norm=0.0, motor_on=1)
    idle = trainer.fly(3)
    assert 200 < idle["rpm"][-1] < 1500
    assert idle["ground_speed"].max() < 0.01  # the brake holds


def test_steering_turns_on_the_wheels():
    trainer = Trainer()
    trainer.ap(motor_on=1, brake_cmd_norm=0, yaw_mode=2, heading_cmd_rad=60 * DEG, lateral_mode=1)
    trainer.ap(throttle_cmd_norm=0.25)
    run = trainer.fly(12)
    assert abs(run["psi"][-1] - 60) < 2
    assert np.abs(run["phi"]).max() < 8


# Airframe


def coefficients(alpha):
    """CL and Cm in steady air at an angle of attack (deg)."""
    fdm = Trainer(speed=20.0, alpha_deg=alpha, gamma_deg=0.0).fdm
    force = fdm["aero/qbar-psf"] * AREA / FT**2
    return fdm["forces/fwz-aero-lbs"] / force, fdm["moments/m-aero-lbsft"] / (force * 0.31 / FT)


def test_static_margin():
    low, high = coefficients(0.0), coefficients(6.0)
    margin = -(high[1] - low[1]) / (high[0] - low[0])
    assert margin == pytest.approx(0.15, abs=0.01)


def test_stalls_gently_between_11_and_13_mps():
    trainer = cruising(15.0)
    trainer.ap(throttle_mode=0, throttle_cmd_norm=0, vertical_mode=1)
    pitch = [trainer.fdm["attitude/theta-rad"]]

    def raise_nose():
        pitch[0] += 0.015 * DEG
        trainer.ap(pitch_cmd_rad=pitch[0])

    run = trainer.fly(15, raise_nose)
    load = -run["fz"] / (G * np.cos(run["alpha"] * DEG))
    flying = load > 0.75
    assert 11 < (run["cas"][flying] / np.sqrt(load[flying])).min() < 13
    assert run["alpha"].max() > 16  # it did stall
    assert np.abs(run["phi"]).max() < 10  # and dropped no wing


def test_cruises_at_20_mps():
    level = cruising(20.0, settle=25.0).fly(2)
    assert np.abs(level["cas"] - 20).max() < 0.1
    assert 0 < level["alpha"].mean() < 4
    assert abs(level["elevator"].mean()) < 0.05
    assert 0.5 < level["throttle"].mean() < 0.85


def test_climbs_faster_than_3_mps_at_take_off_pitch():
    trainer = cruising(18.0)
    trainer.ap(throttle_mode=0, throttle_cmd_norm=1, vertical_mode=1, pitch_cmd_rad=12 * DEG)
    assert trainer.fly(10)["climb"][-100:].min() > 3


def test_flies_hands_off():
    trainer = cruising(20.0, settle=30.0)
    for name, source in (("aileron", "roll"), ("elevator", "pitch"), ("rudder", "yaw")):
        trainer.ap(**{f"{name}_cmd_norm": trainer.fdm[f"ap/{source}/demand-norm"]})
    trainer.ap(throttle_cmd_norm=trainer.fdm["ap/out/throttle-norm"])
    trainer.ap(lateral_mode=0, vertical_mode=0, yaw_mode=0, throttle_mode=0)
    trainer.ap(elevator_add_norm=0.15).fly(0.5)
    trainer.ap(elevator_add_norm=0, aileron_add_norm=0.1).fly(0.2)
    trainer.ap(aileron_add_norm=-0.1).fly(0.2)
    trainer.ap(aileron_add_norm=0)
    run = trainer.fly(30)
    assert np.abs(run["phi"]).max() < 15
    assert abs(run["cas"][-1] - 20) < 0.5
    assert np.ptp(run["q"][-300:]) < 0.1  # everything has died down


def test_tumbling_stays_finite_and_is_caught():
    rng = np.random.default_rng(1)
    for _ in range(8):
        u, v, w = rng.normal(0, 12, 3) / FT
        attitude = {"phi_deg": rng.uniform(-180, 180), "theta_deg": rng.uniform(-89, 89)}
        rates = {f"{x}_rad_sec": rng.uniform(-6, 6) for x in "pqr"}
        trainer = Trainer(speed=1.0, h_agl_ft=2500.0, **attitude, u_fps=u, v_fps=v, w_fps=w, **rates)
        trainer.ap(motor_on=1, throttle_mode=1, airspeed_cmd_mps=20.0)
        trainer.ap(**{f"{name}_cmd_norm": rng.uniform(-1, 1) for name in ("aileron", "elevator", "rudder")})
        run = trainer.fly(5)
        assert all(np.isfinite(values).all() for values in run.values())
        trainer.ap(lateral_mode=1, roll_cmd_rad=0, vertical_mode=1, pitch_cmd_rad=0, yaw_mode=1)
        end = trainer.fly(8)
        assert abs(end["phi"][-1]) < 2
        assert abs(end["theta"][-1]) < 2


# Autopilot


@pytest.mark.parametrize("turbulence", [0.0, 5.0])
def test_roll_step(turbulence):
    trainer = cruising(turbulence=turbulence)
    trainer.ap(roll_cmd_rad=30 * DEG)
    run = trainer.fly(6)
    tolerance = 0.2 if turbulence == 0 else 2.0
    assert np.abs(run["phi"][250:] - 30).max() < tolerance
    assert run["phi"].max() < 30 + tolerance
    assert np.abs(run["beta"]).max() < 4


def test_heading_goes_the_shortest_way_within_the_bank_limit():
    trainer = cruising(psi_true_deg=330.0)
    trainer.ap(lateral_mode=2, heading_cmd_rad=40 * DEG, bank_limit_rad=25 * DEG)
    run = trainer.fly(18)
    heading = np.unwrap(run["psi"], period=360)
    assert heading[-1] == pytest.approx(400, abs=0.5)
    assert heading.min() > 329
    assert heading.max() < 401
    assert 24 < run["phi"].max() < 26


@pytest.mark.parametrize(("bank", "turbulence"), [(30, 0), (45, 0), (60, 0), (30, 5), (-45, 5)])
def test_altitude_in_turns(bank, turbulence):
    trainer = cruising(22.0, turbulence=turbulence)
    trainer.ap(roll_cmd_rad=bank * DEG)
    run = trainer.fly(12)
    assert np.abs(run["altitude"] - HEIGHT).max() < (1.0 if turbulence == 0 else 3.0)
    assert np.abs(run["cas"] - 22).max() < 2
    assert abs(run["phi"][-1] - bank) < 2


def test_altitude_and_airspeed_steps():
    trainer = cruising()
    trainer.ap(altitude_cmd_m=HEIGHT + 15)
    run = trainer.fly(14)
    assert abs(run["altitude"][-1] - HEIGHT - 15) < 0.5
    assert run["altitude"].max() < HEIGHT + 16
    assert run["climb"].max() < 3.6
    trainer.ap(airspeed_cmd_mps=24.0)
    run = trainer.fly(10)
    assert abs(run["cas"][-1] - 24) < 0.4
    assert run["cas"].max() < 24.5
    assert np.abs(run["altitude"] - HEIGHT - 15).max() < 1


def test_climb_rate_pitch_and_rates():
    trainer = cruising()
    trainer.ap(vertical_mode=3, climb_rate_cmd_mps=2.0)
    assert np.abs(trainer.fly(6)["climb"][300:] - 2).max() < 0.2
    trainer.ap(vertical_mode=1, pitch_cmd_rad=-3 * DEG)
    assert np.abs(trainer.fly(4)["theta"][200:] + 3).max() < 0.3
    trainer.ap(vertical_mode=4, pitch_rate_cmd_rad_sec=0.5, lateral_mode=3, roll_rate_cmd_rad_sec=0.0)
    assert np.abs(trainer.fly(1.2)["q"][60:] - 0.5 / DEG).max() < 3
    trainer.ap(pitch_rate_cmd_rad_sec=0.0, roll_rate_cmd_rad_sec=2.0)
    assert np.abs(trainer.fly(1.5)["p"][60:] - 2.0 / DEG).max() < 12


def test_loop():
    trainer = cruising(25.0)
    trainer.ap(vertical_mode=4, pitch_rate_cmd_rad_sec=1.3, lateral_mode=3, throttle_mode=0, throttle_cmd_norm=1)
    run = trainer.fly(2 * math.pi / 1.3)
    assert run["theta"].max() > 75
    assert np.abs(run["phi"]).max() > 150  # went over the top
    assert run["cas"].min() > 13
    trainer.ap(lateral_mode=1, roll_cmd_rad=0, vertical_mode=2, throttle_mode=1)
    end = trainer.fly(8)
    assert abs(end["phi"][-1]) < 3
    assert abs(end["altitude"][-1] - HEIGHT) < 5


def test_altitude_hold_without_motor_does_not_stall():
    trainer = cruising(turbulence=4.0)
    trainer.ap(motor_on=0)
    run = trainer.fly(20)
    assert run["alpha"].max() < 15.5
    assert run["climb"][-500:].mean() > -2.5


def test_modes_engage_without_a_bump():
    trainer = cruising(settle=20.0)
    held = {name: trainer.fdm[f"ap/out/{name}-norm"] for name in ("aileron", "elevator", "throttle")}
    trainer.ap(**{f"{name}_cmd_norm": value for name, value in held.items()})
    trainer.ap(lateral_mode=0, vertical_mode=0, throttle_mode=0)
    trainer.fly(3)
    before = {name: trainer.fdm[f"ap/out/{name}-norm"] for name in held}
    pitch, roll = trainer.fdm["attitude/theta-rad"], trainer.fdm["attitude/phi-rad"]
    trainer.ap(lateral_mode=1, roll_cmd_rad=roll, vertical_mode=1, pitch_cmd_rad=pitch, throttle_mode=1)
    trainer.ap(airspeed_cmd_mps=trainer.fdm["ap/air/cas-mps"])
    trainer.fly(0.03)
    for name, value in before.items():
        assert trainer.fdm[f"ap/out/{name}-norm"] == pytest.approx(value, abs=0.02)
    trainer.ap(vertical_mode=3, climb_rate_cmd_mps=trainer.fdm["ap/air/climb-mps"])
    run = trainer.fly(2)
    assert np.ptp(run["theta"]) < 0.5


def test_flies_on_an_attitude_from_outside():
    trainer = cruising()

    def feed():
        for name in ("theta", "psi"):
            trainer.fdm[f"ap/ext/{name}-rad"] = trainer.fdm[f"attitude/{name}-rad"]
        trainer.fdm["ap/ext/phi-rad"] = trainer.fdm["attitude/phi-rad"] + 5 * DEG
        for name in "pqr":
            trainer.fdm[f"ap/ext/{name}-rad_sec"] = trainer.fdm[f"velocities/{name}-rad_sec"]

    trainer.ap(external=1)
    run = trainer.fly(5, feed)
    assert run["phi"][-1] == pytest.approx(-5, abs=0.2)
    assert abs(run["altitude"][-1] - HEIGHT) < 0.5


def test_autopilot_reads_attitude_and_rates_only_through_its_inputs():
    text = (aircraft_dir() / "trainer" / "autopilot.xml").read_text(encoding="utf-8")
    used = re.findall(r"(?:attitude/[\w-]+|velocities/[pqr]i?-\w+|accelerations/\w+)", text)
    assert sorted(used) == sorted(f"attitude/{x}-rad" for x in ("phi", "theta", "psi")) + [
        f"velocities/{x}-rad_sec" for x in "pqr"
    ]


# Take-off and landing


@pytest.mark.parametrize(("wind", "seed"), [((-4, 0), 1), ((-3, 2.5), 2), ((-2.8, -2.8), 3), ((0, 4), 4)])
def test_takes_off_and_lands_in_wind(wind, seed):
    trainer = Trainer(wind=wind, turbulence=5.0, seed=seed)
    trainer.ap(motor_on=1).fly(2)
    trainer.ap(phase=1, heading_cmd_rad=0)
    start = trainer.fly(9)
    off = int(np.argmax(start["height"] > 0.3))
    assert 0 < np.sum(start["ground_speed"][:off]) * 0.01 < 40  # m of run
    assert np.abs(start["phi"]).max() < 15
    assert start["height"][-1] > 15
    trainer.ap(phase=0, lateral_mode=2, yaw_mode=1, vertical_mode=2, altitude_cmd_m=GROUND + 25)
    trainer.ap(throttle_mode=1, airspeed_cmd_mps=15.0)
    trainer.fly(12)
    trainer.ap(phase=2, climb_rate_cmd_mps=-1.2)
    landing = trainer.fly(35)
    down = int(np.argmax(landing["wow"] > 0))
    assert down > 0
    assert landing["climb"][down - 1] > -0.9
    assert landing["phase"][-1] == 3
    assert landing["ground_speed"][-1] < 0.02
    assert abs((landing["psi"][-1] + 180) % 360 - 180) < 5
    assert start["crashed"].max() == landing["crashed"].max() == 0


def test_glide_angle():
    trainer = cruising(15.0, wind=(-4.0, 0.0))
    trainer.ap(phase=2, glide_angle_rad=5 * DEG)
    run = trainer.fly(12)
    assert np.mean(-run["climb"][-300:] / run["ground_speed"][-300:]) == pytest.approx(math.tan(5 * DEG), rel=0.05)


@pytest.mark.parametrize(
    "initial",
    [
        {"theta_deg": -60.0, "h_agl_ft": 6.0},  # nose
        {"phi_deg": 60.0, "h_agl_ft": 4.0},  # right wing tip
        {"phi_deg": -60.0, "h_agl_ft": 4.0},  # left wing tip
        {"theta_deg": 40.0, "h_agl_ft": 4.0, "u_fps": 5.0, "w_fps": 8.0},  # tail
        {"phi_deg": 180.0, "h_agl_ft": 2.0},  # inverted
        {"h_agl_ft": 12.0, "w_fps": 30.0},  # flat, far too fast
    ],
)
def test_crash_is_seen(initial):
    trainer = Trainer(speed=12.0, **initial)
    assert trainer.fdm["ap/crashed"] == 0
    run = trainer.fly(1.5)
    assert run["crashed"][-1] == 1
    assert all(np.isfinite(values).all() for values in run.values())
    trainer.ap(crashed=0)


def test_the_motor_does_what_its_file_says():
    """Balance of torque at full throttle, standing: DC motor (Kv, R, I0) against CP rho n^2 D^5 / 2 pi."""
    text = (aircraft_dir() / "trainer" / "Engines" / "motor.xml").read_text(encoding="utf-8")
    volts, kv, ohm, idle = (
        float(re.search(rf"<{name}>\s*([\d.]+)", text)[1])
        for name in ("maxvolts", "velocityconstant", "coilresistance", "noloadcurrent")
    )
    rho, diameter, ct, cp = 1.225, 18 * 0.0254, 0.0836, 0.0250
    low, high = 0.0, volts * kv / 60.0  # turns per second
    for _ in range(60):
        n = 0.5 * (low + high)
        current = (volts - 60.0 * n / kv) / ohm
        spare = 60.0 / (2.0 * math.pi * kv) * (current - idle) - cp * rho * n**2 * diameter**5 / (2.0 * math.pi)
        low, high = (n, high) if spare > 0.0 else (low, n)
    shaft, battery = cp * rho * n**3 * diameter**5, volts * current
    assert (60.0 * n, shaft, battery / MASS) == pytest.approx((7450.0, 1170.0, 226.0), rel=0.02)
    assert ct * rho * n**2 * diameter**4 / (MASS * G) == pytest.approx(1.17, rel=0.02)
    assert "7450 rpm, 1.17 kW" in text and "226 W/kg" in text
    trainer = Trainer()
    trainer.ap(motor_on=1, throttle_cmd_norm=1.0)
    assert trainer.fly(3)["rpm"][-1] == pytest.approx(60.0 * n, rel=0.02)


def test_descents_begin_without_a_push_to_weightlessness():
    trainer = cruising(22.0)
    trainer.ap(altitude_cmd_m=HEIGHT - 20.0)
    assert -trainer.fly(4)["fz"].max() / G > 0.5
    trainer = cruising(15.0)
    trainer.ap(phase=2, glide_angle_rad=6 * DEG)
    assert -trainer.fly(4)["fz"].max() / G > 0.5
