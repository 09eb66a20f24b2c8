"""Try mutants of functions in forks of a process that has collected all tests, at the cost of those that enter them.

A mutant in the body of a function needs no new import: a fork gives the function the code of the changed source, and
runs the tests that enter it, the nearest and quickest first. Nor does a constant of a module that nothing computes with
while it is imported. Which tests enter what is measured once, each in a fork of its own, so that nothing that an
earlier one keeps hides it. Defaults, and what importing calls, are not for this.
"""

from __future__ import annotations

import ast
import cProfile
import gc
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import pytest

from evidence._mutant_names import computing, constants
from evidence._mutant_runs import KILLED, LIMIT_BYTES, SURVIVED, TIMEOUT, Outcome, Workshop, waited
from evidence._mutant_tests import LAST, NotPassingError, add_to_map, read_map, test_files
from evidence._mutants import ROOT, SOURCE, Mutant, mutated

# Seconds of the processor that a test is measured for; of the clock, this many times as long, for a busy machine.
MEASURE_S, PATIENCE = 60, 2.0
# After so many tests it is looked what other processes have measured.
_LOOK = 50

# File below src/ and qualified name without <locals>.
Function = tuple[str, str]


def codes(text: str, path: str) -> dict[tuple[str, int], CodeType]:
    """Return the code of every function of a module's text by qualified name and first line."""
    found: dict[tuple[str, int], CodeType] = {}
    left = [compile(text, path, "exec", dont_inherit=True)]
    while left:
        code = left.pop()
        found[code.co_qualname, code.co_firstlineno] = code
        left += [item for item in code.co_consts if isinstance(item, CodeType)]
    return found


class Collected:
    """The plugin of pytest in whose loop of tests everything happens.

    Attributes:
        by_import: functions that were entered before any test.
    """

    def __init__(self, source: Path, folder: Path, work: Callable[[Collected], None]) -> None:
        self.source, self.folder, self.work = source, folder, work
        self.by_import: set[Function] = set()
        self.items: dict[str, Any] = {}
        self.functions: dict[str, list[FunctionType]] = {}
        self.killer = ""

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Keep the first failure of a fork."""
        if report.failed and not self.killer:
            self.killer = report.nodeid

    def pytest_runtestloop(self, session: Any) -> bool:
        """Do the work in the place of running what was collected."""
        self.by_import = _stop_watching(self.source)
        self.items = {item.nodeid: item for item in session.items}
        prefix = str(self.source) + os.sep
        for thing in gc.get_objects():
            if isinstance(thing, FunctionType) and thing.__code__.co_filename.startswith(prefix):
                self.functions.setdefault(thing.__code__.co_filename.removeprefix(prefix), []).append(thing)
        gc.collect()
        gc.freeze()
        backends = sys.modules["jax"]._src.xla_bridge._backends
        assert not backends, "a file of tests computes by JAX while it is collected, and no fork of that can compute"
        self.work(self)
        return True

    def patch(self, mutant: Mutant) -> bool:
        """Give this process the mutant's code, or its constants; False where nothing changes."""
        literal = mutant.literal
        if literal.kind == "module":
            return self._set_constants(mutant)
        text = (SOURCE / literal.file).read_text("utf-8")
        path = str(self.source / literal.file)
        before, after = codes(text, path), codes(mutated(text, mutant), path)
        changed = {key for key, code in after.items() if code != before[key]}
        done = False
        for function in self.functions.get(literal.file, []):
            key = (function.__code__.co_qualname, function.__code__.co_firstlineno)
            if key in changed:
                function.__code__ = after[key]
                done = True
        return done

    def _set_constants(self, mutant: Mutant) -> bool:
        """Compute the constants anew that the mutant's statement leads to, and put them wherever they were imported."""
        file = mutant.literal.file
        module = sys.modules[file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")]
        tree = ast.parse(mutated((SOURCE / file).read_text("utf-8"), mutant))
        lines = {item.first for item in constants(mutant.literal) or ()}
        tree.body = [node for node in tree.body if node.lineno in lines]
        fresh = dict(vars(module))
        exec(compile(tree, str(self.source / file), "exec", dont_inherit=True), fresh)
        names = {name for item in constants(mutant.literal) or () for name in item.names if name in vars(module)}
        for other in [item for item in sys.modules.values() if isinstance(item, ModuleType)]:
            for name in names & vars(other).keys():
                if other is not module and vars(other)[name] is vars(module)[name]:
                    setattr(other, name, fresh[name])
        for name in names:
            setattr(module, name, fresh[name])
        return True

    def is_for_this(self, mutant: Mutant) -> bool:
        """Return whether a fork can have the mutant, because importing does not compute with it."""
        literal = mutant.literal
        if literal.kind == "module":
            return constants(literal) is not None and not computing(literal) & self.by_import
        if literal.kind != "function" or (literal.file, literal.owner) in self.by_import:
            return False
        text, path = (SOURCE / literal.file).read_text("utf-8"), str(self.source / literal.file)
        before, after = codes(text, path), codes(mutated(text, mutant), path)
        changed = {key[0].replace(".<locals>", "") for key, code in after.items() if code != before[key]}
        return any(name == literal.owner or name.startswith(f"{literal.owner}.") for name in changed)

    def run(self, tests: Sequence[str], limit_s: int, mutant: Mutant | None = None, watched: bool = False) -> Outcome:
        """Run tests that were collected, one after the other in a fork, until one fails.

        Args:
            tests: their names.
            limit_s: seconds of the processor.
            mutant: what the fork is to compute with; None: the package as it is.
            watched: whether to find which functions are entered.
        """
        told = self.folder / "told.json"
        told.unlink(missing_ok=True)
        began = time.monotonic()
        child = os.fork()
        if child == 0:
            self._in_fork(tests, told, limit_s, mutant, watched)
        status, ended = waited(child, limit_s * PATIENCE)
        seconds = round(time.monotonic() - began, 2)
        if not ended or (os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)):
            return Outcome(TIMEOUT, "", seconds)
        if os.WIFSIGNALED(status) or not told.is_file():
            return Outcome(KILLED, "", seconds)  # the process fell over, in which of them is not known
        report = json.loads(told.read_text("utf-8"))
        entered = tuple((file, name) for file, name in report["entered"])
        return Outcome(KILLED if report["killer"] else SURVIVED, report["killer"], seconds, entered)

    def _in_fork(self, tests: Sequence[str], told: Path, limit_s: int, mutant: Mutant | None, watched: bool) -> None:
        """Run the tests and end the process."""
        try:
            os.setsid()
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 30))
            resource.setrlimit(resource.RLIMIT_DATA, (LIMIT_BYTES, LIMIT_BYTES))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            self.killer = ""
            assert mutant is None or self.patch(mutant), mutant
            if watched:
                _watch()
            chosen = [self.items[name] for name in tests]
            for item, following in zip(chosen, [*chosen[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if self.killer:
                    break
            entered = sorted(_stop_watching(self.source))
            told.write_text(json.dumps({"killer": self.killer, "entered": entered}), "utf-8")
        finally:
            os._exit(0)


# Written in C, so that watching costs little.
_PROFILE = cProfile.Profile(subcalls=False, builtins=False)


def _watch() -> None:
    """Note every function that is entered from now on."""
    _PROFILE.enable()


def _stop_watching(source: Path) -> set[Function]:
    """Return the functions of a copy of the package that were entered."""
    _PROFILE.disable()
    prefix = str(source) + os.sep
    entered = [item.code for item in _PROFILE.getstats() if isinstance(item.code, CodeType)]
    _PROFILE.clear()
    return {
        (code.co_filename.removeprefix(prefix), code.co_qualname.replace(".<locals>", ""))
        for code in entered
        if code.co_filename.startswith(prefix)
    }


def short_files() -> list[str]:
    """Return the files of tests that forks run: those that compute."""
    return [file for file in test_files() if file not in LAST]


def measure(shop: Workshop, say: Callable[[str], None], part: float = 0.0) -> None:
    """Find what each test enters that has not been measured since its file changed.

    Args:
        shop: where tests are run.
        say: told how far it is.
        part: from 0 to 1, where among the tests this process begins; several take what the others have left.

    Raises:
        NotPassingError: tests cannot be collected.
    """

    def work(process: Collected) -> None:
        known = read_map()
        left = [test for test in process.items if test not in known]
        begin = int(part * len(left))
        for number, test in enumerate(left[begin:] + left[:begin], 1):
            if number % _LOOK == 0:
                known = read_map()
                say(f"{number}/{len(left)} tests measured")
            if test in known:
                continue
            outcome = process.run([test], MEASURE_S, watched=True)
            if outcome.result == SURVIVED:
                add_to_map(test, outcome.seconds, outcome.entered)
            else:
                say(f"left out, {outcome.result} without a mutant: {test}")

    collected(shop, short_files(), work)


def collected(shop: Workshop, tests: Sequence[str], work: Callable[[Collected], None]) -> None:
    """Collect the short tests of files in a fork of the warm process, and do something with them there.

    Raises:
        NotPassingError: they cannot be collected, or importing them starts JAX, which no fork outlives.
    """
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.chdir(ROOT)
            sys.path.insert(0, str(shop.source))
            sys.dont_write_bytecode = True
            _watch()
            options = ["-q", "-s", "-p", "no:cacheprovider", "--no-header", f"--basetemp={shop.folder / 'basetemp'}"]
            plugin = Collected(shop.source, shop.folder, work)
            code = int(pytest.main([*options, "-m", "not long", *tests], plugins=[plugin]))
        finally:
            os._exit(code)
    if os.waitpid(child, 0)[1]:
        raise NotPassingError("the tests could not be collected")
