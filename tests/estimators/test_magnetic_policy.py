"""Magnetic disturbance rejection, on any model with a magnetometer."""

import numpy as np
import pytest
from synthetic import SITE, coordinated_turn, error_deg, matrix_bn

from estimators import Status, create

ACROSS = (-2.6e-7, 1.5e-5, 0.0)  # T: nearly east: the strength changes by 5 %, the dip by 4 deg, the needle by 33 deg


def disturbed(seconds=20.0):
    samples, truth, _ = coordinated_turn(turn_s=60.0, ground_s=10.0)
    rows = (samples.t > 30.0) & (samples.t < 30.0 + seconds)
    samples.mag_b[rows] += np.einsum("kij,j->ki", matrix_bn(truth[rows]), np.array(ACROSS))
    return samples, truth, rows


def worst_heading(name, samples, truth, rows, **settings):
    estimates = create(name, site=SITE, align_s=5.0, **settings).process(samples)
    return np.abs(error_deg(estimates.q_nb[rows], truth[rows])[2]).max(), estimates


@pytest.mark.parametrize(("name", "settings"), [("marg-ckf", {"aiding": "airspeed"}), ("akf-standard", {})])
def test_the_heading_is_kept(name, settings):
    samples, truth, rows = disturbed()
    without, _ = worst_heading(name, samples, truth, rows, **settings)
    kept, estimates = worst_heading(name, samples, truth, rows, adaptation="magnetic", **settings)
    assert without > 15.0
    if name == "marg-ckf":  # the other one is fooled by the turn itself
        assert kept < 3.0
    else:
        assert kept < 0.6 * without
    inside = rows & (samples.t > 30.1)
    assert (estimates.adaptation[inside, 1] == 0.0).all()
    assert (estimates.status[inside & samples.mag_new] == Status.COASTING).all()
    assert np.isnan(estimates.innovation[inside, 3:6]).all()


def test_it_composes_with_the_navigator():
    samples, truth, rows = disturbed()
    kept, estimates = worst_heading("air-ins", samples, truth, rows, adaptation="magnetic")
    assert kept < 3.0
    refused = estimates.adaptation[rows][:, 2] == 0.0
    assert refused[samples.t[rows] > 31.1].all()  # it looks at the field once a second


def test_what_lasts_is_believed_in_the_end():
    samples, truth, rows = disturbed(100.0)
    _, estimates = worst_heading(
        "marg-ckf", samples, truth, rows, aiding="airspeed", adaptation="magnetic", magnetic_patience=10.0
    )
    since = samples.t[rows] - 30.0
    used = estimates.adaptation[rows][:, 1]
    assert (used[(since > 1.0) & (since < 9.0)] == 0.0).all()
    assert (used[since > 12.0] == 1.0).all()
