"""Run studies and write docs/evidence/NAME.json: ``python -m evidence [--dirty] [NAME[:PART] ...]``.

Some studies have parts, such as the scenarios of ``tasks``. ``NAME:PART`` runs one and puts it in place of what the
file says of it; of each part that was run alone the file says when, where and on which commit, under ``parts``.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import math
import pkgutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import evidence
from evidence import ROOT, docs
from evidence._processes import benchmark
from qrsim.errors import QrsimError, UsageError, did_you_mean

OUTPUT = ROOT / "docs" / "evidence"
DIRTY = "+dirty"


def studies() -> dict[str, ModuleType]:
    """Return the study modules by name, in alphabetical order."""
    names = sorted(m.name for m in pkgutil.iter_modules(evidence.__path__) if not m.name.startswith("_"))
    modules = {name: importlib.import_module(f"evidence.{name}") for name in names}
    return {name: module for name, module in modules.items() if hasattr(module, "run")}


def commit(root: Path) -> str:
    """Return the short commit of the tree, with '+dirty' where files differ from it; 'unknown' outside git.

    The files this program writes do not count as a difference: no study reads them.
    """

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    try:
        revision = git("rev-parse", "--short", "HEAD")
        changed = git("status", "--porcelain", "--", ".", ":(exclude)docs/evidence", ":(exclude)docs/images")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return revision + (DIRTY if changed else "")


def machine() -> dict[str, Any]:
    """Return what the numbers were measured on."""
    found = benchmark("_common").machine()
    return {name: found[name] for name in ("cpu", "cores", "os", "python", "jax")}


def plain(results: Any, path: str = "") -> Any:
    """Return results as JSON-ready numbers.

    Raises:
        TypeError: something is not a dict or a finite number, or a key could not stand in a dotted path.
    """
    if isinstance(results, dict):
        for key in results:
            if not isinstance(key, str) or not key or "." in key or any(c.isspace() for c in key):
                raise TypeError(f"{path or 'results'}: key {key!r} must be a word without dots or spaces")
        return {key: plain(value, f"{path}.{key}".lstrip(".")) for key, value in results.items()}
    if isinstance(results, bool | str | bytes | None) or not math.isfinite(results):
        raise TypeError(f"{path}: {results!r} is not a finite number")
    return results if isinstance(results, int) else float(results)


def write(name: str, module: ModuleType, revision: str, output: Path, part: str | None = None) -> Path:
    """Run the full form of one study, or one part of it, and write its file.

    Raises:
        UsageError: a part is to go into a file that is not there.
    """
    path = output / f"{name}.json"
    if part is not None and not path.is_file():
        raise UsageError(f"{name}:{part}: there is no {path.name} yet to put it into; run all of '{name}' first")
    began = time.perf_counter()
    results = plain(module.run(full=True) if part is None else module.run(full=True, parts=(part,)))
    run = {
        "commit": revision,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "seed": getattr(module, "SEED", None),
        "machine": machine(),
        "duration_s": round(time.perf_counter() - began, 1),
    }
    if part is None:
        report = {"study": name, **run, "results": results}
    else:
        report = json.loads(path.read_text(encoding="utf-8"))
        report["results"] |= results
        report["parts"] = report.get("parts", {}) | {part: run}
        if set(report["parts"]) == set(module.PARTS):
            report |= run  # nothing is left of the run of the whole
    output.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return path


def _chosen(names: Sequence[str], known: dict[str, ModuleType]) -> list[tuple[str, str | None]]:
    """Return the studies, each with its part or None.

    Raises:
        UsageError: there is no such study, or no such part of it.
    """
    chosen = []
    for text in names:
        name, colon, part = text.partition(":")
        if name not in known:
            raise UsageError(f"no study named '{name}'{did_you_mean(name, known)}")
        parts = getattr(known[name], "PARTS", ())
        if colon and part not in parts:
            has = f"it has {', '.join(parts)}" if parts else "it has none"
            raise UsageError(f"{name}: no part named '{part}'{did_you_mean(part, parts)}; {has}")
        chosen.append((name, part if colon else None))
    return chosen


def main(arguments: Sequence[str] | None = None, output: Path = OUTPUT) -> int:
    """Run the named studies, all of them where none is named; return the exit code."""
    known = studies()
    parser = argparse.ArgumentParser(
        prog="python -m evidence",
        description="Run studies in full and write docs/evidence/NAME.json.",
        epilog="\n".join(f"{name}: {module.DOC.strip()}" for name, module in known.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME[:PART]", help="study to run, or a part (default: all)")
    parser.add_argument("--dirty", action="store_true", help="run although files differ from the commit, and say so")
    asked = parser.parse_args(arguments)
    try:
        chosen = _chosen(asked.names or list(known), known)
        revision = commit(ROOT)
        if revision.endswith(DIRTY) and not asked.dirty:
            raise UsageError(
                f"files differ from commit {revision.removesuffix(DIRTY)}, so nobody could repeat what is measured: "
                f"commit first, or give --dirty to write '{revision}'"
            )
    except UsageError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    code = 0
    for name, part in dict.fromkeys(chosen):
        try:
            path = write(name, known[name], revision, output, part)
            print(f"{name}: wrote {path.relative_to(ROOT) if path.is_relative_to(ROOT) else path}", flush=True)
        except QrsimError as error:
            # The others may take hours, and know nothing of this one.
            print(f"error: {error}", file=sys.stderr)
            code = code or error.exit_code
    if output == OUTPUT and docs.differences(ROOT):
        print("the documentation shows other numbers; `python -m evidence.docs` names them, with --write it mends them")
    return code


if __name__ == "__main__":
    raise SystemExit(main())
