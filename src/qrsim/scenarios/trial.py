"""Trial tick of a scenario with components from outside, traced by JAX: shapes, types, errors raised.

Nothing is computed. Each component from outside is replaced by one of a class derived from its own that looks at what
its methods return, so that a fault is named where it is and not where it is found out.
"""

from __future__ import annotations

import dataclasses
import inspect
import threading
from collections.abc import Callable, Iterator
from functools import lru_cache, wraps
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.noise import Key
from qrsim.core.tree import cast, field_info, record
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.files.code import in_one_line, where_raised
from qrsim.scenarios import build, catalogue, registry
from qrsim.scenarios.conformity import CONTRACTS, PLAIN, file_of_class
from qrsim.scenarios.providing import places
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.tasks import Play
from qrsim.world import tick as ticks

# What JAX says where a program asks for a value that there is not yet, and what is to be written in its place.
_ADVICE: tuple[tuple[type[Exception], str], ...] = (
    (
        jax.errors.TracerBoolConversionError,
        "it cannot be compiled, because Python's if, while, and, or, not ask for the value of an array; "
        "use jnp.where, &, |, ~",
    ),
    (
        jax.errors.NonConcreteBooleanIndexError,
        "it cannot be compiled, because an array that is picked by a mask has no known length; use jnp.where",
    ),
    (
        jax.errors.TracerArrayConversionError,
        "it cannot be compiled, because a function of NumPy asks for the values of an array; use jax.numpy",
    ),
    (
        jax.errors.ConcretizationTypeError,
        "it cannot be compiled, because float(), int() or the like asks for the value of an array; use jax.numpy",
    ),
    (
        jax.errors.TracerIntegerConversionError,
        "it cannot be compiled, because an array is used as a whole number of Python; use jax.numpy",
    ),
)
_LOCK = threading.Lock()
# Structures of worlds that have passed.
_PASSED: dict[Any, None] = {}
MOST_PASSED = 256


class FaultError(UsageError):
    """A fault of a component from outside."""


def trial_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the faults of components from outside in the first tick; ``scenario`` has no other problems."""
    if not registry.any_outside():
        return
    content = scenario.model_dump(mode="json")
    strange = {
        catalogue.KINDS[kind][part["type"]]: (path, kind)
        for path, kind, part in places(content)
        if part["type"] in catalogue.KINDS[kind] and registry.is_outside(kind, part["type"])
    }
    if not strange:
        return
    try:
        _fly(scenario, {component: kind for component, (_, kind) in strange.items()})
    except FaultError as error:
        component = error.args[1]
        yield f"{strange[component][0]}: {error.args[0]}"
    except Exception as error:
        files = [file_of_class(component) for component in strange]
        place = where_raised(error, files)
        names = ", ".join(f"{path} ({component.__name__})" for component, (path, _) in strange.items())
        yield f"{names}: the first tick cannot be traced: {in_one_line(error)}" + (f" ({place})" if place else "")


def _fly(scenario: ScenarioSpec, kinds: dict[type, str]) -> None:
    world, task = build.build_world(scenario, "float32"), build.build_task(scenario, "float32")
    steps = round(scenario.duration / scenario.task.period) if scenario.task.type != "none" else 0
    key = (tuple(kinds), jax.tree.structure((world, task)), tuple(map(np.shape, jax.tree.leaves((world, task)))))
    with _LOCK:
        if key in _PASSED:
            return

    def watch(item: Any) -> Any:
        kind = kinds.get(type(item))
        if kind is None:
            return item
        own: Any = type(item)
        return _watched(own, kind)(**{f.name: getattr(item, f.name) for f in dataclasses.fields(item)})

    watched: Any = jax.tree.map(watch, (world, task), is_leaf=lambda item: type(item) in kinds)
    keys = Key.root(0)
    with jax.enable_x64(False):
        if steps:
            _play(cast(Play(watched[1], watched[0], steps), np.dtype("float32")), keys)
        else:
            _tick(watched[0], keys)
    with _LOCK:
        while len(_PASSED) >= MOST_PASSED:
            _PASSED.pop(next(iter(_PASSED)))
        _PASSED[key] = None


def _tick(world: Any, key: Any) -> None:
    state = jax.eval_shape(ticks.reset, world, key)
    actions = (None,) * len(world.fleets)
    after = jax.eval_shape(
        lambda world, state, tick: ticks.step(world, state, tick, actions), world, state, np.int32(0)
    )
    for fleet, first, then in zip(world.fleets, state.fleets, after.fleets, strict=True):
        for sensor, one, other in zip(fleet.sensors, first.readings, then.readings, strict=True):
            watched = getattr(type(sensor), "_watched", None)
            if watched is not None:
                _same(watched, "step", "the reading", one, other)


def _play(play: Play, key: Any) -> None:
    keys = play.keys(key)
    episode, _ = jax.eval_shape(lambda play, keys: play.reset(keys), play, keys)
    action = np.zeros((len(play.agents), len(play.axes)), np.float32)
    jax.eval_shape(lambda play, episode, action: play.step(episode, action), play, episode, action)


@lru_cache(maxsize=64)
def _watched(component: type, kind: str) -> type:
    """Return a class derived from a component's whose methods are looked at."""
    contract = CONTRACTS.get(kind)
    names = [name for name in vars(contract or component) if not name.startswith("_")]
    methods = {name: getattr(component, name) for name in names if callable(getattr(component, name, None))}
    found = {name: _looked_at(component, kind, name, method) for name, method in methods.items()
             if hasattr(method, "__code__") and not _free(component, name)}  # fmt: skip
    return record(type(component.__name__, (component,), {**found, "_watched": component, "__module__": __name__}))


def _free(component: type, name: str) -> bool:
    """Return whether a method is called without an object."""
    return isinstance(inspect.getattr_static(component, name), staticmethod | classmethod)


def _looked_at(component: type, kind: str, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
    check = _CHECKS.get((kind, name))

    @wraps(method)
    def called(self: Any, *args: Any, **kwargs: Any) -> Any:
        try:
            result = method(self, *args, **kwargs)
        except FaultError:
            raise
        except (Exception, SystemExit) as error:
            advice = next((words for kind, words in _ADVICE if isinstance(error, kind)), in_one_line(error))
            place = where_raised(error, [method.__code__.co_filename, file_of_class(component)])
            where = f" ({place})" if place else ""
            raise FaultError(_blamed(component, name, advice) + where, component) from None
        if check is not None:
            for problem in check(self, args, kwargs, result):
                raise FaultError(_blamed(component, name, problem), component)
        return result

    return called


def _blamed(component: type, method: str, problem: str) -> str:
    return f"{file_of_class(component)}: {component.__name__}.{method}: {problem}"


# ---- what methods return ----


def _shape(value: Any) -> str:
    try:
        return f"shape {tuple(np.shape(value))}"
    except (TypeError, ValueError):
        return f"{type(value).__name__}"


def _array(what: str, value: Any, shape: tuple[int, ...]) -> Iterator[str]:
    """Yield what is wrong with a value that is to be an array of numbers of some shape."""
    try:
        found, kind = tuple(np.shape(value)), jnp.result_type(value)
    except (TypeError, ValueError):
        yield f"{what} is {type(value).__name__}; expected an array of shape {shape}"
        return
    if found != shape:
        yield f"{what} has shape {found}; expected {shape}, one number for each vehicle"
    elif not jnp.issubdtype(kind, jnp.floating):
        yield f"{what} has numbers of type {kind}; expected floating-point ones"


def _vector(what: str, value: Any, shape: tuple[int, ...]) -> Iterator[str]:
    if not isinstance(value, Vec3):
        yield f"{what} is {_name(value)}; expected a qrsim.Vec3 of arrays of shape {shape}"
        return
    for axis in "xyz":
        yield from _array(f"{what}.{axis}", getattr(value, axis), shape)


def _name(value: Any) -> str:
    return f"an array of {_shape(value)}" if hasattr(value, "shape") else type(value).__name__


def _pair(value: Any, what: str) -> Iterator[str]:
    if not isinstance(value, tuple) or len(value) != 2:
        yield f"it returned {_name(value)}; expected a pair, {what}"


def _each(what: str, value: Any, shape: tuple[int, ...]) -> Iterator[str]:
    """Yield what is wrong with a record of arrays."""
    if not dataclasses.is_dataclass(value) or isinstance(value, type) or jax.tree_util.all_leaves([value]):
        yield f"{what} is {_name(value)}; expected a record (@qrsim.record) of arrays of shape {shape}"
        return
    for path, leaf in jax.tree_util.tree_flatten_with_path(value)[0]:
        yield from _array(f"{what}{jax.tree_util.keystr(path)}", leaf, shape)


def _unchanged(what: str, before: Any, after: Any) -> Iterator[str]:
    """Yield in what a state is of another kind after a step than before."""
    old: Any = jax.tree.structure(before)
    new: Any = jax.tree.structure(after)
    if old != new:
        yield f"{what} was {_tree(before)} and is now {_tree(after)}; expected the same structure"
        return
    for (path, one), other in zip(jax.tree_util.tree_flatten_with_path(before)[0], jax.tree.leaves(after), strict=True):
        was, now = (f"{jnp.result_type(leaf)} of shape {tuple(np.shape(leaf))}" for leaf in (one, other))
        if was != now:
            yield f"{what}{jax.tree_util.keystr(path)} was {was} and is now {now}; expected no change"


def _tree(value: Any) -> str:
    return "nothing" if value is None else _name(value)


def _same(component: type, method: str, what: str, before: Any, after: Any) -> None:
    for problem in _unchanged(what, before, after):
        raise FaultError(_blamed(component, method, problem), component)


Check = Callable[[Any, tuple[Any, ...], dict[str, Any], Any], Iterator[str]]


def _size(args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[int, ...] | None:
    """Return (n,) of the first vector, angles or array with one number for each vehicle among some arguments."""
    for value in (*kwargs.values(), *args):
        for leaf in jax.tree.leaves(value):
            if len(np.shape(leaf)) == 1:
                return tuple(np.shape(leaf))
    return None


def _reading(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    yield from _pair(result, "the new state and the reading")
    shape = _size((), {name: value for name, value in kwargs.items() if name not in ("sky", "surroundings", "ground")})
    if shape is None:
        leaves = [np.shape(leaf) for leaf in jax.tree.leaves(result[1])]
        shape = leaves[0] if leaves and len(leaves[0]) == 1 else (1,)
    yield from _each("the reading", result[1], shape)
    for field in dataclasses.fields(result[1]):
        if not field_info(field).unit:
            name = f"{type(result[1]).__name__}.{field.name}"
            yield f"{name} has no unit; expected {field.name}: ... = qrsim.quantity(unit=..., doc=...)"


def _next_reading(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    yield from _reading(self, args, kwargs, result)
    yield from _unchanged("the state", args[0], result[0])


def _vector_of(position: int) -> Check:
    def check(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
        shape = _size(args[position : position + 1], {})
        assert shape is not None
        yield from _vector("the result", result, shape)

    return check


def _array_of(position: int) -> Check:
    def check(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
        shape = _size(args[position : position + 1], {})
        if shape is not None:
            yield from _array("the result", result, shape)

    return check


def _state_only(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    yield from _unchanged("the state", args[0], result)


def _state_and(what: str) -> Check:
    def check(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
        yield from _pair(result, f"the new state and {what}")
        yield from _unchanged("the state", args[0], result[0])
        gives = getattr(type(self), "gives", None)
        if gives is not None and not isinstance(result[1], gives):
            yield f"{what} is {_name(result[1])}; expected {gives.__name__}, which '{type(self).__name__}.gives' names"

    return check


def _vehicle_step(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    yield from _pair(result, "the new state and the specific force")
    yield from _unchanged("the state", args[0], result[0])
    shape = _size(args[:1], {})
    assert shape is not None
    yield from _vector("the specific force", result[1], shape)


def _vehicle_state(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    shape = _size(args[:1], {})
    assert shape is not None
    yield from _each("the state", result, shape)
    if not isinstance(getattr(result, "position_ned", None), Vec3):
        yield "the state has no position_ned, a qrsim.Vec3"


def _voltage(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    shape = _size(args[1:], {})
    if result is not None and shape is not None:
        yield from _array("the voltage", result, shape)


def _judged(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    yield from _pair(result, "the new memory and the reward")
    yield from _unchanged("the memory", args[0], result[0])
    yield from _array("the reward", result[1], (_agents(self, args[1]),))


def _seen(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    n = _agents(self, args[1])
    parts = result if isinstance(result, dict) else {"": result}
    for name, part in parts.items():
        what = f"the observation{f' {name!r}' if name else ''}"
        found = tuple(np.shape(part)) if hasattr(part, "shape") else None
        if found is None:
            yield f"{what} is {_name(part)}; expected an array whose first axis has {n} entries, one for each vehicle"
        elif found[:1] != (n,) or (not name and len(found) != 2):
            yield f"{what} has shape {found}; expected ({n}, O), a row for each vehicle"


def _commanded(self: Any, args: Any, kwargs: Any, result: Any) -> Iterator[str]:
    count = len(args[1].fleets)
    if not isinstance(result, tuple) or len(result) != count:
        yield f"it returned {_name(result)}; expected a tuple of {count}, one action or None for each fleet"


def _agents(task: Any, world: Any) -> int:
    return next(fleet.size for fleet in world.fleets if fleet.name == task.fleet)


_CHECKS: dict[tuple[str, str], Check] = {
    ("sensor", "init"): _reading,
    ("sensor", "step"): _next_reading,
    ("wind", "velocity_ned"): _vector_of(0),
    ("gust", "velocity_ned"): _vector_of(0),
    ("turbulence", "step"): _state_only,
    ("turbulence", "gust_ned"): _vector_of(1),
    ("turbulence", "gust_rates_ned"): _vector_of(1),
    ("vehicle", "initial_state"): _vehicle_state,
    ("vehicle", "step"): _vehicle_step,
    ("vehicle", "stopped"): _state_only,
    ("battery", "step"): _state_only,
    ("battery", "voltage"): _voltage,
    ("controller", "step"): _state_and("the command"),
    ("guidance", "step"): _state_and("the set-point"),
    ("area", "margin"): _array_of(0),
    ("area", "height_agl"): _array_of(0),
    ("ground", "down"): _array_of(0),
    ("ground", "normal"): _vector_of(0),
    ("sky", "step"): _state_only,
    ("task", "judge"): _judged,
    ("task", "observe"): _seen,
    ("task", "commands"): _commanded,
}
assert not set(PLAIN) & {kind for kind, _ in _CHECKS}
