"""Loads users' code, named ``module:name`` or ``file.py:name``; it runs local code."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from qrsim.errors import UsageError, did_you_mean, nearest, os_error_as, shortened
from qrsim.files.user_files import check_file

# Modules of files have names of their own, so that a file hides no installed package.
PREFIX = "qrsim_file_"
_PACKAGE = str(Path(__file__).parents[1])
Way = tuple[Callable[[str, str], object], str, str]
FileModules = dict[str, tuple[str, tuple[Way, ...]]]
_TAKEN_IN: dict[str, list[Way]] = {}


def is_code(source: object) -> bool:
    """Return whether a text names code to load: ``module:name`` or ``file.py:name``."""
    place, colon, name = source.rpartition(":") if isinstance(source, str) else ("", "", "")
    return bool(colon and place and name.isidentifier())


def file_of(source: str) -> Path | None:
    """Return the path in ``file.py:name``, None for ``module:name``."""
    place = source.rpartition(":")[0]
    return Path(place) if place.endswith(".py") else None


def anchored(source: str, folder: Path) -> str:
    """Return ``file.py:name`` with its path, relative to ``folder``, made absolute; ``module:name`` unchanged."""
    path = file_of(source)
    if path is None:
        return source
    # Not resolved: a link is where the user says it is.
    return f"{os.path.abspath(folder / os.path.expanduser(path))}:{source.rpartition(':')[2]}"


def load_object(what: str, source: str, words: Sequence[str] = (), *, kind: str = "function") -> Any:
    """Import ``module:name``, also from the working folder, or ``file.py:name``, and return the object; raises
    UsageError, beginning with ``what``, if that fails.

    A file that has changed since it was loaded is loaded anew.

    Args:
        what: it is, for messages.
        source: its name.
        words: that would have been understood in its place.
        kind: of thing that is expected, for messages.

    Raises:
        UsageError: no such module, file or name in it, or it fails while it is imported.
    """
    place, colon, name = source.rpartition(":")
    if not colon or not place or not name:
        built_in = nearest(source, words)
        meant = f"; did you mean '{built_in}'?" if built_in else "".join(f", or '{word}'" for word in words)
        own = "my_policy:hover" if kind == "function" else "./laser.py:Laser"
        example = f"expected module:{kind} or file.py:{kind}, for example {own}"
        raise UsageError(f"{what} {source}: {example}{meant}")
    module = _import_file(what, Path(place)) if place.endswith(".py") else _import_module(what, place)
    if not hasattr(module, name):
        own_names = (other for other in vars(module) if not other.startswith("_"))
        public = [other for other in own_names if kind == "function" or isinstance(getattr(module, other), type)]
        raise UsageError(f"{what} {source}: {place} has no '{name}'{did_you_mean(name, public)}")
    return getattr(module, name)


def taken_in(module: str, again: Callable[[str, str], object], kind: str, source: str) -> None:
    """Register how another process loads a component that a user's file defines: it calls ``again(kind, source)``."""
    ways = _TAKEN_IN.setdefault(module, [])
    if (again, kind, source) not in ways:
        ways.append((again, kind, source))


def files_of(classes: Iterable[type]) -> FileModules:
    """Return module name -> (file, its registered components) for the users' files that define these classes."""
    names = {each.__module__ for each in classes if each.__module__.startswith(PREFIX)}
    return {name: (str(sys.modules[name].__file__), tuple(_TAKEN_IN.get(name, ()))) for name in sorted(names)}


def load_files(files: FileModules) -> None:
    """Import, in another process, the users' files that ``files_of`` listed, and register their components.

    Raises:
        UsageError: a file is not there, or has changed since.
    """
    for name, (file, ways) in files.items():
        if name in sys.modules:
            continue
        loaded = _import_file("component", Path(file))
        # Of two files of one content the second has a name of its own, which depends on which came first.
        if _content_of(loaded.__name__) != _content_of(name):
            raise UsageError(f"component {file}: it has changed since what names it was pickled")
        sys.modules.setdefault(name, loaded)
        for again, kind, source in ways:
            again(kind, source)


def _content_of(module: str) -> str:
    """Return the part of a user module's name that identifies its file's content: 16 digits of the digest."""
    return module.rpartition("_")[2][:16]


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's content as hexadecimal text."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def where_raised(error: BaseException, files: Sequence[str] | None = None) -> str:
    """Return "FILE, line N" of the innermost line of an error's traceback in ``files`` (None: in users' files), ""
    without one.

    Without files, of the innermost line that is neither of qrsim nor of an installed package.
    """
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}, line {error.lineno}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if _is_of_user(frame.filename) if files is None else frame.filename in files:
            return f"{frame.filename}, line {frame.lineno}"
    return ""


def _is_of_user(file: str) -> bool:
    """Return whether a source file is the user's, and not part of this package, of Python or of an installed
    package."""
    return not file.startswith((_PACKAGE, "<frozen")) and "site-packages" not in file


def in_one_line(error: BaseException) -> str:
    """Return an error's type and the first line of its message, as one line of text."""
    said = error.msg if isinstance(error, SyntaxError) else str(error)
    first = said.strip().splitlines()[0] if said.strip() else ""
    return f"{type(error).__name__}: {shortened(first, 400)}" if first else type(error).__name__


def _import_module(what: str, name: str) -> ModuleType:
    """Import a module by name, also from the working folder, and return it; raises UsageError, beginning with
    ``what``."""
    if not all(part.isidentifier() for part in name.split(".")):
        raise UsageError(f"{what}: '{name}' is no module; expected my_package.my_module, or a file that ends in .py")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if f"{name}.".startswith(f"{error.name}."):
            near = _own_modules() if name.startswith("qrsim.") else [path.stem for path in Path.cwd().glob("*.py")]
            raise UsageError(f"{what}: no module is called '{name}'{did_you_mean(name, near)}") from None
        raise UsageError(f"{what} {name}: it imports '{error.name}', which is not there") from None
    except (Exception, SystemExit) as error:
        spec = importlib.util.find_spec(name) if "." not in name else None
        raise UsageError(f"{what} {name}: {_failed(error, [spec.origin or ''] if spec else [])}") from error


def _own_modules() -> list[str]:
    """Return the dotted names of all modules of this package."""
    package = Path(_PACKAGE)
    return [".".join(path.relative_to(package.parent).with_suffix("").parts) for path in package.rglob("*.py")]


def _failed(error: BaseException, files: list[str]) -> str:
    """Return why an import failed, as text, with the line in one of ``files`` if there is one, else the innermost
    line."""
    own = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
    place = where_raised(error, files) or where_raised(error, [name for name in own if "importlib" not in name])
    return f"importing it failed: {in_one_line(error)}" + (f" ({place})" if place else "")


def _import_file(what: str, path: Path) -> ModuleType:
    """Import a Python file as a module with the file's digest in its name, and return it; raises UsageError, beginning
    with ``what``."""
    if not path.exists():
        near = [str(other) for other in path.parent.glob("*.py")] if path.parent.is_dir() else []
        hint = did_you_mean(str(path), near)
        raise UsageError(f"{what}: there is no file {path}{hint if 'mean' in hint else ''}")
    with os_error_as(UsageError, f"{what} {path}: cannot be read"):
        check_file(path)
        content = digest(path)
    # By its content: a saved state finds its records again where the file has been moved, and not in another version.
    name = f"{PREFIX}{path.stem}_{content[:16]}"
    here = str(path.resolve())
    if name in sys.modules and getattr(sys.modules[name], "__file__", "") != here:
        name += hashlib.sha256(here.encode()).hexdigest()[:8]
    if name in sys.modules:
        return sys.modules[name]
    specification = importlib.util.spec_from_file_location(name, here)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    # Dataclasses look for their own module there.
    sys.modules[name] = module
    try:
        # Not by the loader: it would take the compiled form of a version of the same second.
        exec(compile(path.read_bytes(), here, "exec"), vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise UsageError(f"{what} {path}: {_failed(error, [here])}") from error
    return module
