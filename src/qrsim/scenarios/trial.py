"""Trial tick of a scenario with components from outside, traced by JAX: shapes, types, errors raised.

Nothing is computed. Each component from outside is replaced by one of a class derived from its own that looks at what
its methods return, so that a fault is named where it is and not where it is found out.
"""

from __future__ import annotations

import dataclasses
import inspect
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextvars import ContextVar
from functools import lru_cache, wraps
from typing import Any

import jax
import numpy as np
from jax import Array

from qrsim.core.noise import Draw, Drawn, Key
from qrsim.core.tree import cast, record, replace
from qrsim.errors import UsageError
from qrsim.files.code import in_one_line, where_raised
from qrsim.scenarios import build, catalogue, registry
from qrsim.scenarios.conformity import CONTRACTS, PLAIN, file_of_class
from qrsim.scenarios.providing import places
from qrsim.scenarios.returns import CHECKS
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.value_checks import unchanged
from qrsim.tasks import Play
from qrsim.world import tick as ticks
from qrsim.world.state import World

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
_NO_NOISE = (
    "its noise is None, which draw_noise returns where a vehicle has none of its own; expected def draw_noise(self, "
    "draw, dt) that returns draw.normals(count), and normals = count"
)
# What draws the normals that a class declares.
_DRAWING = {"sensor": ("init", "step"), "turbulence": ("init", "step"), "vehicle": ("draw_noise",)}
# Of the trial that this thread makes: the most normals that each method of a component has drawn in one call.
_DRAWN: ContextVar[dict[tuple[type, str], int]] = ContextVar("drawn")
_LOCK = threading.Lock()
# Structures of worlds that have passed.
_PASSED: dict[Hashable, None] = {}
MOST_PASSED = 256


class FaultError(UsageError):
    """A fault of a component from outside."""


def trial_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of components that are not built in, which show when a scenario's first tick is traced."""
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
    kinds, drawn = {component: kind for component, (_, kind) in strange.items()}, _DRAWN.set({})
    try:
        _trace_first_tick(scenario, kinds)
    except FaultError as error:
        component = error.args[1]
        yield f"{strange[component][0]}: {error.args[0]}"
    except Exception as error:
        files = [file_of_class(component) for component in strange]
        place = where_raised(error, files)
        names = ", ".join(
            f"{path} ({file_of_class(component)}: {component.__name__})" for component, (path, _) in strange.items()
        )
        yield f"{names}: the first tick cannot be traced: {in_one_line(error)}" + (f" ({place})" if place else "")
    finally:
        _DRAWN.reset(drawn)


def _trace_first_tick(scenario: ScenarioSpec, kinds: dict[type, str]) -> None:
    """Trace a reset and a tick with checked components (``kinds``: class -> kind), cached; raises FaultError."""
    world, task = build.build_world(scenario, "float32"), build.build_task(scenario, "float32")
    steps = round(scenario.duration / scenario.task.period) if scenario.task.type != "none" else 0
    key = (tuple(kinds), jax.tree.structure((world, task)), tuple(map(np.shape, jax.tree.leaves((world, task)))))
    with _LOCK:
        if key in _PASSED:
            return

    def watched(part: object, size: int | None) -> Any:
        """Return a part of the world with results of not built-in components checked; ``size``: of their fleet."""

        def watch(item: Any) -> object:
            """Return a component that is not built in as its checking subclass; any other item unchanged."""
            own: Any = type(item)
            if own not in kinds:
                return item
            return _watched(own, kinds[own], size)(**{f.name: getattr(item, f.name) for f in dataclasses.fields(item)})

        return jax.tree.map(watch, part, is_leaf=lambda item: type(item) in kinds)

    fleets = tuple(watched(fleet, fleet.size) for fleet in world.fleets)
    world, task = replace(watched(replace(world, fleets=()), None), fleets=fleets), watched(task, None)
    keys = Key.root(0)
    with jax.enable_x64(False):
        if steps:
            _trace_episode(cast(Play(task, world, steps), np.dtype("float32")), keys)
        else:
            _trace_tick(world, keys)
        if hasattr(world.area, "_watched"):
            # The metrics of a flight ask for it, no tick does.
            jax.eval_shape(lambda area, at: area.margin(at), world.area, world.fleets[0].start.position_ned)
    for part in (world.turbulence, *(part for fleet in world.fleets for part in (fleet.vehicle, *fleet.sensors))):
        if hasattr(part, "_watched"):
            _check_normals(part, kinds[part._watched])
    with _LOCK:
        while len(_PASSED) >= MOST_PASSED:
            _PASSED.pop(next(iter(_PASSED)))
        _PASSED[key] = None


def _check_normals(part: Any, kind: str) -> None:
    """Raise FaultError if a component draws fewer random normals than its class declares."""
    component, first = part._watched, getattr(part, "first_normals", 0)
    if getattr(part, "draws_alone", False):
        return
    drawn = {method: count for (owner, method), count in _DRAWN.get().items() if owner is component}
    if first and "init" in drawn and drawn.pop("init") < first:
        found = _DRAWN.get()[component, "init"]
        raise FaultError(_blamed(component, "init", _fewer(found, "first_normals", first)), component)
    methods = [method for method in _DRAWING[kind] if method in drawn or not first or method != "init"]
    most = max((drawn.get(method, 0) for method in methods), default=0)
    if most < part.normals:
        raise FaultError(_blamed(component, methods[-1], _fewer(most, "normals", part.normals)), component)


def _fewer(drawn: int, name: str, declared: int) -> str:
    """Return the error for ``drawn`` random normals where the class attribute ``name`` declares ``declared``."""
    count = f"{drawn or 'no'} normal{'' if drawn == 1 else 's'}"
    return f"it draws {count}, and the class declares {name} = {declared}; expected {name} = {drawn}"


class _Counted:
    """Noise that notes how many normals a method draws from it.

    Args:
        noise: a ``Noise``.
        where: component and method.
    """

    def __init__(self, noise: Draw | Drawn, where: tuple[type, str]):
        self._noise, self._where = noise, where

    def normals(self, count: int) -> Sequence[Array]:
        """Return ``count`` arrays of random normals, and note the count."""
        drawn = _DRAWN.get()
        drawn[self._where] = max(drawn.get(self._where, 0), count)
        return self._noise.normals(count)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._noise, name)


def _trace_tick(world: World, key: Key) -> None:
    """Trace a reset and a tick of a world without task; raise FaultError for readings that change structure or type."""
    state = jax.eval_shape(ticks.reset, world, key)
    actions = (None,) * len(world.fleets)
    after = jax.eval_shape(
        lambda world, state, tick: ticks.step(world, state, tick, actions), world, state, np.int32(0)
    )
    for fleet, first, then in zip(world.fleets, state.fleets, after.fleets, strict=True):
        for sensor, one, other in zip(fleet.sensors, first.readings, then.readings, strict=True):
            watched = getattr(type(sensor), "_watched", None)
            if watched is not None:
                for problem in unchanged("the reading", one, other):
                    raise FaultError(_blamed(watched, "step", problem), watched)


def _trace_episode(play: Play, key: Key) -> None:
    """Trace a reset and a step of an episode of a task, without running it."""
    keys = play.keys(key)
    episode, _ = jax.eval_shape(lambda play, keys: play.reset(keys), play, keys)
    action = np.zeros((len(play.agents), play.width), np.float32)
    jax.eval_shape(lambda play, episode, action: play.step(episode, action), play, episode, action)


@lru_cache(maxsize=64)
def _watched(component: type, kind: str, size: int | None) -> type:
    """Return a subclass of a component that checks its methods' results; ``size``: vehicles of its fleet."""
    contract = CONTRACTS.get(kind)
    names = [name for name in vars(contract or component) if not name.startswith("_")]
    methods = {name: getattr(component, name) for name in names if callable(getattr(component, name, None))}
    found = {
        name: _with_checks(component, kind, name, method)
        for name, method in methods.items()
        if hasattr(method, "__code__") and not _free(component, name)
    }
    own = {"_watched": component, "_size": size, "__module__": __name__}
    return record(type(component.__name__, (component,), {**found, **own}))


def _free(component: type, name: str) -> bool:
    """Return whether method ``name`` of a class is a static or a class method."""
    return isinstance(inspect.getattr_static(component, name), staticmethod | classmethod)


def _with_checks(component: type, kind: str, name: str, method: Callable[..., object]) -> Callable[..., object]:
    """Wrap a method: count the normals it draws, and raise FaultError if it fails or returns a wrong result."""
    check = CHECKS.get((kind, name))
    draws = name in _DRAWING.get(kind, ())

    @wraps(method)
    def called(self: object, *args: object, **kwargs: object) -> object:
        """Call the wrapped method; raise FaultError with its place if it fails or returns a wrong result."""
        if draws and not getattr(self, "draws_alone", False):
            args = tuple(_Counted(arg, (component, name)) if isinstance(arg, Draw | Drawn) else arg for arg in args)
        try:
            result = method(self, *args, **kwargs)
        except FaultError:
            raise
        except (Exception, SystemExit) as error:
            # An array of several numbers is refused before JAX can say why.
            kinds = type(error), jax.errors.TracerBoolConversionError
            asked = kinds[str(error).startswith("The truth value of an array")]
            advice = next((words for kind, words in _ADVICE if issubclass(asked, kind)), in_one_line(error))
            no_noise = isinstance(error, AttributeError) and error.obj is None and error.name == "normals"
            if kind == "vehicle" and no_noise:
                advice = _NO_NOISE
            place = where_raised(error, [method.__code__.co_filename, file_of_class(component)])
            where = f" ({place})" if place else ""
            raise FaultError(_blamed(component, name, advice) + where, component) from None
        if check is not None:
            for problem in check(self, args, result):
                raise FaultError(_blamed(component, name, problem), component)
        return result

    return called


def _blamed(component: type, method: str, problem: str) -> str:
    """Return an error text that begins with the file, class and method at fault."""
    return f"{file_of_class(component)}: {component.__name__}.{method}: {problem}"


assert not set(PLAIN) & {kind for kind, _ in CHECKS}
