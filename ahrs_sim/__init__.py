"""Test bench for aircraft attitude and heading reference systems."""
