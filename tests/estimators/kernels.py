"""Kernels of a model as functions of plain vectors: the compiled ones, or Python's own without a compiler."""

import numpy as np

from estimators.alignment import Stretch, concluded
from estimators.filters import moments
from estimators.filters.base import predict
from estimators.filters.work import Work
from estimators.jit import JIT
from estimators.models import base
from estimators.native import CAPACITY, caller, pointer
from estimators.records import Place, Sheet, pack_settings

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
    """A model that has begun: with these settings and an alignment of nothing, or an estimator's own."""

    def __init__(self, module, settings, site, sensors, parameters=None, memory=None):
        layout = module.layout(settings)
        self.bound = base.Bound(module, layout, (base.build, *MODEL, *moments.ENTRIES))
        self.handle, self.parameters, self.groups = self.bound.handle, self.bound.parameters, layout.groups
        self.size, self.raw, self.changed = layout.size, layout.raw, layout.changed
        x, P, P_restart = vector([]), matrix([]), matrix([])
        place, sheet, values = Place.from_site(site), Sheet.from_info(sensors), pack_settings(module.SETTINGS, settings)
        alignment = concluded(Stretch.make(), False, site, sensors)
        called(base.build, self.handle, values, place, sheet, alignment, x, P, P_restart)
        self.x, self.P = x[: self.raw], P[: self.size, : self.size]
        if parameters is not None:
            self.bound.parameters.data[...], self.bound.memory.data[...] = parameters.data, memory.data

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
    estimator._bind()
    model = estimator._model
    known = estimator.settings, estimator.site, estimator.sensors
    return Kernels(estimator._module, *known, model.parameters, model.memory)
