"""Settings of the navigator, and its first state."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators import adaptation
from estimators.alignment import ALIGNED, Alignment, still_limits
from estimators.elementary import hypot
from estimators.jit import inner
from estimators.models.base import GROUPS, Group, Layout
from estimators.models.ins.aids import AIDS, GROUPED, configured, field
from estimators.models.ins.aids.gnss import SETTLED, UP
from estimators.models.ins.kernels import Readings
from estimators.models.ins.layout import BA, BG, HI, LARGEST, P_, PHI, SG, WIND, State, V
from estimators.native import local
from estimators.records import Place, Sheet
from estimators.settings import Setting
from estimators.turned import begin

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

UP_SHARE = tuple(float(share / np.mean([1.0, 1.0, UP**2])) for share in (1.0, 1.0, UP**2))
"""Of the data sheet's variance, which is the mean over the axes: north, east, down."""

_NONE, _GNSS, _AIRSPEED, _BOTH = range(4)  # of the setting `aiding`


def _size(settings: Mapping[str, Any]) -> int:
    return LARGEST if settings["aiding"] == "gnss+airspeed" else int(settings["states"])


def layout(settings: Mapping[str, Any]) -> Layout:
    """Sizes of the model, and the groups of its aids."""
    n, groups = _size(settings), []
    for aid, start, rows in zip(GROUPED, _STARTS, _ROWS, strict=True):
        first, end = aid.reads(n)
        groups.append(Group(start, rows, first, end, True))
    field_ = _STARTS[GROUPED.index(field)]
    return Layout(
        raw=n + 1, size=n, changed=9, read=min(n, HI), groups=tuple(groups),
        magnetic=(field_, field_ + 1, 2),  # reported where nothing else is
    )  # fmt: skip


_STARTS = tuple(Readings.dtype.fields[aid.NAME][1] // 8 for aid in GROUPED)  # type: ignore[index]
_ROWS = tuple(aid.Readings.dtype.itemsize // 8 for aid in GROUPED)
_ANGLES = tuple(int(aid.ANGLE) for aid in GROUPED)
_configure_aids = configured(AIDS)


def build(
    settings: Any, site: Place, sensors: Sheet, alignment: Alignment, model: Any, memory: Any, x: State, P: np.ndarray,
    P_restart: np.ndarray,
) -> None:  # fmt: skip
    """Set parameters and first state from settings, place, sensors and alignment."""
    n = 15 if settings.states == 0 else 21
    n = LARGEST if settings.aiding == _BOTH else n
    _set_parameters(n, settings, site, sensors, model)
    _set_walks(n, settings, site, sensors, model)
    _configure_aids(settings, site, sensors, model)
    begin(memory.turned)
    memory.reopened = False
    memory.gnss.wait_s = 0.0 if alignment.still else SETTLED
    memory.late2 = 0.0
    memory.count = memory.jerky = memory.shaky = 0.0
    memory.good = True
    use_gnss = settings.aiding == _GNSS or settings.aiding == _BOTH
    velocity = alignment.vel_n if use_gnss else alignment.air_n
    known, placed = True, use_gnss
    for i in range(6):
        memory.gnss.off2[i] = memory.gnss.opens2[i] = 0.0
    for i in range(3):
        memory.step_b[i] = memory.shock_b[i] = memory.steady_n[i] = 0.0
        known &= math.isfinite(velocity[i])
        placed &= math.isfinite(alignment.lla[i])
    for i in range(4):
        x.q_nb[i] = alignment.q_nb[i]
    for i in range(3):
        x.vel_n[i] = velocity[i] if known else 0.0
        x.lla[i] = alignment.lla[i] if placed else site.lla[i]
        x.gyro_bias[i] = alignment.gyro_bias[i]
    sigma = local(LARGEST)
    _constants(n, use_gnss, site, sensors, sigma)
    for i in range(3):
        sigma[PHI + i], sigma[BG + i] = alignment.sigma_n[i], alignment.gyro_bias_sigma[i]
        sigma[V + i] = 3.0 if known else 30.0 if alignment.moving else 0.1
    for i in range(n):
        P[i, i] = P_restart[i, i] = sigma[i] ** 2
        model.opened[i] = sigma[i] ** 2 if i >= BG else 0.0
    for i in range(3):
        model.opened[PHI + i], model.opened[V + i] = 1.0 if i == 2 else 0.1**2, 3.0**2
        P_restart[PHI + i, PHI + i], P_restart[V + i, V + i] = 0.5**2, 10.0**2


@inner
def _constants(n: int, use_gnss: bool, site: Place, sensors: Sheet, sigma: np.ndarray) -> None:
    """First sigmas of what the alignment does not know."""
    horizontal = hypot(site.mag_n[0], site.mag_n[1])
    accel_bias = hypot(hypot(sensors.accel_bias, sensors.accel_scale * site.gravity), 1e-3)
    for i in range(3):
        sigma[P_ + i] = 100.0 if use_gnss else 1.0
        sigma[BA + i] = accel_bias
        sigma[SG + i] = max(sensors.gyro_scale, 1e-5)
        sigma[HI + i] = max(sensors.mag_bias, 1e-4 * horizontal)
        sigma[WIND + i] = 8.0 if i < 2 else 0.5


@inner
def _set_walks(n: int, settings: Any, site: Place, sensors: Sheet, model: Any) -> None:
    """Variances per second of the constants, and of the wind."""
    horizontal, walks, time = hypot(site.mag_n[0], site.mag_n[1]), model.walks, settings.bias_time
    for i in range(3):
        walks[BG - 9 + i] = 2.0 * sensors.gyro_instability**2 / time + 1e-14
        walks[BA - 9 + i] = 2.0 * (0.1 * sensors.accel_bias) ** 2 / time + 1e-12
        walks[SG - 9 + i] = 1e-12 if n > SG else 0.0
        walks[HI - 9 + i] = (1e-3 * horizontal) ** 2 / 100.0 if n > SG else 0.0
        wind = settings.wind_walk if i < 2 else 0.3 * settings.wind_walk
        walks[WIND - 9 + i] = wind**2 if n > WIND else 0.0


@inner
def _set_parameters(n: int, settings: Any, site: Place, sensors: Sheet, model: Any) -> None:
    """Set the parameters that are not of one aid."""
    use_gnss = settings.aiding == _GNSS or settings.aiding == _BOTH
    gyro = sensors.gyro_noise**2 / 2.0  # single-sided density d: variance d^2/2 per second
    accel = sensors.accel_noise**2 / 2.0
    wind_in_velocity = settings.wind_walk**2 if settings.aiding == _AIRSPEED else 0.0
    force = 2.0 * settings.scale_time * (settings.force_share * sensors.accel_scale) ** 2
    model.states, model.gravity, model.report_place = n, site.gravity, use_gnss
    for i in range(3):
        model.origin[i], model.mag_n[i], model.antenna_b[i] = site.lla[i], site.mag_n[i], sensors.antenna_b[i]
        model.place_wander[i] = sensors.gnss_pos**2 * UP_SHARE[i] if use_gnss else 0.0
        model.place_walk[i] = 1e-6 + 2.0 / settings.position_time * model.place_wander[i]
    model.gyro_psd = gyro + settings.gyro_noise**2 / 2.0
    model.rate_noise = 2.0 * settings.scale_time * (settings.scale_share * sensors.gyro_scale) ** 2
    model.accel_psd = accel + settings.accel_noise**2 / 2.0 + wind_in_velocity
    model.accel_noise2 = settings.accel_share**2 / 2.0 + force
    model.shake_share, model.shake_most = settings.shake_share, settings.shake_most**2 / 2.0
    turn, misaligned = settings.turn_share, sensors.gyro_misalignment
    # what the gyro's misalignment tilts in a turn goes for a bias of the accelerometer
    model.beside2[0], model.beside2[1] = (
        (turn * misaligned) ** 2,
        (turn * (misaligned + sensors.accel_misalignment)) ** 2,
    )
    model.along2[0] = 0.0 if n > SG else (turn * sensors.gyro_scale_factor) ** 2
    model.along2[1] = (turn * sensors.accel_scale_factor) ** 2
    model.velocity = max(settings.velocity_share * sensors.gnss_vel, 1e-3)
    model.jerk_share, model.speed_min = settings.jerk_share, settings.speed_min
    model.still_rate, model.still_force = still_limits(sensors)
    for g in range(GROUPS):
        model.start[g] = model.rows[g] = model.angle[g] = 0
    for g in range(len(_STARTS)):
        model.start[g], model.rows[g], model.angle[g] = _STARTS[g], _ROWS[g], _ANGLES[g]
