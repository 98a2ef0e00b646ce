"""Central difference Kalman filter, second order (DD2: Norgaard, Poulsen and Ravn 2000).

2n+1 points at the interval h (sqrt(3) is best for a Gaussian), from Stirling's interpolation; with the pairs of
`points`:

    mean        w0 f(0) + sum wi (f(+) + f(-)),  w0 = (h^2-n)/h^2, wi = 1/(2h^2)   = f(0) + sum s_i/(2h^2)
    covariance  sum d_i d_i^T/(4 h^2) + (h^2-1)/(4 h^4) s_i s_i^T
"""

from collections.abc import Mapping
from typing import Any

from estimators.filters.points import USES as USES
from estimators.filters.points import Parameters
from estimators.filters.points import predict as predict
from estimators.filters.points import project as project
from estimators.settings import Setting

SETTINGS = {"h": Setting(3.0**0.5, "interval of the central differences", minimum=1.0)}


def make(settings: Mapping[str, Any]) -> Parameters:
    """Make the parameters from the interval `h`."""
    h = settings.get("h", 3.0**0.5)
    return Parameters.of(growth=0.0, interval2=h * h, less=1.0, square=0.0)
