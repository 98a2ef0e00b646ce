"""Central difference Kalman filter, second order (DD2: Norgaard, Poulsen and Ravn 2000; paper 000, ref. [3]).

2n+1 points at the interval h (sqrt(3) is best for a Gaussian), from Stirling's interpolation; with the pairs of
`points`:

    mean        w0 f(0) + sum wi (f(+) + f(-)),  w0 = (h^2-n)/h^2, wi = 1/(2h^2)   = f(0) + sum s_i/(2h^2)
    covariance  sum d_i d_i^T/(4 h^2) + (h^2-1)/(4 h^4) s_i s_i^T
"""

from typing import Any, NamedTuple

from estimators.filters.points import predict_points, project_points
from estimators.generic import register


class Cdkf(NamedTuple):
    """Parameter: the interval of the central differences."""

    h: float = 3.0**0.5


def rule_of(method: Any, n: int) -> tuple[float, float, float]:
    """`rule` of `points`."""
    h2 = method.h * method.h
    return method.h, (h2 - 1.0) / (4.0 * h2 * h2), 0.0


register(Cdkf, predict=predict_points, project=project_points, rule=rule_of)
