"""Recordings of others: what their topics mean, and their measurements as the records of a sensor suite.

sources     any file (MCAP, db3, ULog, DataFlash, CSV) as topics of standard messages
frames      FLU and FRD, ENU and NED
mapping     the user's map and the choice of topics
convert     messages -> records, in order of their stamps
survey      one look at everything: conventions, standing stretches, calibration
recording   all of it put together, for a replay
"""
