"""Sensors: from the truth to what instruments send, and on to what an estimator sees."""

from ahrs_sim.sensors.assemble import Assembler
from ahrs_sim.sensors.suite import Suite, grades, make_suite

__all__ = ["Assembler", "Suite", "grades", "make_suite"]
