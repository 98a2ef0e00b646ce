"""Unscented Kalman filter (Julier and Uhlmann 2004; paper 001 eq. (14)-(26)).

2n+1 points `x, x +- h S e_i` with h^2 = n + lambda = alpha^2 (n + kappa) and weights 1/(2 h^2), lambda/h^2 at the
centre, there with 1 - alpha^2 + beta more for the covariance. With the pairs of `points` and delta = mean - f(0):

    mean        f(0) + sum s_i/(2h^2)
    covariance  sum (d_i d_i^T + s_i s_i^T)/(4h^2) + (n/h^2 - 2) delta delta^T + (lambda/h^2 + 1 - alpha^2 + beta)
                delta delta^T = sum (...) + (beta - alpha^2) delta delta^T,  as n/h^2 + lambda/h^2 = 1

On a model whose state lies on a manifold (an error quaternion behind generalised Rodrigues parameters) this is the
USQUE form: points are errors that the model retracts, and propagated points are differenced with the propagated mean.
"""

from typing import Any, NamedTuple

from estimators.filters.points import predict_points, project_points
from estimators.generic import register


class Ukf(NamedTuple):
    """Parameters."""

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0


def rule_of(method: Any, n: int) -> tuple[float, float, float]:
    """`rule` of `points`."""
    alpha2 = method.alpha * method.alpha
    h2 = alpha2 * (n + method.kappa)
    return h2**0.5, 0.25 / h2, method.beta - alpha2


register(Ukf, predict=predict_points, project=project_points, rule=rule_of)
