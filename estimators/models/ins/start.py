"""Settings of the navigator, and its first state."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators import adaptation
from estimators.alignment import ALIGNED, Alignment, limits
from estimators.models.base import GROUPS, Group, Start
from estimators.models.ins.aids import AIDS, GROUPED, field
from estimators.models.ins.aids.gnss import UP
from estimators.models.ins.kernels import Memory, Parameters, Readings
from estimators.models.ins.layout import BA, BG, HI, LARGEST, P_, PHI, SG, WIND, V
from estimators.settings import Setting
from estimators.types import SensorInfo, Site

SETTINGS = {
    **ALIGNED,
    "aiding": Setting("gnss", "what keeps the velocity", ("none", "gnss", "airspeed", "gnss+airspeed")),
    "states": Setting("21", "15, or 21 with gyro scale and hard iron (and the wind with gnss+airspeed)", ("15", "21")),
    "gyro_noise": Setting(1e-3, "rad/s/sqrt(Hz), beside the data sheet's: vibration", minimum=0.0),
    "scale_share": Setting(0.2, "of the gyro's scale error, left as noise that grows with the rate", minimum=0.0),
    "scale_time": Setting(5.0, "s, how long a rate lasts: correlation of that noise", above=0.0),
    "accel_noise": Setting(0.05, "m/s2/sqrt(Hz), beside the data sheet's: vibration, turbulence", minimum=0.0),
    "accel_share": Setting(
        0.014, "1/sqrt(Hz), additional accelerometer noise proportional to |a|: lever arm", minimum=0.0
    ),
    "force_share": Setting(0.5, "of the accelerometer's scale error, left as noise that grows with |a|", minimum=0.0),
    "turn_share": Setting(0.5, "of misalignment, by which the biases change with rate and force", minimum=0.0),
    "shake_share": Setting(2.0, "of the accelerometer's variance between samples, left as noise", minimum=0.0),
    "shake_most": Setting(0.5, "m/s2/sqrt(Hz), the most of that", minimum=0.0),
    "jerk_share": Setting(2.0, "of the gyro's variance between samples, left as noise of one step", minimum=0.0),
    "bias_time": Setting(300.0, "s, correlation of the in-run biases", above=0.0),
    "speed_min": Setting(8.0, "m/s, below it the airspeed may be wind on the ground: not used", minimum=0.0),
    "wind_walk": Setting(0.3, "m/s per sqrt(s), random walk of the wind", minimum=0.0),
    **{name: setting for aid in AIDS for name, setting in aid.SETTINGS.items()},
    **adaptation.settings(),
}

UP_SHARE = np.array([1.0, 1.0, UP**2]) / np.mean([1.0, 1.0, UP**2])
"""Of the data sheet's variance, which is the mean over the axes: north, east, down."""


def build(settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment) -> Start:
    """Make the model and its first state from settings, place, sensors and alignment."""
    use_gnss, use_air = "gnss" in settings["aiding"], "airspeed" in settings["aiding"]
    n = 24 if use_gnss and use_air else int(settings["states"])
    initial, walks = _sigmas(n, use_gnss, settings, site, sensors)
    initial[PHI : PHI + 3] = alignment.sigma_n
    initial[BG : BG + 3] = alignment.gyro_bias_sigma
    velocity, place = (alignment.vel_n, alignment.lla) if use_gnss else (alignment.air_n, np.full(3, np.nan))
    known = bool(np.isfinite(velocity).all())  # moving, and how fast
    initial[V : V + 3] = 0.1 if alignment.still else 3.0 if known else 30.0
    x = np.zeros(n + 1)
    x[0:4] = alignment.q_nb
    x[4:7] = velocity if known else 0.0
    x[7:10] = place if np.isfinite(place).all() else site.lla
    x[10:13] = alignment.gyro_bias
    memory: Any = Memory.nans()
    memory.count = memory.jerky = memory.shaky = 0.0
    memory.step_b[:] = memory.shock_b[:] = 0.0
    memory.good = True
    restart = np.array(initial)
    restart[PHI : PHI + 3], restart[V : V + 3] = 0.5, 10.0
    groups = _groups(n)
    return Start(
        parameters=_parameters(n, walks, groups, settings, site, sensors),
        memory=memory,
        x=x,
        P=np.diag(initial**2),
        P_restart=np.diag(restart**2),
        changed=9,
        read=min(n, HI),
        groups=groups,
        magnetic=_magnetic(groups),
    )


def _groups(n: int) -> tuple[Group, ...]:
    groups = []
    for aid in GROUPED:
        start, rows = Readings.dtype.fields[aid.NAME][1] // 8, aid.Readings.dtype.itemsize // 8  # type: ignore[index]
        first, end = aid.reads(n)
        groups.append(Group(start, rows, first, end, True))
    return tuple(groups)


def _magnetic(groups: tuple[Group, ...]) -> tuple[int, int, int]:
    start = groups[GROUPED.index(field)].start
    return start, start + 1, 2  # reported where nothing else is


def _sigmas(
    n: int, use_gnss: bool, settings: Mapping[str, Any], site: Site, sensors: SensorInfo
) -> tuple[np.ndarray, np.ndarray]:
    """First sigmas (n,) of what the alignment does not know; variance per second (LARGEST - 9,) of the constants."""
    horizontal, walk = math.hypot(site.mag_n[0], site.mag_n[1]), settings["bias_time"]
    initial, walks = np.zeros(n), np.zeros(LARGEST - 9)
    walks[0:3] = 2.0 * sensors.gyro_instability**2 / walk + 1e-14
    walks[3:6] = 2.0 * (0.1 * sensors.accel_bias) ** 2 / walk + 1e-12
    initial[P_ : P_ + 3] = 100.0 if use_gnss else 1.0
    initial[BA : BA + 3] = math.hypot(sensors.accel_bias, sensors.accel_scale * site.gravity, 1e-3)
    if n > SG:
        initial[SG : SG + 3] = max(sensors.gyro_scale, 1e-5)
        initial[HI : HI + 3] = max(sensors.mag_bias, 1e-4 * horizontal)
        walks[SG - 9 : SG - 6] = 1e-12
        walks[HI - 9 : HI - 6] = (1e-3 * horizontal) ** 2 / 100.0
    if n > WIND:
        initial[WIND : WIND + 2], initial[WIND + 2] = 8.0, 0.5
        walks[WIND - 9 : WIND - 7], walks[WIND - 7] = settings["wind_walk"] ** 2, (0.3 * settings["wind_walk"]) ** 2
    return initial, walks


def _parameters(
    n: int,
    walks: np.ndarray,
    groups: tuple[Group, ...],
    settings: Mapping[str, Any],
    site: Site,
    sensors: SensorInfo,
) -> Any:
    use_gnss, use_air = "gnss" in settings["aiding"], "airspeed" in settings["aiding"]
    gyro = sensors.gyro_noise**2 / 2.0  # single-sided density d: variance d^2/2 per second
    accel = sensors.accel_noise**2 / 2.0
    wind_in_velocity = settings["wind_walk"] ** 2 if use_air and not use_gnss else 0.0
    place = use_gnss * sensors.gnss_pos**2 * UP_SHARE
    wander = 2.0 / settings["position_time"] * place
    turn = settings["turn_share"]
    gyro_along = 0.0 if n > SG else sensors.gyro_scale_factor
    force = 2.0 * settings["scale_time"] * (settings["force_share"] * sensors.accel_scale) ** 2
    still_rate, still_force = limits(sensors)
    unused = [0] * (GROUPS - len(groups))
    return Parameters.of(
        states=n,
        gravity=site.gravity,
        origin=site.lla,
        mag_n=site.mag_n,
        antenna_b=sensors.antenna_b,
        gyro_psd=gyro + settings["gyro_noise"] ** 2 / 2.0,
        rate_noise=2.0 * settings["scale_time"] * (settings["scale_share"] * sensors.gyro_scale) ** 2,
        accel_psd=accel + settings["accel_noise"] ** 2 / 2.0 + wind_in_velocity,
        accel_noise2=settings["accel_share"] ** 2 / 2.0 + force,
        shake_share=settings["shake_share"],
        shake_most=settings["shake_most"] ** 2 / 2.0,
        # what the gyro's misalignment tilts in a turn goes for a bias of the accelerometer
        beside2=(turn * np.array([sensors.gyro_misalignment, sensors.gyro_misalignment + sensors.accel_misalignment]))
        ** 2,
        along2=(turn * np.array([gyro_along, sensors.accel_scale_factor])) ** 2,
        jerk_share=settings["jerk_share"],
        walks=walks,
        still_rate=still_rate,
        still_force=still_force,
        place_walk=1e-6 + wander,
        place_wander=place,
        speed_min=settings["speed_min"],
        report_place=use_gnss,
        start=[group.start for group in groups] + unused,
        rows=[group.rows for group in groups] + unused,
        angle=[int(aid.ANGLE) for aid in GROUPED] + unused,
        **{aid.NAME: aid.parameters(settings, site, sensors).data for aid in AIDS},
    )
