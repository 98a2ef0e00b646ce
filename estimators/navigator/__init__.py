"""The navigator with calibration states: one inertial navigator whose sensors are calibrated while it flies.

Read in this order: `layout` (what is estimated), `strapdown` (how it moves), `covariance` (how sure it is), `aids`
(what corrects it), `loop` (row by row), `navigator` (the object of the catalogue), `smoother` (afterwards).
"""
