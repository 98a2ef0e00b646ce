"""Cubature Kalman filter (Arasaratnam and Haykin 2009; Han 2013, eq. (2)-(15)).

2n points `x +- sqrt(n) S e_i` of equal weight 1/(2n), no parameter. With the pairs of `points`, h^2 = n and `f(+-) =
f(0) + (s_i +- d_i)/2`:

    mean        1/(2n) sum f(+-)                  = f(0) + sum s_i/(2n)                      eq. (5)
    covariance  1/(2n) sum f(+-) f(+-)^T - mean^2 = sum (d_i d_i^T + s_i s_i^T)/(4n) - delta delta^T     eq. (6)
"""

from collections.abc import Mapping
from typing import Any

from estimators.filters.points import USES as USES
from estimators.filters.points import Parameters
from estimators.filters.points import predict as predict
from estimators.filters.points import project as project


def make(settings: Mapping[str, Any]) -> Parameters:
    """Make the parameters; no settings."""
    return Parameters.of(growth=1.0, interval2=0.0, less=0.0, square=-1.0)
