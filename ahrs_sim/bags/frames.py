"""Old place of `ahrs_sim.recordings.frames`."""

from ahrs_sim.recordings.frames import *  # noqa: F403
