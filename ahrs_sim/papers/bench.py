"""What the reproductions of attitude papers share: truth and samples without a log, errors against the truth."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import estimators
from ahrs_sim import attitude
from ahrs_sim import scenario as scenarios
from ahrs_sim.chain import Chain, site
from ahrs_sim.evaluation import metrics
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.scenario import Scenario
from ahrs_sim.sensors import make_suite
from estimators.estimator import FilterEstimator
from estimators.rotations import turn
from estimators.types import Estimates, Samples, SensorInfo, Site


@dataclass(frozen=True)
class Flown:
    """A flight or drive without sensors."""

    scenario: Scenario
    truth: Truth
    site: Site


@dataclass(frozen=True)
class Measured:
    """Holds the sensor messages of one suite."""

    flown: Flown
    samples: Samples
    sensors: SensorInfo

    def estimate(self, method: str, **settings: Any) -> Estimates:
        """Estimate by a method of the catalogue."""
        estimates: Estimates = self.create(method, **settings).process(self.samples)
        return estimates

    def create(self, method: str, **settings: Any) -> Any:
        """Make an estimator for these samples."""
        return estimators.create(method, site=self.flown.site, sensors=self.sensors, **settings)

    def errors(self, estimates: Estimates) -> np.ndarray:
        """Compute errors (n, 5) in deg, in the order of `metrics.MEASURES`, NaN where there is no estimate."""
        truth = self.flown.truth
        reference = attitude.interpolate(truth.t, truth.q_nb, estimates.t)
        return np.asarray(np.degrees(metrics.attitude_errors(estimates.q_nb, estimates.down_b, reference)))


def fly(data: Mapping[str, Any], name: str) -> Flown:
    """Fly the truth of a scenario given as TOML data, or of the shipped one that it extends."""
    scenario = scenarios.parse(dict(data), f"papers: {name}", name)
    flight = open_flight(scenario)
    blocks = []
    while len(block := flight.fly(4000)):
        blocks.append(block)
    return Flown(scenario, Truth.concatenate(blocks), site(flight.start_lla, scenario.epoch))


def measure(flown: Flown, suite: Mapping[str, Any], seed: int, faults: Sequence[Mapping[str, Any]] = ()) -> Measured:
    """Measure with one suite (a `[suite.NAME]` table) and the errors of one seed."""
    scenario = flown.scenario
    data = {**scenario.data, "suite": {"unit": dict(suite)}, "fault": [dict(f) for f in faults]}
    data["estimator"] = {"none": {"method": "marg-ekf", "suite": "unit"}}
    with_suite = scenarios.parse(data, scenario.where, scenario.name)
    made = make_suite(
        with_suite.suites[0],
        seed=seed,
        dt=1.0 / scenario.rate,
        epoch=scenario.epoch,
        start_lla=np.array(flown.site.lla),
        faults=with_suite.faults,
    )
    chain, truth, step = Chain(made, {}), flown.truth, 4000
    blocks = [chain.assemble(chain.sense(truth[k : k + step])) for k in range(0, len(truth), step)]
    return Measured(flown, Samples.concatenate(blocks), made.info)


def rms(values: np.ndarray) -> float:
    """Root mean square of the finite ones."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else math.nan


def turned(
    estimator: FilterEstimator, samples: Samples, degrees: float, variance: float | None = None
) -> tuple[Samples, Any]:
    """Align an estimator, then turn its heading by so much and let it know how far off it may be.

    Args:
        estimator: not used before; of the catalogue.
        samples: begin at rest.
        degrees: how far to turn it.
        variance: of the first state components, instead of a heading variance of `degrees`^2 in them.

    Returns:
        The samples it has not seen and the estimator.
    """
    taken = 0
    while estimator.state()["filter"] is None:
        estimator.process(samples[taken : taken + 1])
        taken += 1
    state = estimator.state()
    x, P = state["filter"]["x"], state["filter"]["P"]
    q = np.empty(4)
    angle = math.radians(degrees)
    down = attitude.down(x[None, :4])[0]  # a turn about the vertical is one about `down` in body axes
    turn(x[:4], *(angle * down), q)
    x[:4] = q
    elements = len(P) == len(x)  # errors are those of q's elements; else of a rotation, one component less than x
    widened = _widened(P, x[:4], down, angle, elements)
    if variance is not None:
        rank = 4 if elements else 3
        widened = P.copy()
        widened[:rank, :rank] = variance * np.eye(rank)
    state["filter"]["P"] = widened
    estimator.restore(state)
    return samples[taken:], estimator


def _widened(P: np.ndarray, q: np.ndarray, down: np.ndarray, angle: float, elements: bool) -> np.ndarray:
    """Add a heading variance of `angle`^2 to P: of the elements of q, or of an error in body axes."""
    P = P.copy()
    if elements:
        slope = attitude.by_rotation(q) @ down
        P[:4, :4] += angle**2 * np.outer(slope, slope)
    else:
        P[:3, :3] += angle**2 * np.outer(down, down)
    return P


def time_until(t: np.ndarray, error: np.ndarray, limit: float) -> float:
    """Compute time from t[0] until |error| is below `limit` for good; NaN when never."""
    above = np.flatnonzero(~(np.abs(error) < limit))
    first = above[-1] + 1 if len(above) else 0
    return float(t[first] - t[0]) if first < len(t) else math.nan


def time_first(t: np.ndarray, error: np.ndarray, limit: float) -> float:
    """Compute time from t[0] until |error| is below `limit` for the first time; NaN when never."""
    below = np.flatnonzero(np.abs(error) < limit)
    return float(t[below[0]] - t[0]) if len(below) else math.nan


def thinned(measured: Measured, every: int) -> Measured:
    """Take every so many samples, as a slower unit would have sent."""
    return replace(measured, samples=measured.samples[::every])
