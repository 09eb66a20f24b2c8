"""Mutations of everything that a user can hand in: each is taken, or refused in words, soon and in little memory.

Case k is made from the seed and k alone. The full form does them in two processes, each with an alarm; a case that ends
its process is counted, and another process goes on after it. What has been done is kept in a file and not done again.
"""

from __future__ import annotations

import collections
import contextlib
import faulthandler
import gc
import itertools
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from tests.wrong_input.handing_in import KINDS, Workshop, silence
from tests.wrong_input.mutating import SPENT_S

from evidence import ROOT
from evidence._processes import peak_bytes, reset_peak, resident_bytes
from qrsim.errors import QrsimError

DOC = "10 000 mutations of scenarios, plans, fences, studies, states, runs, logs, bags, maps and ephemerides"
SEED = 20261121
FULL, SMALL = 10_000, 300
PROCESSES = 2
LIMIT_S, LIMIT_BYTES = 2.0, 10**9
# Of the clock, for what waits and takes no time of the processor; a machine with other work to do is slow.
PATIENCE_S, COMPILING_S, PREPARING_S = 30.0, 180.0, 1800.0
OUTCOMES = ("taken", "refused", "traceback", "hang", "memory", "crash")


class _TooLong(BaseException):
    """The alarm; no handler of errors catches it."""


@contextlib.contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    def ring(*_: Any) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def kind_of(number: int) -> str:
    """Return the kind of a case: spread evenly, so that any hundred in a row have all."""
    names = [name for name, (share, _) in KINDS.items() for _ in range(share)]
    return names[number * 37 % len(names)]


def case(shop: Workshop, number: int, held: int = 0) -> dict[str, Any]:
    """Make one mutation, hand it in, and return what came of it.

    Args:
        shop: where it is made.
        number: of the mutation.
        held: what this process held for others before the first one [bytes].
    """
    kind = kind_of(number)
    rng = np.random.default_rng([SEED, number])
    found: dict[str, Any] = {"case": number, "kind": kind, "outcome": "taken"}
    reset_peak()
    began, before = time.process_time(), SPENT_S[0]
    try:
        with silence(), _alarm(COMPILING_S if kind == "flight" else PATIENCE_S):
            KINDS[kind][1](shop, rng)
    except QrsimError as error:
        found["outcome"] = "refused"
        found["words"] = str(error)[:300]
    except _TooLong:
        found["outcome"] = "hang"
    except Exception:
        found["outcome"] = "traceback"
        found["words"] = traceback.format_exc()[-1500:]
    # Of the processor, so that a busy machine is no hang.
    found["s"] = round(time.process_time() - began - (SPENT_S[0] - before), 3)
    if found["outcome"] in ("taken", "refused"):
        found["bytes"] = peak_bytes()
        # Compiling takes its time.
        if found["s"] > (PATIENCE_S if kind == "flight" else LIMIT_S):
            found["outcome"] = "hang"
        elif found["bytes"] > LIMIT_BYTES + held:
            found["outcome"] = "memory"
    return found


def prepared(folder: Path) -> Workshop:
    """Return a workshop that has made what all cases share: runs, states, imports."""
    shop = Workshop(folder)
    with silence():
        _ = shop.scenarios, shop.studies, shop.run_folder, shop.saved, shop.logs, shop.bag, shop.pipe
        for kind in KINDS:
            with contextlib.suppress(QrsimError):
                KINDS[kind][1](shop, np.random.default_rng([SEED, 2**40]))
    return shop


def work(first: int, last: int, results: Path) -> None:
    """Do the cases from ``first`` to before ``last`` and append a line for each; a line says first what is begun."""
    with tempfile.TemporaryDirectory() as folder, results.open("a", encoding="utf-8") as lines:
        # The alarm is not heard inside of compiled code; this ends the process, and the next one goes on.
        faulthandler.dump_traceback_later(PREPARING_S, exit=True)
        shop = prepared(Path(folder))
        for number in range(first, last):
            faulthandler.dump_traceback_later(2.0 * COMPILING_S, exit=True)
            print(json.dumps({"begun": number}), file=lines, flush=True)
            found = case(shop, number)
            print(json.dumps(found), file=lines, flush=True)
            if found["outcome"] in ("memory", "hang"):
                return  # what it left behind must not count for the next


def _done(results: Path) -> dict[int, dict[str, Any]]:
    """Return the cases that have been done; one that was begun and never done ended its process."""
    found: dict[int, dict[str, Any]] = {}
    if results.exists():
        for line in results.read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(ValueError):
                entry = json.loads(line)
                number = entry.get("case", entry.get("begun"))
                if "case" in entry:
                    found[number] = entry
                else:
                    found.setdefault(number, {"case": number, "kind": kind_of(number), "outcome": "crash", "s": 0.0})
    return found


def _missing(first: int, last: int, results: Path) -> list[int]:
    done = _done(results)
    return [number for number in range(first, last) if number not in done]


def _stretch(first: int, last: int, results: Path, stop: threading.Event) -> None:
    """Do a stretch of cases by one process after the other, until none is missing."""
    while not stop.is_set() and (missing := _missing(first, last, results)):
        words = [sys.executable, "-m", "evidence.fuzz", str(missing[0]), str(last), str(results)]
        subprocess.run(words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)


def _all(cases: int) -> list[dict[str, Any]]:
    """Do all cases, resuming what an earlier call at this commit has begun."""
    from evidence.__main__ import commit

    revision = commit(ROOT)
    folder = Path(tempfile.gettempdir()) / "qrsim-fuzz" / revision
    if revision.endswith(("+dirty", "unknown")):  # what was done may have been done by another program
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    edges = [cases * i // PROCESSES for i in range(PROCESSES + 1)]
    stretches = [(a, b, folder / f"{a}-{b}.jsonl") for a, b in itertools.pairwise(edges)]
    stop = threading.Event()
    with ThreadPoolExecutor(PROCESSES) as pool:
        running = [pool.submit(_stretch, *stretch, stop) for stretch in stretches]
        try:
            while not all(each.done() for each in running):
                done = cases - sum(len(_missing(*stretch)) for stretch in stretches)
                print(f"\rfuzz: {done} of {cases}", end="", file=sys.stderr, flush=True)
                time.sleep(2.0)
        finally:
            stop.set()
        for each in running:
            each.result()
    print(file=sys.stderr)
    return [entry for *_, results in stretches for entry in _done(results).values()]


def summed_up(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the counts of outcomes, by kind and in all, and the extremes."""
    kinds = {name: dict.fromkeys(OUTCOMES, 0) for name in KINDS}
    for entry in entries:
        kinds[entry["kind"]][entry["outcome"]] += 1
    total = collections.Counter(entry["outcome"] for entry in entries)
    return {
        "cases": len(entries),
        **{outcome: total[outcome] for outcome in OUTCOMES},
        "limit_s": LIMIT_S,
        "limit_bytes": LIMIT_BYTES,
        "kinds": kinds,
    }


def some(count: int, first: int = 0) -> list[dict[str, Any]]:
    """Do so many cases in this process, whatever others hold in it."""
    held = resident_bytes()
    # To look through what others hold for garbage takes seconds, which are not the cases' own.
    gc.freeze()
    try:
        with tempfile.TemporaryDirectory() as folder:
            shop = prepared(Path(folder))
            return [case(shop, number, held) for number in range(first, first + count)]
    finally:
        gc.unfreeze()


def run(full: bool) -> dict[str, Any]:
    """Return how many mutations were taken and refused, and that no other came to anything else."""
    return summed_up(_all(FULL) if full else some(SMALL))


if __name__ == "__main__":
    work(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
