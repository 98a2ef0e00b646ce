"""ROS 2 bags in MCAP, written and read a column at a time: independent of aircraft.

cdr             the binary form of messages, from their definitions
container       records of the file format, written; pieces: read
writer          LogWriter: columns in, file out
reader          LogReader: any ROS 2 bag in MCAP, topics as structured arrays
recover         repairs a log that was never finished
"""
