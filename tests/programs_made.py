"""How many programs of worlds the tests compile: counted by file, printed at the end, and bounded.

A program costs a second or more, so it is what the time of a tier is spent on. What is found in this process or in the
cache of programs is not counted. The bounds hold for whole tiers: a run of some files or of some tests is not judged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from typing import Any

import pytest

# Programs that a tier may compile: those of a cold run and 8 % more, because two workers that need a program at once
# both compile it. Who needs more looks for a world to share first (tests/small_worlds.py).
BUDGET = {"not long and not nightly": 330, "long and not nightly": 1000}
KEY = "programs_made"
SHOWN = 10


class ProgramsMade:
    """Counts the programs of this process, or those of all workers."""

    def __init__(self) -> None:
        self.by_file: Counter[str] = Counter()
        self.now = "elsewhere"
        self._known: set[int] = set()

    def watch(self, module: Any, name: str, key: Callable[..., Hashable] | None = None) -> None:
        """Count the calls of a function of a module.

        Args:
            module, name: which.
            key: of its arguments; a call whose key is that of an earlier one makes no program.
        """
        function = getattr(module, name)

        def counted(*arguments: Any, **named: Any) -> Any:
            # Their hashes alone, which keep nothing in memory.
            known = None if key is None else hash(key(*arguments, **named))
            if known is None or known not in self._known:
                self.by_file[self.now] += 1
            if known is not None:
                self._known.add(known)
            return function(*arguments, **named)

        setattr(module, name, counted)

    @staticmethod
    def key_of_xla(function: Hashable, shared: Any, own: Hashable, *further: Hashable) -> Hashable:
        """Return the key of a program in JAX; ``further``: layout of its state, extent, and why LLVM refused it."""
        return function, shared.layout, own, *further[:2]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Note which file is being run."""
        self.now = nodeid.split("::")[0]

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Hand the counts of a worker on, or judge those of all."""
        output = getattr(session.config, "workeroutput", None)
        if output is not None:
            output[KEY] = dict(self.by_file)
        elif self._over(session.config) and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Add the counts of a worker that ends."""
        self.by_file.update(getattr(node, "workeroutput", {}).get(KEY, {}))

    def pytest_terminal_summary(self, terminalreporter: Any, config: pytest.Config) -> None:
        """Print the files that compiled most, and whether that is too much."""
        if not self.by_file:
            return
        terminalreporter.section(f"{self.by_file.total()} programs compiled")
        for file, count in self.by_file.most_common(SHOWN):
            terminalreporter.write_line(f"{count:5d}  {file}")
        if self._over(config):
            terminalreporter.write_line(
                f"More than the budget of {BUDGET[config.option.markexpr]}: share worlds (tests/small_worlds.py), or "
                "raise BUDGET in tests/programs_made.py and say why in the commit."
            )

    def _over(self, config: pytest.Config) -> bool:
        whole = not config.option.keyword and config.args == config.getini("testpaths")
        return whole and self.by_file.total() > BUDGET.get(config.option.markexpr, self.by_file.total())
