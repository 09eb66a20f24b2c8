"""Users' own functions: policies that command the vehicles and estimators that feed the controllers.

A policy is one of

- a function ``policy(reading)`` that returns what ``Simulation.step`` takes as its command. It is called between two
  ticks with NumPy arrays, whatever it is written in;
- the same function under ``jax.jit``. It is compiled into the loop, for thousands of worlds at once;
- an object with ``init(reading)``, which returns its memory, and ``step(reading, memory)``, which returns the command
  and the new memory (any tree of arrays). It is compiled into the loop, its attributes as constants: a rollout looks at
  them when it begins, and compiles anew where one has changed. With an attribute ``compiled = False`` it is called
  between two ticks with NumPy arrays, and its memory may be anything;
- a class: each world has an object of its own, made without arguments, which is called as ``object(reading)`` between
  two ticks and may keep in itself what it likes;
- a dict of these by the names of fleets or vehicles: each sees the readings of its own, and commands these. Who is in
  none flies by its own guidance. All are compiled into the loop if each of them can be.

An estimator is the same with a ``qrsim.Estimate`` in place of the command; where that is NaN, a controller believes
what it did before, as with sensors that have nothing to say. Both see readings only, never the truth.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol, TypeVar, cast

import jax

from qrsim.core.sameness import Itself, sameness
from qrsim.errors import QrsimError, RunError, UsageError, did_you_mean
from qrsim.files.code import load_object, where_raised

T = TypeVar("T")


class WithMemory(Protocol):
    """A user's own object that is compiled into the loop."""

    def init(self, reading: object) -> object:
        """Return the initial memory, from the first reading."""
        ...

    def step(self, reading: object, memory: object) -> object:
        """Return the commands or estimates for a reading, and the new memory."""
        ...


class _Readings(Protocol):
    """Readings that can be indexed by fleet and by vehicle."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fleets and vehicles."""

    def of(self, name: str) -> _Readings:
        """Return the readings of one fleet or vehicle, by name."""


class Compiled(Protocol):
    """A function under ``jax.jit``."""

    @property
    def __wrapped__(self) -> Callable[..., object]:
        """The function itself."""
        ...


@dataclass(frozen=True)
class UserFunction:
    """A policy or an estimator; equal if made of the same object with the same attributes.

    Attributes:
        what: "policy" or "estimator", for messages.
        name: what the user calls it.
        identity: of the user's own object and its attributes, which are constants of a program.
        compiled: whether it becomes part of the loop; else it is called with NumPy arrays.
        init: from a reading to the memory.
        step: from a reading and the memory to the result and the memory.
        given: the user's own object.
    """

    what: str
    name: str
    identity: Hashable
    compiled: bool = field(compare=False)
    init: Callable[..., object] = field(compare=False)
    step: Callable[..., object] = field(compare=False)
    given: object = field(compare=False)

    @contextmanager
    def blamed(self, where: str = "") -> Iterator[None]:
        """In the context, add the user's function's name and the line at fault to every error; ``where``: more for the
        message.

        Raises:
            UsageError: as raised inside, with a longer message.
            RunError: anything else that the user's function raised, which stays its cause.
        """
        try:
            yield
        except UsageError as error:
            raise UsageError(f"{self.what} {self.name}{where}: {error}") from None
        except QrsimError:
            raise
        except Exception as error:
            location = where_raised(error)
            raised = f"{type(error).__name__}: {error}" + (f" ({location})" if location else "")
            raise RunError(f"{self.what} {self.name}{where}: {raised}") from error

    def __reduce__(self) -> tuple[object, ...]:
        return user_function, (self.what, self.given)

    def __call__(self, reading: object, memory: object) -> tuple[object, object]:
        """Call the function; return its result and the new memory."""
        result = self.step(reading, memory)
        if not isinstance(result, tuple) or len(result) != 2:
            raise UsageError("step must return a pair, the result and the new memory")
        return result


def user_function(what: str, given: object) -> UserFunction | None:
    """Wrap a user's policy or estimator (``what``), given as function, class or object, as a ``UserFunction``; None for
    None.

    Raises:
        UsageError: it is none of the kinds above, or takes other arguments.
    """
    if given is None or isinstance(given, UserFunction):
        return given
    if isinstance(given, Mapping):
        return _of_teams(what, given)
    name: str = getattr(given, "__qualname__", None) or type(given).__qualname__
    if inspect.isclass(given):
        return _of_class(what, name, given)
    if hasattr(given, "init") and hasattr(given, "step"):
        own = cast(WithMemory, given)
        _check_arguments(what, f"{name}.init", own.init, ["reading"])
        _check_arguments(what, f"{name}.step", own.step, ["reading", "memory"])
        compiled = bool(getattr(given, "compiled", True))
        return UserFunction(
            what, name, sameness(given) if compiled else Itself(given), compiled, own.init, own.step, given
        )
    if not callable(given):
        raise UsageError(
            f"{what}: expected a function of a reading, an object with init and step, a class, or a dict of these by "
            f"fleet, found {given!r}"
        )
    # Compiled into the loop, the user's own function is what is traced.
    compiled = isinstance(given, jax.stages.Wrapped)
    plain: Callable[[object], object] = cast(Compiled, given).__wrapped__ if compiled else given
    _check_arguments(what, name, plain, ["reading"])

    def step(reading: object, memory: object) -> tuple[object, object]:
        """Return the function's result, and the memory unchanged, since a plain function has none."""
        return plain(reading), memory

    return UserFunction(what, name, Itself(given), compiled, lambda reading: None, step, given)


def _of_class(what: str, name: str, given: type) -> UserFunction:
    """Wrap a user's class as a ``UserFunction``: each world gets an instance of it, kept as its memory.

    Args:
        what: word for it in messages, such as "policy".
        name: of the class, in messages.
        given: class with ``__call__(self, reading)``.
    """
    if hasattr(given, "init") and hasattr(given, "step"):
        raise UsageError(f"{what} {name}: a class with init and step; give an object of it, {name}(...)")
    if "__call__" not in vars(given) and not any("__call__" in vars(base) for base in given.__mro__[1:-1]):
        raise UsageError(f"{what} {name}: objects of this class cannot be called; give it __call__(self, reading)")
    _check_arguments(what, name, given, [])
    _check_arguments(what, f"{name}.__call__", given.__call__, ["self", "reading"])

    def step(reading: object, memory: object) -> tuple[object, object]:
        """Return the result of calling ``memory``, this world's instance of the class, and that instance."""
        return cast(Callable[[object], object], memory)(reading), memory

    return UserFunction(what, name, Itself(given), False, lambda reading: given(), step, given)


def _of_teams(what: str, given: Mapping[object, object]) -> UserFunction:
    """Wrap policies by name of a fleet or vehicle as a single ``UserFunction``."""
    if what != "policy":
        raise UsageError(f"{what}: a dict by fleet is for policies alone; an {what} speaks for all vehicles")
    members = {name: user_function(what, each) for name, each in given.items()}
    own = {str(name): member for name, member in members.items() if member is not None}
    if not own:
        raise UsageError(f"{what}: the dict names no policy for any fleet or vehicle")

    def init(reading: _Readings) -> object:
        """Return each policy's initial memory by its name; raises UsageError for unknown fleets and vehicles."""
        for name in own:
            if name not in reading.names:
                raise UsageError(f"no fleet and no vehicle is called '{name}'{did_you_mean(name, reading.names)}")
        return {name: _blamed(name, partial(member.init, reading.of(name))) for name, member in own.items()}

    def step(reading: _Readings, memory: Mapping[str, object]) -> tuple[object, object]:
        """Return the commands of all policies by fleet or vehicle, and the policies' new memories by name."""
        asked: dict[str, object] = {}
        after: dict[str, object] = {}
        for name, member in own.items():
            part = reading.of(name)
            theirs, after[name] = _blamed(name, partial(member, part, memory[name]))
            _take(asked, name, theirs, part.names)
        return asked, after

    title = ", ".join(f"{name}: {member.name}" for name, member in own.items())
    identity = tuple((name, member.identity) for name, member in own.items())
    compiled = all(member.compiled for member in own.values())
    return UserFunction(what, f"{{{title}}}", identity, compiled, init, step, dict(given))


def _blamed(team: str, call: Callable[[], T]) -> T:
    """Return ``call()``; a UsageError that it raises gets the name of the policy (``team``) in front."""
    try:
        return call()
    except UsageError as error:
        raise UsageError(f"of '{team}': {error}") from None


def _take(asked: dict[str, object], team: str, theirs: object, names: Sequence[str]) -> None:
    """Add one policy's commands to ``asked``; raises UsageError for vehicles of others and for a second command of a
    vehicle."""
    each = theirs if isinstance(theirs, Mapping) else {team: theirs}
    for name, command in each.items():
        if name not in names:
            raise UsageError(f"of '{team}': it commands '{name}', which is not its own{did_you_mean(str(name), names)}")
        if name in asked:
            raise UsageError(f"of '{team}': '{name}' is commanded by another policy too")
        asked[name] = command


def _check_arguments(what: str, name: str, function: Callable[..., object], arguments: list[str]) -> None:
    """Raise UsageError, beginning with ``what``, if a user's function cannot be called with arguments of these
    names."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        expected = f"{len(arguments)} argument{'s' if len(arguments) > 1 else ''} ({', '.join(arguments)})"
        raise UsageError(f"{what} {name}: it is called with {expected}, but takes {signature}") from None


def sources_by_team(source: str) -> dict[str, str] | None:
    """Split the text ``NAME=SOURCE,NAME=SOURCE`` to {fleet or vehicle: source}; None for a single source."""
    pairs = [part.partition("=") for part in source.split(",")]
    if not all(equals and name.strip() and ":" not in name for name, equals, _ in pairs):
        return None
    return {name.strip(): each.strip() for name, _, each in pairs}


def load_function(what: str, source: str, words: Sequence[str] = ()) -> object:
    """Import the function ``module:name`` or ``file.py:name``; for ``TEAM=SOURCE,...`` return a dict of functions by
    team.

    ``scouts=file.py:one,cats=file.py:other`` is a dict of these, a policy for each fleet or vehicle.

    Raises:
        UsageError: no such module, file or name in it, or it fails while it is imported.
    """
    teams = sources_by_team(source)
    if teams is None:
        return load_object(what, source, words)
    return {name: load_object(what, each) for name, each in teams.items()}
