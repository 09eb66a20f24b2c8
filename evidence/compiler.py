"""Random programs by the package's own code generator, against a reference that says how far it may be."""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tests.engine.reference import trying

DOC = "random programs by the package's own code generator, against a reference with bounds"
SEED = trying.SEED
PROGRAMS, PART = 20_000, 50


def run(full: bool) -> dict[str, Any]:
    """Return how many programs ended how; the full form flies 20 000, in two processes, and can be resumed.

    Args:
        full: all of them, or so many that every kind of operation is among them.
    """
    total = PROGRAMS if full else 40
    found = _all_of(total) if full else _part((0, total))
    counts = dict.fromkeys(trying.OUTCOMES, 0)
    wrong = []
    for number, what in sorted(found.items()):
        if what in counts:
            counts[what] += 1
        else:
            wrong.append(f"{number}: {what}")
    for line in wrong[:5]:
        print(line, file=sys.stderr)
    compiled = total - counts["handed over"]
    return {
        "programs": total,
        "compiled": compiled,
        "handed_over": counts["handed over"],
        "equal_to_the_bit": counts["equal"],
        "within": counts["within"],
        "ambiguous": counts["ambiguous"],
        "different": len(wrong),
    }


def _all_of(total: int) -> dict[int, str]:
    """Try all programs by two processes; what is done already lies in the folder of temporary files."""
    place = Path(tempfile.gettempdir()) / f"qrsim-evidence-compiler-{_state()}.json"
    found = {int(k): v for k, v in json.loads(place.read_text(encoding="utf-8")).items()} if place.exists() else {}
    parts = [(first, min(first + PART, total)) for first in range(0, total, PART)]
    parts = [part for part in parts if not found.keys() >= set(range(*part))]
    from rich.progress import track

    # Anew now and then, because compiled programs stay in memory.
    with get_context("spawn").Pool(2, maxtasksperchild=10) as pool:
        for done in track(pool.imap_unordered(_part, parts), "random programs", total=len(parts)):
            found |= done
            place.write_text(json.dumps(found), encoding="utf-8")
    return found


def _state() -> str:
    """Return what a result depends on: the text of the code generator and of the reference."""
    import qrsim

    digest = hashlib.sha256()
    root = Path(qrsim.__file__).parent
    reference = Path(trying.__file__).parent
    for path in sorted([*root.glob("engine/llvm/*.py"), *root.glob("core/*.py"), *reference.glob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _part(numbers: tuple[int, int]) -> dict[int, str]:
    """Return what became of some programs."""
    found = {}
    for number in range(*numbers):
        try:
            found[number] = trying.tried(number)[0]
        except Exception as error:
            found[number] = f"{type(error).__name__}: {error}"
    return found
