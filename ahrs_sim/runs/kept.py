"""Flights flown once for many settings of an estimator: each worker keeps the truth and what the sensors sent.

The estimator's settings change neither. What is measured is what `pool.fly` measures, bit for bit; a flight on an
estimate instead of the truth is flown anew.
"""

import json
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim import plugins
from ahrs_sim.chain import Chain, site
from ahrs_sim.errors import AhrsSimError, FlightError, InputError
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.evaluation.decimate import RowDecimator
from ahrs_sim.flight import BLOCK_S, open_flight
from ahrs_sim.runs import pool
from ahrs_sim.runs.pool import Outcome, Run
from ahrs_sim.scenario import Scenario, create_estimator
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.faults import check_suites
from estimators.types import Samples, SensorInfo, Site

MOST = 24
"""Flights that a worker keeps, some 40 MB each for ten minutes at 100 Hz."""

TruthRows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Kept:
    """A flight without estimators: truth as it is compared, and samples of one suite, in blocks of `BLOCK_S`."""

    place: Site
    sensors: SensorInfo
    blocks: list[tuple[TruthRows, Samples]]
    error: str | None


_kept: OrderedDict[str, Kept] = OrderedDict()


def fly(run: Run) -> Outcome:
    """Evaluate the one estimator of a run, as `pool.fly` does, on a flight that is flown only once."""
    try:
        scenario = run.scenario()
        if scenario.pilot_attitude != "truth" or run.log or run.spans or len(scenario.estimators) != 1:
            return pool.fly(run)
        return Outcome(run.key, _evaluated(scenario, _flight(scenario, run.data), run.band_s))
    except FlightError as error:
        return Outcome(run.key, error=str(error))
    except AhrsSimError as error:
        return Outcome(run.key, error=str(error), bad_input=isinstance(error, InputError))
    except Exception as error:  # one run must not end the others, whatever it has found
        return Outcome(run.key, error=f"{type(error).__name__}: {error}")


def _flight(scenario: Scenario, data: Mapping[str, Any]) -> Kept:
    suite = str(scenario.estimators[0].settings["suite"])
    key = json.dumps([scenario.where, suite, {k: v for k, v in data.items() if k != "estimator"}], default=str)
    if key not in _kept:
        _kept[key] = _flown(scenario, suite)
        if len(_kept) > MOST:
            _kept.popitem(last=False)
    _kept.move_to_end(key)
    return _kept[key]


def _flown(scenario: Scenario, name: str) -> Kept:
    """Fly and measure."""
    check_suites(scenario.faults, [s.name for s in scenario.suites])
    flight = open_flight(scenario)
    place = site(flight.start_lla, scenario.epoch)
    (component,) = (s for s in scenario.suites if s.name == name)
    suite = make_suite(component, seed=scenario.seed, dt=flight.dt, epoch=scenario.epoch,
                       start_lla=np.array(place.lla), faults=scenario.faults)  # fmt: skip
    chain, compared = Chain(suite, {}), RowDecimator(scenario.rate / scenario.truth_rate)
    blocks = []
    while len(truth := flight.fly(max(1, round(BLOCK_S * scenario.rate)))):
        rows = compared.rows(len(truth))
        seen = truth.t[rows], truth.q_nb[rows], truth.vel_n[rows], truth.on_ground[rows]
        blocks.append((seen, chain.assemble(chain.sense(truth))))
    return Kept(place, suite.info, blocks, flight.error)


def _evaluated(scenario: Scenario, kept: Kept, band_s: float | None) -> dict[str, dict[str, Any]]:
    (component,) = scenario.estimators
    made = create_estimator(component, kept.place, kept.sensors)
    accuracy = Accuracy([component.name], with_consistency=band_s is not None)
    for truth, samples in kept.blocks:
        accuracy.add_truth(*truth)
        accuracy.add_estimates(component.name, made.process(samples))
    if kept.error:
        raise FlightError(f"{scenario.where}: {kept.error}")
    if failed := plugins.failures([made]):
        raise FlightError(f"{scenario.where}: {failed}")
    result = accuracy.result(band_s=band_s)
    return {name: pool.flat(values) for name, values in result["estimators"].items()}
