"""What cannot be a measurement: limits far beyond anything an aircraft meets."""

from estimators.jit import njit

MAX_RATE, MAX_FORCE, MAX_FIELD, MAX_SPEED = 100.0, 2000.0, 0.01, 2000.0  # rad/s, m/s2, T, m/s


@njit(forceinline=True)
def plausible(value: float, limit: float) -> bool:
    """Tell whether a value is finite and within the limit."""
    return abs(value) < limit  # False for NaN


@njit(forceinline=True)
def on_earth(latitude: float, longitude: float, height: float) -> bool:
    """Tell whether a position is near the Earth (rad, rad, m); angles must not need wrapping."""
    return abs(latitude) < 1.58 and abs(longitude) < 6.3 and abs(height) < 1e6  # False for NaN
