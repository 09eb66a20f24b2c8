"""Which tests may kill a mutant, the likeliest and quickest first.

What each test enters is measured once (_mutant_forks.py), in a fork of its own: of a mutant it can tell only where it
enters a function that computes with it. A test is measured anew when its file changes.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

from evidence._mutant_names import computing
from evidence._mutant_runs import cache as cache_folder
from evidence._mutants import ROOT, Literal

TESTS = ("tests/models", "tests/control", "tests/laws")
SINGLE = ("tests/test_control.py",)
# These compare what is declared, without computing with it.
LAST = ("tests/test_docs_models.py",)
# Tests of so many files and seconds are run at once.
_FILES, _SECONDS = 3, 12.0


class NotPassingError(Exception):
    """Tests that fail without any mutant can tell nothing."""


class Measured(NamedTuple):
    """What is known of a test: its seconds, and the functions that it enters, as (file below src/, qualified name)."""

    seconds: float
    entered: frozenset[tuple[str, str]]


Map = dict[str, Measured]


def test_files() -> list[str]:
    """Return the files of tests that are run, relative to the root of the project."""
    found = [path for folder in TESTS for path in sorted((ROOT / folder).rglob("test_*.py"))]
    return [*(str(path.relative_to(ROOT)) for path in found), *SINGLE, LAST[-1]]


def file_of(test: str) -> str:
    """Return the file of a test."""
    return test.partition("::")[0]


@cache
def digest(file: str) -> str:
    """Return what tells one text of a file of tests from another; nothing of a file that is gone."""
    path = ROOT / file
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else ""


def map_path() -> Path:
    """Return where the map is kept."""
    return cache_folder() / "tests.jsonl"


def read_map() -> Map:
    """Return the map of what has been measured and holds still; a test that failed then is not in it."""
    found: Map = {}
    path = map_path()
    for line in path.read_text("utf-8").splitlines() if path.is_file() else ():
        try:
            entry = json.loads(line)
            test, entered = entry["test"], frozenset((sys.intern(file), name) for file, name in entry["entered"])
        except (ValueError, KeyError, TypeError):
            continue  # of a process that was ended while it wrote
        if entry["digest"] == digest(file_of(test)):
            found[test] = Measured(entry["s"], entered)
    return found


def add_to_map(test: str, seconds: float, entered: Iterable[tuple[str, str]]) -> None:
    """Keep what a test enters."""
    path = map_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    entry = {"test": test, "digest": digest(file_of(test)), "s": seconds, "entered": sorted(entered)}
    with path.open("a", encoding="utf-8") as file:  # one write, so that several processes may share the file
        file.write(json.dumps(entry) + "\n")


@cache
def _text(path: Path) -> str:
    return path.read_text("utf-8")


@cache
def nearness(test: str, file: str) -> int:
    """Return how far a file of tests is from a module: 0 has its name, 1 names it, 2 shares its folder."""
    stem = Path(test).stem.removeprefix("test_")
    if stem in (Path(file).stem, Path(file).parent.name):
        return 0
    module = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    if module in _text(ROOT / test):
        return 1
    return 2 if str(Path(test).parent).removeprefix("tests/") in str(Path(file).parent) else 3


def candidates(literal: Literal, known: Map) -> list[str]:
    """Return the tests that can tell a mutant of a literal from the original, the likeliest first."""
    functions = computing(literal)
    chosen = {test for test, item in known.items() if functions & item.entered}
    chosen |= {test for test in known if nearness(file_of(test), literal.file) < 1}
    return sorted(chosen, key=lambda test: (nearness(file_of(test), literal.file), known[test].seconds))


def batches(tests: Iterable[str], known: Map) -> list[list[str]]:
    """Return tests in their order as lists that are run at once."""
    found: list[list[str]] = []
    seconds, files = 0.0, set[str]()
    for test in tests:
        seconds, files = seconds + known[test].seconds, {*files, file_of(test)}
        if not found or seconds > _SECONDS or len(files) > _FILES:
            found.append([])
            seconds, files = known[test].seconds, {file_of(test)}
        found[-1].append(test)
    return found


def long_ones(literal: Literal) -> list[str]:
    """Return the files whose long tests are tried where no short one fails."""
    return [test for test in test_files() if nearness(test, literal.file) < 2]
