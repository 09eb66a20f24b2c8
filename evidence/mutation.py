"""Mutation study: which numbers of models and controllers may be wrong without a test that fails.

Each mutant of _mutants.py is put into a copy of the package, and files of tests run until one fails (killed) or none is
left (a survivor). What has been tried is kept in docs/evidence/mutation.jsonl, one line each, and not tried again::

    python -m evidence mutation                     everything that is left, and docs/evidence/mutation.json
    python -m evidence.mutation --shard 1/4         a quarter of it, for four processes or machines
    python -m evidence.mutation --sample 60         sixty of all, drawn by the seed
    python -m evidence.mutation --file barometer    those of files whose path has this in it
    python -m evidence.mutation --tests FILE        only with the tests of a file, what is not killed yet
    python -m evidence.mutation --survivors         recorded survivors and timeouts again, after new tests
    python -m evidence.mutation --list              counts and survivors, nothing is run
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from evidence._mutant_forks import Collected, collected, measure, short_files
from evidence._mutant_names import computing
from evidence._mutant_runs import KILLED, LIMIT_S, NOTHING, SURVIVED, TIMEOUT, Workshop, workshop
from evidence._mutant_tests import (
    LAST,
    Map,
    NotPassingError,
    batches,
    candidates,
    file_of,
    long_ones,
    read_map,
)
from evidence._mutants import ROOT, Mutant, all_mutants, left_out, sample

DOC = "numbers of models and controllers, 20 % larger and with the other sign: which does no test miss"
SEED = 20261124
SMALL = 100
RECORD = ROOT / "docs" / "evidence" / "mutation.jsonl"
# Tests that killed neighbours of a mutant are tried before all others.
RECENT = 3
# Patience with a file of tests: a mutant that takes so many times as long, and these seconds, runs away.
SLOWER, AT_LEAST_S = 10, 60
# Less in forks: whoever is given up there is tried again.
FORK_SLOWER, FORK_LEAST_S, FORK_MOST_S = 3, 20, 90

# What some tests let live, while nobody has asked all others.
ESCAPED, TRY_LIMIT_S = "escaped", 60

Key = tuple[str, str, int, int, str]
Entry = dict[str, Any]
Say = Callable[[str], None]


def recorded(path: Path = RECORD) -> dict[Key, Entry]:
    """Return what has been tried; the last verdict on a mutant counts, and half a line not at all."""
    found: dict[Key, Entry] = {}
    for line in path.read_text("utf-8").splitlines() if path.is_file() else ():
        try:
            entry = json.loads(line)
            file, text, ordinal, column, mutation = entry["key"]
        except (ValueError, KeyError, TypeError):
            continue  # of a process that was ended while it wrote
        key = (file, text, ordinal, column, mutation)
        if entry["result"] == KILLED and not (ROOT / file_of(entry["killer"])).is_file():
            # Of a file of tests that is gone: nobody has asked the others.
            entry |= {"result": ESCAPED, "killer": ""}
        # That some tests let it live takes back no kill by others.
        if entry["result"] != ESCAPED or found.get(key, entry)["result"] != KILLED:
            found.pop(key, None)
            found[key] = entry
    return found


def _append(path: Path, entry: Entry) -> None:
    with path.open("a", encoding="utf-8") as file:  # one write, so that several processes may share the file
        file.write(json.dumps(entry, ensure_ascii=False) + "\n")


def tidy(path: Path = RECORD) -> None:
    """Leave one line of each mutant that still exists, in their order."""
    known = recorded(path)
    lines = [json.dumps(known[m.key], ensure_ascii=False) + "\n" for m in all_mutants() if m.key in known]
    path.write_text("".join(lines), "utf-8")


def judge(shop: Workshop, mutant: Mutant, known: Map, recent: Sequence[str]) -> Entry:
    """Try one mutant with all tests that may kill it: short ones, what compares declarations, long ones."""
    seconds, result = 0.0, SURVIVED
    short = batches([test for test in candidates(mutant.literal, known) if test not in recent], known)
    declared = [[file] for file in LAST]
    ordered = [*short, *declared] if mutant.literal.kind == "function" else [*declared, *short]
    runs = [
        *((tests, "not long") for tests in [[*recent], *ordered]),
        *(([f], "long") for f in long_ones(mutant.literal)),
    ]
    with shop.holding(mutant):
        for tests, marks in runs:
            if not tests:
                continue
            usual = sum(known[test].seconds for test in tests if test in known)
            limit_s = int(SLOWER * usual + AT_LEAST_S) if marks != "long" else LIMIT_S
            outcome = shop.run(tests, limit_s=limit_s, marks=marks)
            seconds += outcome.seconds
            if outcome.result == KILLED:
                return {"key": mutant.key, "result": KILLED, "killer": outcome.killer, "s": round(seconds, 1)}
            if outcome.result == TIMEOUT:
                result = TIMEOUT
    return {"key": mutant.key, "result": result, "killer": "", "s": round(seconds, 1)}


def nearby(mutant: Mutant, done: dict[Key, Entry]) -> list[str]:
    """Return the tests that last killed mutants of the same file, the nearest first."""
    same = [entry for key, entry in done.items() if key[0] == mutant.key[0] and entry["result"] == KILLED]
    # What was tried last stands last; one of the same line comes first.
    same = [*reversed(same)]
    same.sort(key=lambda entry: entry["key"][1] != mutant.key[1])
    return list(dict.fromkeys(entry["killer"] for entry in same if "::" in entry["killer"]))[:RECENT]


def in_forks(process: Collected, mutants: Sequence[Mutant], say: Say, path: Path, every: bool = False) -> None:
    """Try mutants of bodies in forks of a process that has collected tests; record what becomes of them.

    Args:
        process: what has collected them.
        mutants: those of them that are not in a body are left to others.
        say: told of each.
        path: the record.
        every: whether all tests are run, in their order, in the place of those that are known to enter the function.
    """
    known = {test: item for test, item in read_map().items() if test in process.items}
    recent: dict[str, list[str]] = {}
    for number, mutant in enumerate(mutants, 1):
        if not process.is_for_this(mutant):
            continue
        function = (mutant.literal.file, mutant.literal.owner)
        tests = [*process.items]
        if not every:
            functions = {function} if mutant.literal.kind == "function" else computing(mutant.literal)
            tests = [test for test in candidates(mutant.literal, known) if functions & known[test].entered]
        tests = list(dict.fromkeys([*recent.get(str(function), []), *tests]))
        if not tests:
            continue
        usual = sum(known[test].seconds for test in tests if test in known)
        outcome = process.run(tests, int(min(FORK_SLOWER * usual, FORK_MOST_S) + FORK_LEAST_S), mutant)
        say(f"{number}/{len(mutants)} {outcome.result} in {outcome.seconds} s: {mutant} {outcome.killer}")
        result = KILLED if outcome.result == KILLED and outcome.killer else ESCAPED
        _append(path, {"key": mutant.key, "result": result, "killer": outcome.killer, "s": round(outcome.seconds, 1)})
        if result == KILLED:
            recent[str(function)] = list(dict.fromkeys([outcome.killer, *recent.get(str(function), [])]))[:RECENT]


def try_tests(mutants: Sequence[Mutant], tests: Sequence[str], say: Say, path: Path = RECORD) -> None:
    """Try mutants with nothing but some files of tests, as after writing them; record those that are killed alone.

    Raises:
        NotPassingError: the tests fail without any mutant.
    """
    done = recorded(path)
    left = [mutant for mutant in mutants if done.get(mutant.key, {}).get("result") != KILLED]
    with workshop() as shop:
        if shop.run(tests).result != SURVIVED:
            raise NotPassingError(f"{' '.join(tests)}: not all tests pass without a mutant")
        collected(shop, tests, lambda process: in_forks(process, left, say, path, every=True))
        now = recorded(path)
        for mutant in [mutant for mutant in left if now.get(mutant.key) == done.get(mutant.key)]:
            with shop.holding(mutant):
                outcome = shop.run(tests, limit_s=TRY_LIMIT_S)
            say(f"{outcome.result} in {outcome.seconds} s: {mutant} {outcome.killer}")
            if outcome.result == KILLED:
                _append(path, {"key": mutant.key, "result": KILLED, "killer": outcome.killer, "s": outcome.seconds})


def study(mutants: Sequence[Mutant], say: Say, path: Path = RECORD, again: bool = False, part: float = 0.0) -> None:
    """Try mutants and record what becomes of them; those that are recorded only where they are to be tried again.

    Args:
        mutants: what is tried.
        say: told of each.
        path: the record.
        again: whether to try those that are recorded, too.
        part: from 0 to 1, where among the tests this process begins to measure what several share.

    Raises:
        NotPassingError: tests cannot be collected.
    """
    done = recorded(path)
    left = [m for m in mutants if again or done.get(m.key, {}).get("result", ESCAPED) == ESCAPED]
    if not left:
        return
    with workshop() as shop:
        measure(shop, say, part)
        collected(shop, short_files(), lambda process: in_forks(process, left, say, path))
        known, done = read_map(), recorded(path)
        left = [mutant for mutant in left if done.get(mutant.key, {}).get("result") != KILLED]
        for number, mutant in enumerate(left, 1):
            entry = judge(shop, mutant, known, nearby(mutant, done))
            _append(path, entry)
            done.pop(mutant.key, None)
            done[mutant.key] = entry
            say(f"{number}/{len(left)} {entry['result']} in {entry['s']} s: {mutant} {entry['killer']}")


def again(mutants: Sequence[Mutant], path: Path = RECORD) -> Entry:
    """Run mutants against nothing but the test that is recorded as the killer of each.

    Returns:
        Counts, and under ``missed`` the mutants that their killer lets live; under ``untried`` those without one.
    """
    done = recorded(path)
    told: Entry = {"tried": 0, "killed": 0, "missed": [], "untried": []}
    with workshop() as shop:
        for mutant in mutants:
            killer = done.get(mutant.key, {}).get("killer")
            if not killer:
                told["untried"].append(str(mutant))
                continue
            with shop.holding(mutant):
                outcome = shop.run([killer])
            if outcome.result == NOTHING:  # no such test any more
                told["untried"].append(str(mutant))
                continue
            told["tried"] += 1
            told["killed"] += outcome.result == KILLED
            if outcome.result != KILLED:
                told["missed"].append(f"{mutant}: {outcome.result} of {killer}")
    return told


def counted(path: Path = RECORD) -> dict[str, Any]:
    """Return the counts of the study, of the mutants that there are now."""
    mutants, done = all_mutants(), recorded(path)
    results = Counter(done[mutant.key]["result"] for mutant in mutants if mutant.key in done)
    tried = results.total() - results[ESCAPED]
    seconds = sum(done[mutant.key].get("s", 0.0) for mutant in mutants if mutant.key in done)
    return {
        "mutants": len(mutants),
        "tried": tried,
        "killed": results[KILLED],
        "survivors": results[SURVIVED],
        "timeouts": results[TIMEOUT],
        "escaped": results[ESCAPED],
        "killed_percent": round(100.0 * results[KILLED] / max(tried, 1), 1),
        "hours_of_runs": round(seconds / 3600.0, 1),
        "left_out": left_out(),
    }


def survivors(path: Path = RECORD) -> list[Mutant]:
    """Return the mutants that no test kills, that run away, or that some tests let live."""
    done = recorded(path)
    return [m for m in all_mutants() if done.get(m.key, {}).get("result") in (SURVIVED, TIMEOUT, NOTHING, ESCAPED)]


def run(full: bool) -> dict[str, Any]:
    """Try what is left in a process for each core, or the sample with its recorded killers; return counts.

    In processes of their own, because a warm one must not know the package.
    """
    if full:
        number = os.cpu_count() or 1
        shards = [_command("--shard", f"{k}/{number}") for k in range(1, number + 1)]
        processes = [subprocess.Popen(command, cwd=ROOT) for command in shards]
        codes = [process.wait() for process in processes]
        if any(codes):
            raise RuntimeError("a part of the study failed; what was tried is kept, so run it again")
        tidy()
        return counted()
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "told.json"
        subprocess.run(_command("--sample", str(SMALL), "--recorded", str(told)), cwd=ROOT, check=True)
        return json.loads(told.read_text("utf-8"))


def _command(*words: str) -> list[str]:
    return [sys.executable, "-m", "evidence.mutation", *words]


def _shard(text: str) -> tuple[int, int]:
    """Read K/N."""
    k, _, n = text.partition("/")
    if not (k.isdecimal() and n.isdecimal() and 1 <= int(k) <= int(n)):
        raise argparse.ArgumentTypeError(f"'{text}' is no part: wanted K/N with K from 1 to N, such as 1/4")
    return int(k), int(n)


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m evidence.mutation", description=DOC)
    parser.add_argument("--shard", type=_shard, metavar="K/N", default=(1, 1), help="one of N equal parts")
    parser.add_argument("--sample", type=int, metavar="N", help="N of all mutants, drawn by the seed")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the sample (default {SEED})")
    parser.add_argument("--file", metavar="TEXT", default="", help="only files whose path has this in it")
    parser.add_argument(
        "--tests", nargs="+", metavar="FILE", help="only with these files of tests; record what they kill"
    )
    parser.add_argument("--survivors", action="store_true", help="try recorded survivors and timeouts again")
    parser.add_argument("--list", action="store_true", help="print counts and survivors, run nothing")
    parser.add_argument("--recorded", type=Path, metavar="FILE", help="only with recorded killers; write what came out")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a part of the study; return the exit code."""
    asked = _parsed(arguments)
    mutants = survivors() if asked.survivors else all_mutants()
    if asked.sample is not None:
        mutants = sample(mutants, asked.sample, asked.seed)
    mutants = [mutant for mutant in mutants if asked.file in mutant.literal.file]
    k, n = asked.shard
    mutants = mutants[(k - 1) * len(mutants) // n : k * len(mutants) // n]
    if asked.recorded:
        asked.recorded.write_text(json.dumps(again(mutants)), "utf-8")
        return 0
    try:
        if asked.tests:
            try_tests(mutants, asked.tests, lambda text: print(text, flush=True))
        elif not asked.list:
            study(mutants, lambda text: print(text, flush=True), again=asked.survivors, part=(k - 1) / n)
    except NotPassingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(json.dumps(counted()))
    for mutant in survivors():
        print(f"survivor: {mutant}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
