"""Old place of `ahrs_sim.recordings.frames`, with the rotations that are in `ahrs_sim.attitude` now."""

from ahrs_sim.attitude import euler_of as euler_of
from ahrs_sim.attitude import from_euler as from_euler
from ahrs_sim.attitude import product as product
from ahrs_sim.attitude import to_nav as rotate  # noqa: F401
from ahrs_sim.recordings.frames import *  # noqa: F403
