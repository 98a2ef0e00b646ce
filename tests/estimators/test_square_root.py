"""Square-root filters: the same numbers as the plain ones, and on where those end."""

import numpy as np
import pytest
from synthetic import SITE, coordinated_turn, error_deg, still

from estimators import Status, create
from estimators.filters.square_root import append_root, triangularise

PAIRS = [
    ("marg-ckf", "marg-srckf", "none"), ("marg-cdkf", "marg-srcdkf", "none"), ("marg-ukf", "marg-srukf", "none"),
    ("marg-ckf", "marg-srckf", "gate"),
]  # fmt: skip


def test_triangularise_keeps_the_product():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(7, 19))
    A[3] = 0.0  # a state without any uncertainty
    M = A @ A.T
    triangularise(A, 7, 19)
    np.testing.assert_allclose(A @ A.T, M, atol=1e-13)
    assert not np.triu(A, 1).any()


def test_the_root_of_a_singular_covariance():
    root = np.random.default_rng(2).normal(size=(5, 3))
    M, A = np.zeros((6, 6)), np.full((6, 9), np.nan)
    M[1:, 1:] = root @ root.T
    append_root(M, 6, A, 3)
    np.testing.assert_allclose(A[:, 3:] @ A[:, 3:].T, M, atol=1e-6)  # rounding's own square root


@pytest.mark.parametrize(("plain", "root", "adaptation"), PAIRS)
def test_it_equals_the_plain_form(plain, root, adaptation):
    samples, _, _ = coordinated_turn(turn_s=20.0, ground_s=5.0)
    samples.accel_b[1500:1510] = np.nan  # sensors missing, one axis too
    samples.mag_b[2000:2100, 1] = np.nan
    settings = {"site": SITE, "align_s": 3.0, "aiding": "airspeed", "adaptation": adaptation}
    a, b = (create(name, **settings).process(samples) for name in (plain, root))
    assert (a.status == b.status).all()
    for name in ("q_nb", "gyro_bias", "gyro_bias_sigma", "att_cov"):
        np.testing.assert_allclose(getattr(b, name), getattr(a, name), rtol=1e-9, atol=1e-9, err_msg=name)
    for name in ("innovation", "innovation_var"):
        found, expected = getattr(b, name)[:, :9], getattr(a, name)[:, :9]
        scale = np.nanmax(np.abs(expected), axis=0)
        np.testing.assert_allclose(found / scale, expected / scale, atol=1e-9, err_msg=name)


def test_it_goes_on_from_a_checkpoint():
    samples, _ = still(8.0)
    settings = {"site": SITE, "align_s": 3.0}
    whole = create("marg-srckf", **settings).process(samples)
    first, second = create("marg-srckf", **settings), create("marg-srckf", **settings)
    first.process(samples[:500])
    second.restore(first.state())
    np.testing.assert_array_equal(second.process(samples[500:]).q_nb, whole.q_nb[500:])


def test_it_stays_positive_where_the_plain_form_does_not():
    """The paper's P0 = 1e4 I with sensors of 1e-5: rounding takes all digits of small variances from P, not from S."""
    samples, truth = still(20.0, mag_every=1, noise=1e-3)
    settings = {
        "site": SITE, "initialisation": "paper", "noise": "practical", "accel_sigma": 1e-5, "mag_sigma": 1e-11,
        "rate_noise": 1e-6, "bias_walk": 0.0, "scale_share": 0.0,
    }  # fmt: skip
    plain, root = (create(name, **settings).process(samples) for name in ("marg-ckf", "marg-srckf"))
    assert (plain.status == Status.DIVERGED).any()
    assert (root.status == Status.RUNNING).all()
    assert (np.linalg.eigvalsh(root.att_cov) > 0.0).all()
    assert error_deg(root.q_nb[-1:], truth[-1:])[0] < 1.0
