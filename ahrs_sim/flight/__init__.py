"""Flying: JSBSim and the pilot, or a formula. The only place that imports JSBSim, and only when one flies."""

from typing import Protocol

import numpy as np

from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.scenario import Scenario

BLOCK_S = 4.0
"""s, length of a block when no estimator flies the aircraft."""


class Flight(Protocol):
    """A flight as the pipeline sees it, the same for JSBSim and for a motion."""

    dt: float
    """s between rows of the truth."""
    start_lla: np.ndarray
    """(3,) rad, rad, m: where it begins; a script of JSBSim's has a place of its own."""
    done: bool
    """Nothing more comes."""
    error: str | None
    """Why the flight ended before its scenario did: crash, time-out, numbers out of bounds."""
    expected_duration: float | None
    """s, about; None when it is not known."""

    def fly(self, n: int) -> Truth:
        """Fly the next up to `n` rows, from t = 0 on; fewer when the flight ends, none when it is over."""
        ...

    def take_setpoints(self) -> Setpoints:
        """Collect the pilot's set-points since the last call."""
        ...

    def take_events(self) -> list[Event]:
        """Collect events since the last call, in order."""
        ...

    def feedback(self, q_nb: np.ndarray, rate_b: np.ndarray) -> None:
        """Set attitude (4,) and body rate (3,) rad/s that the autopilot flies on instead of the truth."""
        ...

    def attachments(self) -> dict[str, bytes]:
        """Collect the files of the aircraft that flies, by relative path."""
        ...


def open_flight(scenario: Scenario) -> Flight:
    """Get a flight ready.

    Raises:
        InputError: unknown aircraft, script, manoeuvre, property or motion, or a value out of range.
    """
    if scenario.motion is not None:
        from ahrs_sim.flight.motion import MotionFlight

        return MotionFlight(scenario)
    from ahrs_sim.flight.jsbsim_flight import JsbsimFlight

    return JsbsimFlight(scenario)


__all__ = ["Event", "Flight", "Setpoints", "Truth", "open_flight"]
