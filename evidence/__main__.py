"""Run studies and write docs/evidence/NAME.json: ``python -m evidence [NAME ...]``."""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import math
import os
import pkgutil
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import jax

import evidence
from qrsim.errors import QrsimError, UsageError, did_you_mean

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = ROOT / "docs" / "evidence"


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
        changed = git("status", "--porcelain", "--", ".", ":(exclude)docs/evidence")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return revision + ("+dirty" if changed else "")


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def machine() -> dict[str, Any]:
    """Return what the numbers were measured on."""
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "os": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "jax": jax.__version__,
    }


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


def write(name: str, module: ModuleType, revision: str, output: Path) -> Path:
    """Run the full form of one study and write its file."""
    began = time.perf_counter()
    results = plain(module.run(full=True))
    report = {
        "study": name,
        "commit": revision,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "seed": getattr(module, "SEED", None),
        "machine": machine(),
        "duration_s": round(time.perf_counter() - began, 1),
        "results": results,
    }
    output.mkdir(parents=True, exist_ok=True)
    path = output / f"{name}.json"
    path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return path


def main(arguments: Sequence[str] | None = None, output: Path = OUTPUT) -> int:
    """Run the named studies, all of them where none is named; return the exit code."""
    known = studies()
    parser = argparse.ArgumentParser(
        prog="python -m evidence",
        description="Run studies in full and write docs/evidence/NAME.json.",
        epilog="\n".join(f"{name}: {module.DOC.strip()}" for name, module in known.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="study to run (default: all)")
    names = parser.parse_args(arguments).names
    try:
        for name in names:
            if name not in known:
                raise UsageError(f"no study named '{name}'{did_you_mean(name, known)}")
        revision = commit(ROOT)
        for name in dict.fromkeys(names or known):
            path = write(name, known[name], revision, output)
            print(f"{name}: wrote {path.relative_to(ROOT) if path.is_relative_to(ROOT) else path}")
    except QrsimError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
