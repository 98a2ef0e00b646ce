"""Functions that are chosen by the type of their first argument, in compiled code and in plain Python alike.

A filter is written once and calls `propagate(model, ...)`; each model type supplies its own. A function or closure as
argument would be compiled again in every process; a `NamedTuple` type is not, so a filter is compiled once per model
and then loaded from the disk cache.

    @generic
    def propagate(model, x, u, dt, out): ...

    class Marg(NamedTuple): ...
    register(Marg, propagate=_propagate)         # a plain function with the same argument names
"""

import inspect
from collections.abc import Callable
from typing import Any

from numba.extending import overload

_IMPLEMENTATIONS: dict[type, dict[str, Callable[..., Any]]] = {}
_DEFAULTS: dict[str, Callable[..., Any]] = {}


def _find(owner: type, name: str) -> Callable[..., Any]:
    found = _IMPLEMENTATIONS.get(owner, {}).get(name) or _DEFAULTS.get(name)
    if found is None:
        raise TypeError(f"{owner.__name__} supplies no '{name}'")
    return found


def generic(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make `function` generic over the type of its first argument; its own body is never run."""
    name = function.__name__

    def choose(*args: Any) -> Callable[..., Any]:
        found = _find(args[0].instance_class, name)
        return getattr(found, "py_func", found)  # a kernel may be registered as well as a plain function

    def dispatch(*args: Any) -> Any:
        return _find(type(args[0]), name)(*args)

    wrappers: tuple[Any, Any] = (choose, dispatch)
    for wrapper in wrappers:
        wrapper.__name__ = name
        wrapper.__signature__ = inspect.signature(function)
    dispatch.__doc__ = function.__doc__
    dispatch.__module__ = function.__module__
    overload(dispatch, jit_options={"error_model": "numpy", "forceinline": True})(choose)
    return dispatch


def default(function: Callable[..., Any]) -> Callable[..., Any]:
    """What types that register nothing of this name (the function's, without leading underscore) use."""
    _DEFAULTS[function.__name__.lstrip("_")] = function
    return function


def register(owner: type, **functions: Callable[..., Any]) -> None:
    """Supply the generic functions of a NamedTuple type."""
    _IMPLEMENTATIONS.setdefault(owner, {}).update(functions)
