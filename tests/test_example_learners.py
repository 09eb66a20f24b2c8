"""The recipes of examples/learners, in a short form."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

LEARNERS = Path(__file__).parents[1] / "examples" / "learners"


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("recipe", "package", "words", "said"),
    [
        ("with_sb3.py", "stable_baselines3", ["--steps", "2048", "--episodes", "1"], '{"flown_to_the_end": '),
        ("with_torch.py", "torch", ["2048"], "mean reward of a decision: -"),
    ],
)
def test_a_recipe_learns_for_a_moment(recipe: str, package: str, words: list[str], said: str) -> None:
    pytest.importorskip(package, reason=f"needs {package}")
    run = subprocess.run(
        [sys.executable, str(LEARNERS / recipe), *words], capture_output=True, text=True, check=False, timeout=300
    )
    assert run.returncode == 0, run.stderr
    assert said in run.stdout
