"""Kernels of a model as functions of plain vectors: the compiled ones, or Python's own without a compiler."""

import numpy as np

from estimators.filters import moments
from estimators.filters.base import predict
from estimators.filters.work import Work
from estimators.jit import JIT
from estimators.models import base
from estimators.native import CAPACITY, caller, pointer

MODEL = (
    base.propagate, base.transition, base.process_noise, base.observe, base.slope, base.measurement_noise,
    base.residual, base.retract, base.difference, base.constrain,
)  # fmt: skip


def vector(values):
    padded = np.zeros(CAPACITY)
    padded[: len(values)] = values
    return padded


def matrix(values):
    padded = np.zeros((CAPACITY, CAPACITY))
    padded[: len(values), : len(values)] = values
    return padded


def called(entry, handle, *arguments):
    function = caller(entry, getattr(handle, entry.__name__))
    given = [handle, *arguments]
    if JIT:
        given = [pointer(a) if isinstance(a, np.ndarray) or hasattr(a, "data") else a for a in given]
    return function(*given)


class Kernels:
    def __init__(self, module, start, entries=(*MODEL, *moments.ENTRIES)):
        self.start, self.bound = start, base.Bound(module, start, entries)
        self.handle, self.parameters = self.bound.handle, start.parameters
        self.size, self.raw, self.changed, self.groups = len(start.P), len(start.x), start.changed, start.groups

    def propagate(self, x, u, dt):
        out = vector([])
        called(base.propagate, self.handle, 1, vector(x), vector(u), dt, out)
        return out[: self.raw]

    def transition(self, x, u, dt):
        F = matrix([])
        called(base.transition, self.handle, vector(x), vector(u), dt, F)
        return F[: self.changed, : self.size]

    def observe(self, group, x, u):
        y = vector([])
        called(base.observe, self.handle, group, 1, vector(x), vector(u), y)
        return y[: self.groups[group].rows]

    def slope(self, group, x, u):
        H = matrix([])
        called(base.slope, self.handle, group, vector(x), vector(u), H)
        return H[: self.groups[group].rows, : self.size]

    def residual(self, group, z, y):
        out = vector([])
        called(base.residual, self.handle, group, 1, vector(z), vector(y), out)
        return out[: self.groups[group].rows]

    def retract(self, x, dx):
        out = vector([])
        called(base.retract, self.handle, 1, vector(x), vector(dx), out)
        return out[: self.raw]

    def difference(self, x, origin):
        out = vector([])
        called(base.difference, self.handle, 1, vector(x), vector(origin), out)
        return out[: self.changed]

    def predict(self, method, x, P, u, dt):
        x, P = vector(x), matrix(P)
        assert called(predict, method.handle, self.handle, x, P, vector(u), dt, Work.zeros())
        return x[: self.raw], P[: self.size, : self.size]


def of(estimator):
    """The kernels of an estimator that has begun."""
    model = estimator._model
    blank = estimator._module.build(
        estimator.settings, estimator.site, estimator.sensors, estimator_alignment(estimator)
    )
    return Kernels(estimator._module, blank._replace(parameters=model.parameters, memory=model.memory))


def estimator_alignment(estimator):
    from estimators.alignment import Stretch, conclude

    return conclude(Stretch.make(), False, estimator.site, estimator.sensors)
