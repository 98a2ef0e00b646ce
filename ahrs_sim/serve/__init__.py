"""A flight for a unit outside: the sensors as a maker's protocol, its answers logged as an estimator.

readings        one IMU message and what has come since the one before: what every protocol encodes
links           pseudo-terminal, TCP port, serial device
protocols/      mavlink, vectornav, sbg, ubx+nmea: readings to bytes, bytes to answers
unit            Unit: paces the stream
simulators      PX4 and ArduPilot, which take this flight as their simulator, in lockstep
book            matches answers with what was sent
timing          latency and jitter: figures and histogram
"""
