"""Arguments of environments, whose makers take them as ``**kwargs`` from anybody."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from qrsim.errors import UsageError, nearest

P = ParamSpec("P")
T = TypeVar("T")


def checked_arguments(make: Callable[P, T]) -> Callable[P, T]:
    """Decorate ``make`` so that wrong argument names or a missing scenario raise a UsageError with a hint."""
    signature = inspect.signature(make)

    @wraps(make)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        """Call the function; raise UsageError for arguments that it does not take."""
        try:
            signature.bind(*args, **kwargs)
        except TypeError as error:
            known = [name for name in signature.parameters if name != "self"]
            raise UsageError(_problem(dict(kwargs), known) or f"arguments of an environment: {error}") from None
        return make(*args, **kwargs)

    return checked


def _problem(given: dict[str, object], known: list[str]) -> str:
    """Return in words what is wrong with the names of arguments, given those known; "" if they are right."""
    from qrsim.scenarios.schema import ScenarioSpec

    for name, value in given.items():
        if name in known:
            continue
        allowed = f"{name}: no such argument of an environment; allowed: {', '.join(known)}"
        match = nearest(name, [*known, *ScenarioSpec.model_fields])
        if match in known:
            return f"{allowed}; did you mean '{match}'?"
        if name == "seed":
            return f"{allowed}; a seed is that of reset(seed=...)"
        path, text = match or "duration", value if isinstance(value, int | float | str) else "..."
        return f"{allowed}; a value of the scenario is set by overrides=['{path}={text if match else 20}']"
    return "" if "scenario" in given else "scenario: missing; expected a name, the path of a .yaml file or a dict"
