"""Flights that are flown once for many settings: the same figures to the last bit, and how often they are flown."""

import dataclasses

import numpy as np
import pytest

from ahrs_sim import scenario
from ahrs_sim.runs import kept, pool
from ahrs_sim.runs.pool import Run


def run(**settings) -> Run:
    known = scenario.load("takeoff", seed=5, duration=70.0)
    estimator = {"it": {"method": "marg-ekf", "suite": "chr", **settings}}
    return Run(0, known.name, known.where, {**known.data, "estimator": estimator})


@pytest.mark.long
def test_figures_are_those_of_a_flight_and_it_is_flown_once(monkeypatch):
    flown = []
    once = kept._flown
    monkeypatch.setattr(kept, "_flown", lambda *a: flown.append(a) or once(*a))
    monkeypatch.setattr(kept, "_kept", type(kept._kept)())
    for settings in ({}, {"rate_noise": 0.1}):
        whole, again = pool.fly(run(**settings)), kept.fly(run(**settings))
        assert whole.error is again.error is None
        np.testing.assert_equal(again.figures, whole.figures)
    assert len(flown) == 1
    other = run()
    kept.fly(dataclasses.replace(other, data={**other.data, "seed": 6}))
    assert len(flown) == 2


def test_bad_settings_and_flights_that_fail_are_outcomes():
    assert kept.fly(run(rate_nois=1.0)).bad_input
    failing = run()
    crash = {**failing.data, "step": [{"do": "wait", "for_s": 5.0}], "duration_s": 3.0, "start": {"latitude_deg": 95.0}}
    assert kept.fly(dataclasses.replace(failing, data=crash)).error
