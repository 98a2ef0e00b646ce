"""Old name of `ahrs_sim.recordings`, kept for scripts that import `ahrs_sim.bags.frames`."""
