"""Fuzzy adaptation of measurement noise to its innovations, sensor by sensor (paper 002, section 2).

    C <- (1 - d) C + d a a^T,   d = (1 - b)/(1 - b^(k+1))                       eq. (7), (8)
    ratio = tr(C) / tr(S),   S = H P H^T + R                                     eq. (9)
    R <- W(ratio) R                                                              eq. (10)

The figure with the membership functions is lost: W is the continuous, monotone map through (0.5, 0.7), (0.7, 0.8),
(1, 1), (1.3, 1.2), (1.5, 1.3), constant outside, which meets every rule that is printed. R stays within `lowest` and
`highest` times the model's. The paper watches both sensors of one joint measurement; a filter that takes them one after
the other (groups) gives each its own innovation after the other's correction, which tells them apart still better.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.adaptation.base import SENSORS
from estimators.generic import register
from estimators.jit import njit
from estimators.types import Site

_FACTOR, _SMOOTH, _FADE = SENSORS, 2 * SENSORS, 3 * SENSORS  # in `trust`: R's factor (0: none yet), tr(C), b^(k+1)


class Fuzzy(NamedTuple):
    """Parameters."""

    memory: float  # b
    lowest: float
    highest: float


@njit
def weight(ratio: float) -> float:
    """`W(ratio)`, of the innovation's measured to its predicted variance."""
    if ratio <= 0.7:
        return 0.7 + 0.5 * (max(ratio, 0.5) - 0.5)
    if ratio <= 1.3:
        return 1.0 + (ratio - 1.0) / 1.5
    return 1.2 + 0.5 * (min(ratio, 1.5) - 1.3)


def _factor(
    policy: Any,
    sensor: int,
    first: int,
    end: int,
    S: np.ndarray,
    noise: np.ndarray,
    error: np.ndarray,
    counts: np.ndarray,
    trust: np.ndarray,
    scratch: np.ndarray,
) -> float:
    share = trust[_FACTOR + sensor]
    if share == 0.0:
        share, trust[_FADE + sensor] = 1.0, 1.0
    measured, predicted = 0.0, 0.0
    for i in range(first, end):
        if counts[i]:
            measured += error[i] * error[i]
            predicted += S[i, i] + share * noise[i, i]
    if predicted > 0.0:
        trust[_FADE + sensor] *= policy.memory
        new = (1.0 - policy.memory) / (1.0 - trust[_FADE + sensor])
        smooth = trust[_SMOOTH + sensor] + new * (measured - trust[_SMOOTH + sensor])
        trust[_SMOOTH + sensor] = smooth
        share = min(policy.highest, max(policy.lowest, share * weight(smooth / predicted)))
        trust[_FACTOR + sensor] = share
        trust[sensor] = 1.0 / share
    return float(share)


register(Fuzzy, factor=_factor)


def make(settings: Mapping[str, Any], site: Site) -> Fuzzy:
    """From the settings `fuzzy_*`."""
    return Fuzzy(settings["fuzzy_memory"], settings["fuzzy_lowest"], settings["fuzzy_highest"])
