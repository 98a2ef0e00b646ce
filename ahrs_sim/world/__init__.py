"""The Earth: ellipsoid, gravity, magnetic field, satellites. Knows nothing of aircraft and sensors."""
