"""Fuzzy adaptation of measurement noise to its innovations, sensor by sensor (Tian 2011, section 2).

    C <- (1 - d) C + d a a^T,   d = (1 - b)/(1 - b^(k+1))                       eq. (7), (8)
    ratio = tr(C) / tr(S),   S = H P H^T + R                                     eq. (9)
    R <- W(ratio) R                                                              eq. (10)

The figure with the membership functions is lost: W is the continuous, monotone map through (0.5, 0.7), (0.7, 0.8),
(1, 1), (1.3, 1.2), (1.5, 1.3), constant outside, which meets every rule that is printed. R stays within `lowest` and
`highest` times the model's. The paper watches both sensors of one joint measurement; a filter that takes them one after
the other (groups) gives each its own innovation after the other's correction, which tells them apart still better.
"""

from typing import Any

from estimators.adaptation.base import KEPT, Sensors
from estimators.filters.work import Work
from estimators.jit import njit
from estimators.native import Number, Record
from estimators.records import Place
from estimators.settings import Setting

SETTINGS = {
    "fuzzy_memory": Setting(0.98, "fuzzy: b, forgetting of the innovations", minimum=0.9, maximum=0.9999),
    "fuzzy_lowest": Setting(0.1, "fuzzy: least share of the variance", above=0.0, maximum=1.0),
    "fuzzy_highest": Setting(1e6, "fuzzy: most, in multiples of the variance", minimum=1.0),
}


class Parameters(Record):
    """Parameters of the policy."""

    memory: Number  # b
    lowest: Number
    highest: Number


class Trust(Record, size=KEPT):
    """Holds the memory of the policy for each sensor."""

    trusted: Sensors
    factor: Sensors  # on R; 0: none yet
    smooth: Sensors  # tr(C)
    fade: Sensors  # b^(k+1)


@njit
def weight(ratio: float) -> float:
    """`W(ratio)`, of the innovation's measured to its predicted variance."""
    if ratio <= 0.7:
        return 0.7 + 0.5 * (max(ratio, 0.5) - 0.5)
    if ratio <= 1.3:
        return 1.0 + (ratio - 1.0) / 1.5
    return 1.2 + 0.5 * (min(ratio, 1.5) - 1.3)


def factor(policy: Parameters, sensor: int, first: int, end: int, trust: Trust, work: Work) -> float:
    """Adapt the factor of a sensor to its innovation."""
    share = trust.factor[sensor]
    if share == 0.0:
        share, trust.fade[sensor] = 1.0, 1.0
    measured, predicted = 0.0, 0.0
    for i in range(first, end):
        if work.used[i]:
            measured += work.residual[i] * work.residual[i]
            predicted += work.S[i, i] + share * work.noise[i, i]
    if predicted > 0.0:
        trust.fade[sensor] *= policy.memory
        new = (1.0 - policy.memory) / (1.0 - trust.fade[sensor])
        smooth = trust.smooth[sensor] + new * (measured - trust.smooth[sensor])
        trust.smooth[sensor] = smooth
        share = min(policy.highest, max(policy.lowest, share * weight(smooth / predicted)))
        trust.factor[sensor] = share
        trust.trusted[sensor] = 1.0 / share
    return float(share)


def configure(settings: Any, site: Place, policy: Parameters) -> None:
    """Set the parameters from the settings `fuzzy_*`."""
    policy.memory, policy.lowest, policy.highest = settings.fuzzy_memory, settings.fuzzy_lowest, settings.fuzzy_highest
