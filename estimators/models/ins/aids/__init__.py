"""What keeps the navigator's errors small: one file per aid, and this list of them.

An aid is a module with

    NAME                        of its records in those of the model
    READS_AS                    the aid in whose measurement group it measures: itself, or another with the same rows
    SETTINGS                    what a user can choose
    Parameters, Memory          records
    configure(settings, site, sensors, own)
                                sets its parameters, all of them
    measure(own, model, row, x, kept, memory, u, z, variance, used)
                                when it is due: measurements z, their variances and which count; what it gates

and, when it has a group of its own,

    Readings                    record of the measurements
    ANGLE                       whether the residual is wrapped
    REPORTED                    whether its innovations go into the estimates, whose columns are few
    reads(states)               (first, end) of the error components that the prediction depends on
    observe(own, model, x, u, y), slope(own, model, x, u, H)
                                what it predicts, and the derivative by the error (H is zero before)

`own` and `kept` are its records `Parameters` and `Memory`, `model`, `memory` and u those that all share (`layout`).
Groups are processed in the order of the list.
"""

from collections.abc import Callable
from typing import Any

from estimators.jit import inner
from estimators.models.ins.aids import airspeed, baseline, field, gnss, pseudo, realign, still

AIDS: tuple[Any, ...] = (gnss, pseudo, still, field, baseline, realign, airspeed)
GROUPED = tuple(aid for aid in AIDS if aid.READS_AS == aid.NAME)
"""Those with a group of their own: its number is the place here."""


def in_turn(aids: tuple[Any, ...]) -> Any:
    """A kernel that lets each aid measure."""
    own, name, group = aids[0].measure, aids[0].NAME, aids[0].READS_AS

    @inner
    def one(model, row, x, memory, u, z, used):  # type: ignore[no-untyped-def]
        own(model[name], model, row, x, memory[name], memory, u, z[group], u.variance[group], used[group])

    if len(aids) == 1:
        return one
    others = in_turn(aids[1:])

    @inner
    def first(model, row, x, memory, u, z, used):  # type: ignore[no-untyped-def]
        one(model, row, x, memory, u, z, used)
        others(model, row, x, memory, u, z, used)

    return first


def configured(aids: tuple[Any, ...]) -> Any:
    """A kernel that sets the parameters of each aid."""
    own, name = aids[0].configure, aids[0].NAME

    @inner
    def one(settings, site, sensors, model):  # type: ignore[no-untyped-def]
        own(settings, site, sensors, model[name])

    if len(aids) == 1:
        return one
    others = configured(aids[1:])

    @inner
    def first(settings, site, sensors, model):  # type: ignore[no-untyped-def]
        one(settings, site, sensors, model)
        others(settings, site, sensors, model)

    return first


def by_group(kernel: Callable[[Any], Any], number: int = 0) -> Any:
    """A kernel `(model, group, x, u, out)` that calls the group's own, `kernel(aid)`."""
    own, name = kernel(GROUPED[number]), GROUPED[number].NAME

    @inner
    def last(model, group, x, u, out):  # type: ignore[no-untyped-def]
        own(model[name], model, x, u, out)

    if number == len(GROUPED) - 1:
        return last
    others = by_group(kernel, number + 1)

    @inner
    def chosen(model, group, x, u, out):  # type: ignore[no-untyped-def]
        if group == number:
            own(model[name], model, x, u, out)
        else:
            others(model, group, x, u, out)

    return chosen
