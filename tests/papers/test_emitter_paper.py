import json
import math

import numpy as np
import pytest

from ahrs_sim import papers
from ahrs_sim.errors import InputError
from ahrs_sim.papers import Claim, Outcome, Reproduction, outcome_of
from ahrs_sim.papers.emitter import Experiment, bound, bound_times, heading_cost, locate_all, time_below
from estimators.models.emitter import Emitter, look, look_noise

RUNS = 40


def test_bound_is_the_numerical_fisher_information():
    """The covariance of the score, drawn from noise, is the information matrix."""
    experiment = Experiment(duration=10.0, coarse_deg=5.0)
    model, target, u = Emitter.make(), np.array(experiment.emitter), experiment.inputs()
    random = np.random.default_rng(0)

    def predict(x, constant):
        y = np.empty((len(u), 2))
        for k, row in enumerate(u):
            look(model, x, row, y[k], np.empty((2, 2)))
        y[:, 0] += constant
        return y

    roots = []
    for row in u:
        S = np.zeros((2, 2))
        look_noise(model, target, row, S)
        S[0, 1] = S[1, 0]
        roots.append(np.linalg.inv(np.linalg.cholesky(S)))
    truth = predict(target, 0.0)
    draws = 4000
    noise = random.standard_normal((draws, len(u), 2))  # whitened: the score needs whitened slopes only
    whitened = []
    for dx, dy, dc in ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1e-3)):
        d = np.array([dx, dy])
        difference = (predict(target + d, dc) - predict(target - d, -dc)) / (2 * (dx + dy + dc))
        whitened.append([L @ row for L, row in zip(roots, difference, strict=True)])
    assert np.isfinite(truth).all()
    score = np.einsum("pkm,dkm->dp", np.array(whitened), noise)
    across = np.array([-0.8, 0.6, 0.0]) / 1e5
    prior = (random.standard_normal(draws) / math.radians(5))[:, None] * across
    information = np.cov((score + prior).T)
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    expected = math.sqrt(covariance[0, 0] + covariance[1, 1]) / experiment.ranges()[-1]
    assert bound(experiment)[-1] == pytest.approx(expected, rel=0.1)


def test_bounds_are_ordered():
    both, rate = bound(Experiment()), bound(Experiment(measured="rate"))
    known = bound(Experiment(), ambiguous=False)
    assert np.all(both <= rate * (1 + 1e-6)) and np.all(known <= both * (1 + 1e-6))
    np.testing.assert_allclose(bound(Experiment(measured="rate"), ambiguous=False), rate, rtol=1e-6)
    assert np.all(np.diff(both) < 0)


@pytest.mark.parametrize("measured", ["both", "phase", "rate"])
def test_rms_is_not_below_the_bound(measured):
    experiment = Experiment(measured=measured)
    rms = locate_all(experiment, RUNS).rms()
    margin = 1 - 3 / math.sqrt(4 * RUNS)  # three sigma of an RMS of so many runs, two axes each
    assert np.all(rms >= margin * bound(experiment))


def test_phase_alone_needs_the_rate_of_its_first_look():
    """The paper's 30, 33, 34 s lie below the bound even for a perfect own ship, if no look has a phase rate."""
    noise = [(phase, 0.5) for phase in (10.0, 20.0, 30.0, 40.0)]
    assert bound_times("phase", noise) == [26.0, 31.5, 35.5, 38.5]
    assert bound_times("phase", noise, own_ship=False) == [19.5, 23.5, 26.5, 29.0]
    assert bound_times("phase", noise, rate_looks=0) == [27.5, 34.5, 40.5, 45.0]
    assert bound_times("phase", noise, own_ship=False, rate_looks=0) == [26.0, 34.0, 40.0, 44.5]


def test_locates_in_the_paper_s_time():
    assert 14 <= locate_all(Experiment(phase_rate_deg=0.5), RUNS).time() <= 24


def test_noise_does_not_depend_on_the_number_of_runs():
    few, more = locate_all(Experiment(), 2), locate_all(Experiment(), 3)
    np.testing.assert_array_equal(few.error, more.error[:2])


def test_time_below():
    t = np.arange(5.0)
    assert time_below(t, np.array([0.1, 0.04, 0.06, 0.04, 0.03])) == 3
    assert time_below(t, np.zeros(5)) == 0
    assert math.isnan(time_below(t, np.full(5, math.nan)))


def test_heading_cost_grows_with_the_error():
    t = np.arange(0, 300, 0.1)
    wave = np.sin(2 * math.pi * t / 90)

    def cost(heading_error, **settings):
        return heading_cost(t, heading_error, runs=5, experiment=Experiment(duration=20.0), **settings)

    costs = [cost(math.radians(a) * wave) for a in (0.0, 0.5, 2.0)]
    assert costs[0].error == pytest.approx(costs[0].ideal)
    assert costs[0].error < costs[1].error < costs[2].error
    assert costs[1].heading_deg == pytest.approx(0.354, rel=0.1)
    wrapped = np.remainder(math.radians(0.5) * wave, 2 * math.pi)
    assert cost(wrapped).error == pytest.approx(costs[1].error, rel=1e-6)
    explicit = cost(math.radians(0.5) * wave, rate_error=0 * t)
    assert explicit.rate_deg == 0.0 and explicit.error < costs[1].error


def test_heading_cost_of_too_little():
    with pytest.raises(InputError, match="60 s"):
        heading_cost(np.arange(50.0), np.zeros(50))
    with pytest.raises(InputError, match="one length"):
        heading_cost(np.arange(50.0), np.zeros(49))
    t = np.arange(100.0)
    with pytest.raises(InputError, match="60 s"):
        heading_cost(t, np.where(t > 50, math.nan, 0.0))


@pytest.mark.long
def test_reproduction():
    result = papers.run("emitter", quick=True)
    flown = [claim.what for claim in result.claims if claim.what.startswith("Flown at 270 m/s")]
    errors = [float(what.split("RMS ")[1].split()[0]) for what in flown]
    assert len(errors) == 5 and errors[0] > 3 * errors[1], "the paper's filter trusts the turns before"
    assert max(errors[2:]) < 2.5, "a navigator does not"
    text = result.text()
    assert "Table 1" in text and "Cramer-Rao" in text and all(len(line) < 180 for line in text.splitlines())
    json.loads(json.dumps(result.as_json(), allow_nan=False))
    for claim in result.claims:
        assert claim.outcome in (Outcome.REPRODUCED, Outcome.OWN) or claim.reason


def test_papers():
    assert "emitter" in papers.names() and papers.title("emitter")
    with pytest.raises(InputError, match="did you mean 'emitter'"):
        papers.run("emiter")


def test_outcome_of():
    assert outcome_of(20.0, 22.0) == Outcome.REPRODUCED
    assert outcome_of(20.0, 10.0) == Outcome.BETTER
    assert outcome_of(20.0, 30.0) == Outcome.NOT
    assert outcome_of(20.0, math.nan) == Outcome.NOT
    assert outcome_of(math.nan, 5.0) == Outcome.BETTER
    assert outcome_of(math.nan, math.nan) == Outcome.REPRODUCED


def test_rendering():
    claims = [
        Claim("a", 1.0, math.nan, "s", Outcome.NOT, "because", 3),
        Claim("b", "falls", "3 2 1", "%", Outcome.REPRODUCED),
        Claim("c", None, 0.123456, "%", reason="because"),
    ]
    result = Reproduction("x", "title", "source", "conditions", claims)
    lines = result.text().splitlines()
    assert lines[0] == "x: title" and lines[-1] == "[1] because"
    assert any("failed" in line and "not reproduced [1]" in line for line in lines)
    assert any("0.123" in line and "beyond the paper [1]" in line for line in lines)
    assert result.as_json()["claims"][0]["ours"] == "failed"
    lines = result.markdown().splitlines()
    assert lines[0] == "## x" and lines[-1] == "1. because"
    assert "| a | 1 | failed | s | 3 | not reproduced [1] |" in lines
