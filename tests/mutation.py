"""Mutation testing of models/ and control/ by Cosmic Ray: ``python -m tests.mutation [--each N] [--seed N] PATH ...``.

Cosmic Ray changes the source in place, so it works on a copy of the tree. Each module is tested by the test files named
after it, then by those that import it, then by all of its folder; the first failure kills the mutant.
``cosmic-ray.toml`` lists what is mutated.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("models", "control")
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", "images", "dist", "build")


class Tried(NamedTuple):
    """Outcome of one mutant: Cosmic Ray's word ("killed", "survived", "incompetent") and the changed lines."""

    outcome: str
    diff: str


def modules(paths: Sequence[str]) -> list[str]:
    """Return the modules below src/qrsim/ at given paths, files or folders; ValueError names a path with none."""
    found = []
    for path in paths:
        place = ROOT / "src/qrsim" / path
        files = [place] if place.is_file() else sorted(place.rglob("*.py"))
        if not files:
            raise ValueError(f"no module at src/qrsim/{path}; give one such as models/sensors/barometer.py")
        found += [file.relative_to(ROOT / "src/qrsim").as_posix() for file in files if file.name != "__init__.py"]
    return found


def selection(module: str) -> list[str]:
    """Return the test files named after a module, those that import it, and the folder of its tests."""
    place = Path(module)
    folder, name = Path("tests", place.parent), ".".join(["qrsim", *place.with_suffix("").parts])
    files = sorted(file for kind in (*FOLDERS, "laws") for file in (ROOT / "tests" / kind).rglob("test_*.py"))
    named = [file for file in files if file.stem.startswith(f"test_{place.stem}") and file.parent == ROOT / folder]
    users = [file for file in files if file not in named and f"from {name} import" in file.read_text("utf-8")]
    return [*(file.relative_to(ROOT).as_posix() for file in named + users), folder.as_posix()]


def tried(module: str, each: int | None, seed: int) -> list[Tried]:
    """Return the outcomes of the mutants of one module, or of a sample of them."""
    from cosmic_ray.config import load_config, serialize_config
    from cosmic_ray.work_db import use_db
    from cosmic_ray.work_item import WorkerOutcome, WorkResult

    config = load_config(str(ROOT / "cosmic-ray.toml"))
    config["module-path"] = [f"src/qrsim/{module}"]
    command = config["test-command"].removeprefix("python").removesuffix(" ".join(f"tests/{name}" for name in FOLDERS))
    config["test-command"] = f"{sys.executable}{command}{' '.join(selection(module))}"
    with tempfile.TemporaryDirectory(prefix="qrsim-mutation-") as name:
        copy = Path(name, "tree")
        shutil.copytree(ROOT, copy, ignore=NOT_COPIED)
        (copy / "cosmic-ray.toml").write_text(serialize_config(config), "utf-8")
        session = str(copy / "session.sqlite")
        # Programs of mutants are nobody else's.
        environment = {**os.environ, "PYTHONPATH": str(copy / "src"), "XDG_CACHE_HOME": str(Path(name, "cache"))}

        def ray(script: str, *arguments: str) -> None:
            line = [sys.executable, "-m", f"cosmic_ray.{script}", *arguments]
            subprocess.run(line, cwd=copy, env=environment, check=True)

        ray("cli", "init", "cosmic-ray.toml", session)
        ray("tools.filters.operators_filter", session, "cosmic-ray.toml")
        with use_db(session) as db:
            items = sorted(db.pending_work_items, key=lambda item: repr(item.mutations))
            drawn = items if each is None else random.Random(seed).sample(items, min(each, len(items)))
            left_out = [item.job_id for item in items if item not in drawn]
            db.set_multiple_results(left_out, WorkResult(WorkerOutcome.SKIPPED))
        # Tests that fail without a mutant would kill all of them.
        ray("cli", "baseline", "cosmic-ray.toml")
        ray("cli", "exec", "cosmic-ray.toml", session)
        with use_db(session) as db:
            results = [result for _, result in db.results if result.worker_outcome != WorkerOutcome.SKIPPED]
        return [Tried(result.test_outcome.value, result.diff) for result in results]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the survivors and the counts; return 1 if a mutant survived."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.partition("\n")[0])
    parser.add_argument("paths", nargs="*", default=FOLDERS, help="modules or folders below src/qrsim (default: both)")
    parser.add_argument("--each", type=int, help="mutants drawn of each module (default: all)")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(arguments)
    try:
        chosen = modules(asked.paths)
    except ValueError as error:
        parser.error(str(error))
    survived = 0
    for module in chosen:
        found = tried(module, asked.each, asked.seed)
        alive = [each for each in found if each.outcome != "killed"]
        survived += len(alive)
        print(
            f"{module}: {len(found) - len(alive)} of {len(found)} mutants killed",
            *(a.diff for a in alive),
            sep="\n",
            flush=True,
        )
    return min(survived, 1)


if __name__ == "__main__":
    raise SystemExit(main())
