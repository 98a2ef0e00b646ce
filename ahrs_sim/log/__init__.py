"""Logs of flights: ROS 2 bags in MCAP, written and read a column at a time.

    mcap/           the MCAP library: writer, reader, recovery; the only part that imports mcap
    messages        the types of message
    topics          which column of a flight lives in which topic
    flight_log      FlightLog: a flight in, file out
    flight_reader   FlightReader: the flight back out of its file
    info            what is in a log
    live            the messages over WebSocket while they are written

Log time is when a message arrived, the header's stamp when its content was true; both in ns since 1970.
"""
