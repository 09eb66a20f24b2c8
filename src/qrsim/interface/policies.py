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

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax

from qrsim.core.sameness import Itself, sameness
from qrsim.errors import QrsimError, RunError, UsageError, did_you_mean, nearest
from qrsim.files.user_files import check_file


@dataclass(frozen=True)
class UserFunction:
    """A policy or an estimator; two are equal that were made of the same object with the same attributes.

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
    init: Callable[[Any], Any] = field(compare=False)
    step: Callable[[Any, Any], Any] = field(compare=False)
    given: Any = field(compare=False)

    @contextmanager
    def blamed(self, where: str = "") -> Iterator[None]:
        """Say in every error of the context whose fault it is and where.

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

    def __call__(self, reading: Any, memory: Any) -> tuple[Any, Any]:
        """Return the result and the new memory."""
        result = self.step(reading, memory)
        if not isinstance(result, tuple) or len(result) != 2:
            raise UsageError("step must return a pair, the result and the new memory")
        return result


def user_function(what: str, given: Any) -> UserFunction | None:
    """Return what a user gave as a policy or an estimator, None for None.

    Raises:
        UsageError: it is none of the kinds above, or takes other arguments.
    """
    if given is None or isinstance(given, UserFunction):
        return given
    name = getattr(given, "__qualname__", None) or type(given).__qualname__
    if not inspect.isclass(given) and hasattr(given, "init") and hasattr(given, "step"):
        _check_arguments(what, f"{name}.init", given.init, ["reading"])
        _check_arguments(what, f"{name}.step", given.step, ["reading", "memory"])
        return UserFunction(what, name, sameness(given), True, given.init, given.step, given)
    if not callable(given) or inspect.isclass(given):
        raise UsageError(f"{what}: expected a function of a reading, or an object with init and step, found {given!r}")
    # Compiled into the loop, the user's own function is what is traced.
    compiled = isinstance(given, jax.stages.Wrapped)
    plain = given.__wrapped__ if compiled else given
    _check_arguments(what, name, plain, ["reading"])

    def step(reading: Any, memory: Any) -> tuple[Any, Any]:
        return plain(reading), memory

    return UserFunction(what, name, Itself(given), compiled, lambda reading: None, step, given)


def _check_arguments(what: str, name: str, function: Any, arguments: list[str]) -> None:
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        expected = f"{len(arguments)} argument{'s' if len(arguments) > 1 else ''} ({', '.join(arguments)})"
        raise UsageError(f"{what} {name}: it is called with {expected}, but takes {signature}") from None


def load_function(what: str, source: str, words: Sequence[str] = ()) -> Any:
    """Return what ``module:name`` or ``file.py:name`` names; modules in the working folder are found too.

    Args:
        what: it is, for messages.
        source: its name.
        words: that would have been understood in its place.

    Raises:
        UsageError: no such module, file or name in it, or it fails while it is imported.
    """
    place, colon, name = source.rpartition(":")
    if not colon or not place or not name:
        built_in = nearest(source, words)
        meant = f"; did you mean '{built_in}'?" if built_in else "".join(f", or '{word}'" for word in words)
        example = "expected module:function or file.py:function, for example my_policy:hover"
        raise UsageError(f"{what} {source}: {example}{meant}")
    module = _import_file(what, Path(place)) if place.endswith(".py") else _import_module(what, place)
    if not hasattr(module, name):
        public = [other for other in vars(module) if not other.startswith("_")]
        raise UsageError(f"{what} {source}: {place} has no '{name}'{did_you_mean(name, public)}")
    return getattr(module, name)


def _import_module(what: str, name: str) -> Any:
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name == name.split(".")[0] or error.name == name:
            near = [path.stem for path in Path.cwd().glob("*.py")]
            raise UsageError(f"{what}: no module is called '{name}'{did_you_mean(name, near)}") from None
        raise UsageError(f"{what} {name}: it imports '{error.name}', which is not there") from None
    except Exception as error:
        raise UsageError(f"{what} {name}: importing it failed: {type(error).__name__}: {error}") from error


def _import_file(what: str, path: Path) -> Any:
    if not path.is_file():
        near = [str(other) for other in path.parent.glob("*.py")] if path.parent.is_dir() else []
        hint = did_you_mean(str(path), near)
        raise UsageError(f"{what}: there is no file {path}{hint if 'mean' in hint else ''}")
    try:
        check_file(path)
    except OSError as error:
        raise UsageError(f"{what} {path}: cannot be read: {error.strerror}") from None
    name = str(path.resolve())
    # A file that holds both a policy and an estimator is one module.
    if name in sys.modules:
        return sys.modules[name]
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    # Dataclasses look for their own module there.
    sys.modules[name] = module
    try:
        specification.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise UsageError(f"{what} {path}: importing it failed: {type(error).__name__}: {error}") from error
    return module
