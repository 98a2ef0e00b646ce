"""Recordings of others: what their topics mean, and their measurements as the records of a sensor suite.

sources     any file (MCAP, db3, ULog, DataFlash, CSV) as topics of standard messages
frames      FLU and FRD, ENU and NED
mapping     the user's map and the choice of topics
convert     messages -> records, in order of their stamps
survey        one look at everything, as means over a tenth of a second
inertial      IMU against GNSS velocity, over some seconds each
checks        what contradicts the conventions assumed
calibration   gyro bias, hard and soft iron, and whether they help
installation  delays, lever arm, boresight, orientation, scale
recording   all of it put together, for a replay
"""
