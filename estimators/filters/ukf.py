"""Unscented Kalman filter (Julier and Uhlmann 2004; Zhao 2015, eq. (14)-(26)).

2n+1 points `x, x +- h S e_i` with h^2 = n + lambda = alpha^2 (n + kappa) and weights 1/(2 h^2), lambda/h^2 at the
centre, there with 1 - alpha^2 + beta more for the covariance. With the pairs of `points` and delta = mean - f(0):

    mean        f(0) + sum s_i/(2h^2)
    covariance  sum (d_i d_i^T + s_i s_i^T)/(4h^2) + (n/h^2 - 2) delta delta^T + (lambda/h^2 + 1 - alpha^2 + beta)
                delta delta^T = sum (...) + (beta - alpha^2) delta delta^T,  as n/h^2 + lambda/h^2 = 1

On a model whose state lies on a manifold (an error quaternion behind generalised Rodrigues parameters) this is the
USQUE form: points are errors that the model retracts, and propagated points are differenced with the propagated mean.
"""

from collections.abc import Mapping
from typing import Any

from estimators.filters.points import USES as USES
from estimators.filters.points import Parameters
from estimators.filters.points import predict as predict
from estimators.filters.points import project as project
from estimators.settings import Setting

SETTINGS = {
    "alpha": Setting(1.0, "spread of the sigma points", above=0.0, maximum=2.0),
    "beta": Setting(2.0, "weight of the centre in the covariance, 2 for a Gaussian", minimum=0.0),
    "kappa": Setting(0.0, "further spread, n + kappa", minimum=0.0),
}


def make(settings: Mapping[str, Any]) -> Parameters:
    """Make the parameters from `alpha`, `beta` and `kappa`."""
    alpha, beta, kappa = (settings.get(name, setting.default) for name, setting in SETTINGS.items())
    alpha2 = alpha * alpha
    return Parameters.of(growth=alpha2, interval2=alpha2 * kappa, less=0.0, square=beta - alpha2)
