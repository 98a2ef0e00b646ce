"""Public names for writing a log; the writer itself is `ahrs_sim.log.mcap.writer`."""

from ahrs_sim.log.mcap.writer import LogWriter

__all__ = ["LogWriter"]
