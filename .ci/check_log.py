"""Decode every message of a log with rosbags, print their number; any trouble raises."""

import sys
from pathlib import Path

from rosbags.highlevel import AnyReader

with AnyReader([Path(sys.argv[1])]) as reader:
    count = 0
    for connection, _, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        if hasattr(message, "header") and not 631_152_000 <= message.header.stamp.sec < 4_102_444_800:
            sys.exit(f"{connection.topic}: stamp {message.header.stamp.sec} is not between 1990 and 2100")
        count += 1
    if count != reader.message_count:
        sys.exit(f"{count} messages of {reader.message_count}")
    sys.stdout.write(f"{count}\n")
