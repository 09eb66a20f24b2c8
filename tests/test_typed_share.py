"""The core stays typed, and the check of that fails where it must."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tests.typed_share import complaints

ROOT = Path(__file__).parents[1]

HEAD = "   Name    Anys    Exprs   Coverage\n" + "-" * 40 + "\n"
FINE = HEAD + (
    " qrsim.world        0      1  100.00%\n qrsim.world.tick  50   1000   95.00%\n"
    " qrsim.interface.actions  0  0  100.00%\n qrsim.interface.readings  1  100  99.00%\n"
    " qrsim.engine.backend  18  502  96.41%\n qrsim.cli  900  1000  10.00%\n"
)


def test_a_report_at_the_limit_passes() -> None:
    """95 % are enough, and modules outside the core may be what they are."""
    assert complaints(FINE) == []


def test_a_module_below_the_limit_is_named_with_its_share() -> None:
    """One more expression of unknown type in a thousand is one too many."""
    lower = FINE.replace("50   1000   95.00%", "51   1000   94.90%")
    assert complaints(lower) == ["qrsim.world.tick: 94.90 % of the expressions are typed, at least 95 % must be"]
    lower = FINE.replace("18  502  96.41%", "26  502  94.82%")
    assert complaints(lower) == ["qrsim.engine.backend: 94.82 % of the expressions are typed, at least 95 % must be"]


def test_a_module_that_the_report_lacks_is_missed() -> None:
    """An empty or another report does not pass."""
    assert complaints(HEAD) == [
        "qrsim.world: not in mypy's report",
        "qrsim.interface: not in mypy's report",
        "qrsim.engine.backend: not in mypy's report",
    ]


@pytest.mark.nightly
def test_the_core_is_typed(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--any-exprs-report",
        str(tmp_path),
        "--cache-dir",
        str(tmp_path / "cache"),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert complaints((tmp_path / "any-exprs.txt").read_text()) == []
