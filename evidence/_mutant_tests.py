"""Which tests may kill a mutant, the likeliest and quickest first.

A map is measured once: of each file of tests, how long it takes and which functions of the package it enters. What is
not entered cannot fail. A file of tests is measured anew when it changes.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from evidence._mutant_runs import SURVIVED, Workshop
from evidence._mutant_runs import cache as cache_folder
from evidence._mutants import ROOT, SOURCE, Literal

TESTS = ("tests/models", "tests/control", "tests/laws")
SINGLE = ("tests/test_control.py",)
# These compare what is declared, without computing with it.
LAST = ("tests/test_docs_models.py", "tests/laws/test_ranges.py")
# A function that this share of the files enters is one that importing calls.
_BY_IMPORT = 0.7
# So many files are near at most: a module that all import is named in most of them.
_NEAREST = 6

Map = dict[str, dict[str, Any]]


class NotPassingError(Exception):
    """Tests that fail without any mutant can tell nothing."""


def test_files() -> list[str]:
    """Return the files of tests that are run, relative to the root of the project."""
    found = [path for folder in TESTS for path in sorted((ROOT / folder).rglob("test_*.py"))]
    return [*(str(path.relative_to(ROOT)) for path in found), *SINGLE, LAST[0]]


def measured(shop: Workshop, say: Any = None) -> Map:
    """Return the map, measuring what it lacks: file -> {digest, seconds, entered}.

    Raises:
        NotPassingError: a file of tests fails as it is.
    """
    path = cache_folder() / "map.json"
    known: Map = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    found: Map = {}
    for file in test_files():
        digest = hashlib.sha256((ROOT / file).read_bytes()).hexdigest()[:16]
        if known.get(file, {}).get("digest") != digest:
            outcome = shop.run([file], watched=True)
            if outcome.killer:
                raise NotPassingError(f"{outcome.killer} fails without a mutant ({outcome.result})")
            seconds = shop.run([file]).seconds if outcome.result == SURVIVED else 0.0
            known[file] = {"digest": digest, "seconds": seconds, "entered": outcome.entered, "tests": bool(seconds)}
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(known), "utf-8")
            if say:
                say(f"{file}: {seconds} s, {len(outcome.entered)} functions")
        if known[file]["tests"]:
            found[file] = {**known[file], "entered": {tuple(item) for item in known[file]["entered"]}}
    return found


@lru_cache(maxsize=256)
def _users(file: str) -> tuple[str, ...]:
    """Return the modules of the package that import something of a module, and itself."""
    name = re.escape(file.removesuffix(".py").replace("/", ".").removesuffix(".__init__"))
    parent, _, last = name.rpartition("\\.")
    pattern = re.compile(rf"(from|import) {name}\b|from {parent} import [^\n]*\b{last}\b")
    users = [path for path in _sources() if pattern.search(_text(path))]
    return (file, *(str(path.relative_to(SOURCE)) for path in users))


@cache
def _sources() -> tuple[Path, ...]:
    return tuple(sorted((SOURCE / "qrsim").rglob("*.py")))


@cache
def _text(path: Path) -> str:
    return path.read_text("utf-8")


def _nearness(test: str, file: str) -> int:
    """Return how far a file of tests is from a module: 0 has its name, 1 names it, 2 shares its folder."""
    stem = Path(test).stem.removeprefix("test_")
    if stem in (Path(file).stem, Path(file).parent.name):
        return 0
    module = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    if module in _text(ROOT / test):
        return 1
    return 2 if str(Path(test).parent).removeprefix("tests/") in str(Path(file).parent) else 3


def candidates(literal: Literal, known: Map) -> list[str]:
    """Return the files of tests that can tell a mutant of a literal from the original, the likeliest first."""
    file, owner = literal.file, literal.owner
    counts = Counter(entry for item in known.values() for entry in item["entered"])
    usual = {entry for entry, count in counts.items() if count > _BY_IMPORT * len(known)}
    by_owner: list[str] = []
    if literal.kind == "function" and (file, owner) not in usual:
        by_owner = [test for test, item in known.items() if (file, owner) in item["entered"]]
    else:
        # Whoever computes with it: functions of this module, or else of those that import something of it.
        for modules in ({file}, {file, *_users(file)}):
            computing = {entry for entry in counts if entry[0] in modules and not _is_class(entry[1])} - usual
            by_owner = [test for test, item in known.items() if computing & item["entered"]]
            if by_owner and literal.kind != "module":
                break
    chosen = {*by_owner, *(test for test in known if _nearness(test, file) < 2)}
    chosen -= set(LAST)
    ordered = sorted(chosen, key=lambda test: (_nearness(test, file), known[test]["seconds"]))
    # Whoever computes with a parameter knows nothing of its bounds.
    return [*LAST, *ordered] if literal.kind == "bound" else [*ordered, *LAST]


def near_ones(literal: Literal) -> list[str]:
    """Return the files of tests beside a literal's module, the likeliest and shortest first, and those of defaults."""
    near = [test for test in test_files() if _nearness(test, literal.file) < 2 and test not in LAST]
    near.sort(key=lambda test: (_nearness(test, literal.file), len(_text(ROOT / test))))
    near = near[:_NEAREST]
    return [*LAST, *near] if literal.kind in ("bound", "class") else [*near, *LAST]


def long_ones(literal: Literal) -> list[str]:
    """Return the files whose long tests are tried where no short one fails."""
    return [test for test in test_files() if _nearness(test, literal.file) < 2]


def _is_class(name: str) -> bool:
    """Return whether what is entered is the body of a class or a module, as importing does."""
    last = name.rpartition(".")[2].lstrip("_")
    return not last or last[0].isupper() or last[0] == "<"
