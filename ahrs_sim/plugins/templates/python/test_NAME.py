"""How good NAME must be, with ahrs_sim's pytest fixture."""

import pytest

from ahrs_sim.testing import FlyScenario, assert_accuracy


@pytest.mark.parametrize("seed", [1, 2])
def test_take_off(fly_scenario: FlyScenario, seed: int) -> None:
    """Stay level on the ground and through the take-off run."""
    log = fly_scenario("takeoff", duration=60, seed=seed, estimators={"mine": {"method": "NAME:NAME", "suite": "chr"}})
    assert_accuracy(log, {"mine": {"ground.tilt_rmse_deg": 3.0, "availability": 0.9}})
