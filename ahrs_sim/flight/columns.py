"""What is read from JSBSim after every step: a raw row in its units, whose columns have names.

airspeed = row[Column.AIRSPEED] * Column.AIRSPEED.factor     # m/s
"""

from enum import IntEnum

import numpy as np

FT = 0.3048  # m
INCH = 0.0254  # m
PSF = 47.88025898033584  # Pa
RANKINE = 5.0 / 9.0  # K


class Column(IntEnum):
    """Columns of a raw row: property and factor to SI of each."""

    source: str
    factor: float

    def __new__(cls, source: str, factor: float) -> "Column":
        """Number the columns in the order below."""
        number = len(cls.__members__)
        member = int.__new__(cls, number)
        member._value_ = number
        member.source, member.factor = source, factor
        return member

    LATITUDE = "position/lat-geod-rad", 1.0
    LONGITUDE = "position/long-gc-rad", 1.0
    HEIGHT = "position/geod-alt-ft", FT  # above the ellipsoid
    VEL_NORTH = "velocities/v-north-fps", FT
    VEL_EAST = "velocities/v-east-fps", FT
    VEL_DOWN = "velocities/v-down-fps", FT
    ROLL = "attitude/phi-rad", 0.5  # half angles: what the quaternion needs
    PITCH = "attitude/theta-rad", 0.5
    HEADING = "attitude/psi-rad", 0.5
    ROLL_RATE = "velocities/pi-rad_sec", 1.0
    PITCH_RATE = "velocities/qi-rad_sec", 1.0
    YAW_RATE = "velocities/ri-rad_sec", 1.0
    ROLL_ACCELERATION = "accelerations/pidot-rad_sec2", 1.0
    PITCH_ACCELERATION = "accelerations/qidot-rad_sec2", 1.0
    YAW_ACCELERATION = "accelerations/ridot-rad_sec2", 1.0
    FORCE_X = "forces/fbx-total-lbs", FT  # lbf / slug = ft/s2
    FORCE_Y = "forces/fby-total-lbs", FT
    FORCE_Z = "forces/fbz-total-lbs", FT
    CG_X = "inertia/cg-x-in", -INCH  # structural axes are aft, right, up
    CG_Y = "inertia/cg-y-in", INCH
    CG_Z = "inertia/cg-z-in", -INCH
    WIND_NORTH = "atmosphere/total-wind-north-fps", FT
    WIND_EAST = "atmosphere/total-wind-east-fps", FT
    WIND_DOWN = "atmosphere/total-wind-down-fps", FT
    MASS = "inertia/mass-slugs", 1.0
    AIRSPEED = "velocities/vt-fps", FT
    ALPHA = "aero/alpha-rad", 1.0
    BETA = "aero/beta-rad", 1.0
    PRESSURE = "atmosphere/P-psf", PSF
    TEMPERATURE = "atmosphere/T-R", RANKINE
    HEIGHT_AGL = "position/h-agl-ft", FT
    WHEELS = "gear/wow", 1.0  # above 0: weight on them
    RPM = "propulsion/engine/propeller-rpm", 1.0
    THROTTLE = "fcs/throttle-pos-norm", 1.0
    HELD = "forces/hold-down", 1.0  # above 0: a rocket is held on its pad, by a force that is not in FORCE


def _span(first: Column, last: Column) -> slice:
    return slice(first, last + 1)


PLACE = _span(Column.LATITUDE, Column.HEIGHT)
VELOCITY = _span(Column.VEL_NORTH, Column.VEL_DOWN)
EULER_ANGLES = _span(Column.ROLL, Column.HEADING)
RATES = _span(Column.ROLL_RATE, Column.YAW_RATE)
ANGULAR_ACCELERATION = _span(Column.ROLL_ACCELERATION, Column.YAW_ACCELERATION)
FORCE = _span(Column.FORCE_X, Column.FORCE_Z)
CENTRE_OF_GRAVITY = _span(Column.CG_X, Column.CG_Z)
WIND = _span(Column.WIND_NORTH, Column.WIND_DOWN)

SCALE = np.array([column.factor for column in Column])
"""Factors to SI (columns,)."""

OPTIONAL = (Column.RPM, Column.THROTTLE, Column.HELD)
"""What some have not (gliders and jets): 0."""
