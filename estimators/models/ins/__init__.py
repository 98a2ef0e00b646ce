"""One aided inertial navigator; only its velocity aid changes.

Raw state: `q_nb` (4), velocity NED (3, m/s), latitude, longitude (rad), height (m), gyro bias (3, rad/s), accelerometer
bias (3, m/s2), gyro scale (3), hard iron (3, T), wind NED (3, m/s). Error state in that order, the attitude error phi
in navigation axes, `q = exp_q(phi) (x) q_estimated`, and the position error in metres NED. Three sizes: 15
(to the accelerometer bias), 21 (to the hard iron), 24 (with the wind).

    q'   = gyro corrected, minus Earth and transport rate
    v'   = C_nb (accel - bias) + g - (2 w_ie + w_en) x v
    phi' = -C_nb (d bias + diag(w) d scale),   d v' = -[C_nb f] x phi - C_nb d bias,   d p' = d v

Aids (`aids`, a file each):

    GNSS       velocity and position, differenced with the state kept from the time of the fix (latency)
    still      v = 0 and gyro = bias while a second without scatter says so
    pseudo     hand-held: v = 0 within 1 m/s and p = start within 1 m, ten times a second: replaces an inertial low-pass
    magnetic   heading only (tilt columns zero, for every filter: a disturbed field must not tilt the horizon); norm and
               dip away from the local field inflate the noise; one that motion contradicts is given up (`turned`)
    heading    dual-antenna baseline, also with latency
    airspeed   C_bn (v - wind) = V (cos i, 0, sin i), i the incidence of cruise, wide across; without GNSS v itself is
               the velocity in the air mass

Noise stands for what the model lacks, by the data sheet. What misalignment makes of a turn acts as a bias while it
lasts: the biases of gyro and accelerometer become uncertain by that with each change of the mean rate and force of a
second (`turn_share`). What is left of scale errors is noise that grows with rate and acceleration, and what is too
fast for the sampling is noise by its own scatter, of the gyro (after a hard landing the heading is open again) and,
bounded, of the accelerometer (vibration). Most of a fix's error wanders over a minute; so does the place that is
estimated, which leaves the noise from fix to fix to the measurement. Field and baseline count once in a while,
whatever their rates: errors of theirs are of the attitude and of the minute, not of the reading.
"""

from estimators.models.ins.kernels import Inputs as Inputs
from estimators.models.ins.kernels import Memory as Memory
from estimators.models.ins.kernels import Parameters as Parameters
from estimators.models.ins.kernels import Readings as Readings
from estimators.models.ins.kernels import Used as Used
from estimators.models.ins.kernels import measure as measure
from estimators.models.ins.kernels import measurement_noise as measurement_noise
from estimators.models.ins.kernels import observe as observe
from estimators.models.ins.kernels import report as report
from estimators.models.ins.kernels import residual as residual
from estimators.models.ins.kernels import slope as slope
from estimators.models.ins.layout import State as State
from estimators.models.ins.mechanisation import constrain as constrain
from estimators.models.ins.mechanisation import difference as difference
from estimators.models.ins.mechanisation import load as load
from estimators.models.ins.mechanisation import process_noise as process_noise
from estimators.models.ins.mechanisation import propagate as propagate
from estimators.models.ins.mechanisation import retract as retract
from estimators.models.ins.mechanisation import transition as transition
from estimators.models.ins.start import SETTINGS as SETTINGS
from estimators.models.ins.start import build as build
from estimators.models.ins.start import layout as layout
from estimators.turned import NOTES as NOTES
