"""Public names for reading a log of any origin; the reader itself is `ahrs_sim.log.mcap.reader`."""

from ahrs_sim.log.mcap.reader import LogReader, quaternion, stamps, vector

__all__ = ["LogReader", "quaternion", "stamps", "vector"]
