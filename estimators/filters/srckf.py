"""`ckf` in square-root form, see `square_root`."""

from estimators.filters.ckf import make as make
from estimators.filters.points import Parameters as Parameters
from estimators.filters.square_root import USES as USES
from estimators.filters.square_root import correct as correct
from estimators.filters.square_root import predict as predict
from estimators.filters.square_root import project as project
from estimators.filters.square_root import reported as reported
from estimators.filters.square_root import store as store
