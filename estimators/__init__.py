"""Attitude estimators on NumPy and Numba, usable without the simulator."""
