"""Users' own functions: policies that command the vehicles and estimators that feed the controllers.

A policy is one of

- a function ``policy(reading)`` that returns what ``Simulation.step`` takes as its command. It is called between two
  ticks with NumPy arrays, whatever it is written in;
- the same function under ``jax.jit``. It is compiled into the loop, for thousands of worlds at once;
- an object with ``init(reading)``, which returns its memory, and ``step(reading, memory)``, which returns the command
  and the new memory (any tree of arrays). It is compiled into the loop, its attributes as constants: a rollout looks at
  them when it begins, and compiles anew where one has changed.

An estimator is the same with a ``qrsim.Estimate`` in place of the command; where that is NaN, a controller believes
what it did before, as with sensors that have nothing to say. Both see readings only, never the truth.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import jax

from qrsim.core.sameness import Itself, sameness
from qrsim.errors import QrsimError, RunError, UsageError
from qrsim.files.code import load_object


class WithMemory(Protocol):
    """A user's own object that is compiled into the loop."""

    def init(self, reading: Any) -> object:
        """Return its memory."""
        ...

    def step(self, reading: Any, memory: Any) -> object:
        """Return the result and the new memory, which is checked when it is called."""
        ...


class Compiled(Protocol):
    """A function under ``jax.jit``."""

    @property
    def __wrapped__(self) -> Callable[[Any], object]:
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
    init: Callable[[Any], object] = field(compare=False)
    step: Callable[[Any, Any], object] = field(compare=False)
    given: object = field(compare=False)

    @contextmanager
    def blamed(self, where: str = "") -> Iterator[None]:
        """Add the function and the line at fault to every error of the context.

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
            raise RunError(f"{self.what} {self.name}{where}: {type(error).__name__}: {error}") from error

    def __reduce__(self) -> tuple[Any, ...]:
        return user_function, (self.what, self.given)

    def __call__(self, reading: object, memory: object) -> tuple[object, object]:
        """Call the function; return its result and the new memory."""
        result = self.step(reading, memory)
        if not isinstance(result, tuple) or len(result) != 2:
            raise UsageError("step must return a pair, the result and the new memory")
        return result


def user_function(what: str, given: object) -> UserFunction | None:
    """Wrap a user's policy or estimator; None for None.

    Raises:
        UsageError: it is none of the kinds above, or takes other arguments.
    """
    if given is None or isinstance(given, UserFunction):
        return given
    name: str = getattr(given, "__qualname__", None) or type(given).__qualname__
    if not inspect.isclass(given) and hasattr(given, "init") and hasattr(given, "step"):
        own = cast(WithMemory, given)
        _check_arguments(what, f"{name}.init", own.init, ["reading"])
        _check_arguments(what, f"{name}.step", own.step, ["reading", "memory"])
        return UserFunction(what, name, sameness(given), True, own.init, own.step, given)
    if not callable(given) or inspect.isclass(given):
        raise UsageError(f"{what}: expected a function of a reading, or an object with init and step, found {given!r}")
    # Compiled into the loop, the user's own function is what is traced.
    compiled = isinstance(given, jax.stages.Wrapped)
    plain: Callable[[object], object] = cast(Compiled, given).__wrapped__ if compiled else given
    _check_arguments(what, name, plain, ["reading"])

    def step(reading: object, memory: object) -> tuple[object, object]:
        return plain(reading), memory

    return UserFunction(what, name, Itself(given), compiled, lambda reading: None, step, given)


def _check_arguments(what: str, name: str, function: Callable[..., object], arguments: list[str]) -> None:
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        expected = f"{len(arguments)} argument{'s' if len(arguments) > 1 else ''} ({', '.join(arguments)})"
        raise UsageError(f"{what} {name}: it is called with {expected}, but takes {signature}") from None


def load_function(what: str, source: str, words: Sequence[str] = ()) -> object:
    """Load the function ``module:name`` or ``file.py:name``, see ``qrsim.files.code``.

    Raises:
        UsageError: no such module, file or name in it, or it fails while it is imported.
    """
    return load_object(what, source, words)
