"""Logs of flights: ROS 2 bags in MCAP, written and read a column at a time. The only part that knows MCAP.

    messages        the types of message
    cdr             their binary form
    writer          LogWriter: columns in, file out
    reader          LogReader: any ROS 2 bag in MCAP, topics as structured arrays
    topics          which column of a flight lives in which topic
    flight_log      FlightLog: a flight in, file out
    flight_reader   FlightReader: the flight back out of its file
    recover         a log that was never finished
    info            what is in a log

Log time is when a message arrived, the header's stamp when its content was true; both in ns since 1970.
"""
