"""Consistency of a filter: whether its errors and innovations have the size that its covariances claim.

Normalised estimation error squared (NEES) and normalised innovation squared (NIS) of a consistent filter follow a
chi-square law with as many degrees of freedom as there are components (Bar-Shalom, Li, Kirubarajan 2001, section 5.4).
Divided by those degrees they have mean 1: above, a filter is overconfident, below, too cautious. Innovations are white,
so that sums over time obey the law too; estimation errors are not, so that NEES may be averaged over runs only.
"""

import math

import numpy as np

from ahrs_sim import attitude

FREEDOM = 3
"""Degrees of freedom of an attitude error."""


def chi_square_bounds(freedom: np.ndarray | float, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Compute lower and upper bound of a chi-square variable, each of the shape of `freedom`.

    Args:
        freedom: degrees of freedom; NaN where not positive.
        probability: of lying between the bounds, the rest halved.
    """
    from scipy.special import gammaincinv  # half a second that only reports need

    k = np.asarray(freedom, dtype=float)
    tail = 0.5 * (1.0 - probability)
    with np.errstate(invalid="ignore"):
        half = np.where(k > 0, 0.5 * k, np.nan)
        return 2.0 * gammaincinv(half, tail), 2.0 * gammaincinv(half, 1.0 - tail)


def mean_bounds(freedom: int, count: np.ndarray | float, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Compute bounds of the mean of `count` independent chi-square values of `freedom` degrees, divided by `freedom`.

    For the NEES averaged over the runs of a campaign: 1 is what a consistent filter has.
    """
    total = freedom * np.asarray(count, dtype=float)
    low, high = chi_square_bounds(total, probability)
    return low / total, high / total


def rotation_error(q_nb: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Compute the error as rotation vectors r (n, 3) rad in body axes: q_nb = q_ref (x) exp(r)."""
    return attitude.rotation_vector(reference, q_nb)


def nees(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Compute the normalised estimation error squared e' P^-1 e (n,).

    Args:
        error: (n, k).
        covariance: (n, k, k), same units squared.

    Returns:
        NaN where a number is missing or the covariance is not positive definite.
    """
    result = np.full(len(error), np.nan)
    good = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    rows = np.flatnonzero(good)
    # Leading minors instead of a Cholesky, which would refuse all rows for a single bad one.
    definite = np.ones(len(rows), bool)
    p = covariance[rows].astype(float)
    for k in range(1, error.shape[1] + 1):
        definite &= np.linalg.det(p[:, :k, :k]) > 0
    rows, p = rows[definite], p[definite]
    e = error[rows].astype(float)
    result[rows] = np.einsum("ni,ni->n", e, np.linalg.solve(p, e[:, :, None])[:, :, 0])
    return result


def attitude_nees(q_nb: np.ndarray, att_cov: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Compute the NEES (n,) of attitudes: three degrees of freedom; NaN without heading or covariance.

    Args:
        q_nb, reference: (n, 4).
        att_cov: (n, 3, 3) rad2, of the small rotation in body axes.
    """
    return nees(rotation_error(q_nb, reference), att_cov)


def nis(innovation: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the normalised innovation squared and its degrees of freedom, (n,) each; unused components are NaN.

    Args:
        innovation: (n, m), decorrelated.
        variance: (n, m), of its components.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = innovation.astype(float) ** 2 / variance
    used = np.isfinite(ratio) & (variance > 0)
    return np.where(used, ratio, 0.0).sum(axis=1), used.sum(axis=1)


def euler_sigma(q_nb: np.ndarray, att_cov: np.ndarray) -> np.ndarray:
    """Compute one sigma (n, 3) rad of roll, pitch and heading from the covariance of a small rotation in body axes.

    To first order; near a pitch of 90 deg roll and heading are not separate and their sigmas grow without bound.
    """
    roll, pitch, _ = attitude.euler(q_nb).T
    sr, cr, cp = np.sin(roll), np.cos(roll), np.cos(pitch)
    with np.errstate(divide="ignore", invalid="ignore"):
        tp, ip = np.tan(pitch), 1.0 / cp
    zero, one = np.zeros_like(roll), np.ones_like(roll)
    rows = [[one, sr * tp, cr * tp], [zero, cr, -sr], [zero, sr * ip, cr * ip]]
    jacobian = np.moveaxis(np.array(rows), 2, 0)  # (n, 3, 3): Euler angles by body rotation
    variance = np.einsum("nij,njk,nik->ni", jacobian, att_cov, jacobian)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(variance))


def within(error: np.ndarray, sigma: np.ndarray, times: float = 3.0) -> np.ndarray:
    """Test whether all components lie inside so many sigma: (n,) 1, 0, or NaN where one is not known.

    Args:
        error: (n, k).
        sigma: (n, k), same unit.
        times: how many sigma.
    """
    with np.errstate(invalid="ignore"):
        inside: np.ndarray = np.where(np.isfinite(error + sigma), np.abs(error) <= times * sigma, np.nan).min(axis=1)
    return inside


def summary(
    nees: np.ndarray, squares: np.ndarray, freedom: np.ndarray, inside: np.ndarray | None = None
) -> dict[str, float]:
    """Summarise the consistency of an estimator over a flight.

    Args:
        nees: (n,) of the attitude, per degree of freedom (`attitude_nees` / `FREEDOM`).
        squares, freedom: (m,) NIS and its degrees of freedom, of rows or of sums over rows.
        inside: (k,) from `within`.

    Returns:
        `nees` and `nis`, means per degree of freedom (1: consistent, above: overconfident); `nees_inside`, the share of
        rows inside the 95 % bounds; `inside`, the share of rows with all Euler errors inside three sigma. NaN: unknown.
    """
    known = nees[np.isfinite(nees)]
    low, high = chi_square_bounds(FREEDOM)
    count = float(np.nansum(freedom))
    within_known = np.empty(0) if inside is None else inside[np.isfinite(inside)]
    scaled = known * FREEDOM
    return {
        "nees": float(np.mean(known, dtype=float)) if len(known) else math.nan,
        "nees_inside": float(np.mean((scaled >= low) & (scaled <= high))) if len(known) else math.nan,
        "nis": float(np.nansum(squares, dtype=float)) / count if count else math.nan,
        "inside": float(np.mean(within_known)) if len(within_known) else math.nan,
    }
