"""Messages of ROS 1, by rosbags into the form of ROS 2, which is decoded in bulk."""

import functools
from typing import Any

import numpy as np

from ahrs_sim.log import messages
from ahrs_sim.log.mcap.cdr import Definitions, decode
from ahrs_sim.recordings.sources.base import dtype_of, extra


@functools.cache
def _store() -> Any:
    types = extra("rosbags.typesys", "rosbags", "bags")
    return types.get_typestore(types.Stores.LATEST)


def to_arrays(kind: str, rows: list[tuple[int, bytes]]) -> np.ndarray:
    """Decode messages (n,) of a standard type from log time (ns) and content each.

    Raises:
        ValueError: a message is not what its type says.
    """
    store = _store()
    try:
        converted = [(time, bytes(store.ros1_to_cdr(body, kind))) for time, body in rows]
        return in_bulk(messages.definitions(kind), kind, converted)
    except Exception as error:  # rosbags raises whatever unpacking a damaged message meets
        raise ValueError(f"no {kind} of ROS 1: {error}") from None


def in_bulk(definitions: Definitions, kind: str, rows: list[tuple[int, bytes]]) -> np.ndarray:
    """Decode messages (n,) in CDR from log time (ns) and content each.

    Raises:
        CdrError: a message is not what its type says.
    """
    out: np.ndarray = np.empty(len(rows), dtype_of(kind, definitions))
    if not rows:
        return out
    out["log_time"] = [time for time, _ in rows]
    sizes = np.array([len(data) for _, data in rows])
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        payload = np.frombuffer(b"".join(rows[i][1] for i in which), np.uint8).reshape(len(which), size)
        part = np.empty(len(which), out.dtype)
        part["log_time"] = out["log_time"][which]
        decode(definitions, kind, payload, part)
        out[which] = part
    return out
