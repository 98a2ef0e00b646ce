"""The exceptions of `estimators`: one tree, `EstimationError` at its root, every message one line for a user."""


class EstimationError(Exception):
    """Root of the tree."""


class SettingError(EstimationError):
    """An unknown estimator or setting, or a setting with an impossible value."""


class SampleError(EstimationError):
    """Samples of a wrong shape, or with time stamps no estimator can use."""
