"""tools/try_px4.sh, which users with a PX4 run: here qrsim's own flight stack flies in its place."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[3] / "tools"


def test_the_script_says_how_it_is_used() -> None:
    for words in ([], ["/nowhere/at/all"]):
        done = subprocess.run(["sh", str(TOOLS / "try_px4.sh"), *words], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (2, "usage: tools/try_px4.sh PX4_CHECKOUT [FOLDER]\n")


@pytest.mark.nightly
def test_the_trial_flies_a_square_and_lands(tmp_path: Path) -> None:
    folder = tmp_path / "trial"
    words = [sys.executable, str(TOOLS / "try_px4.py"), "-", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.stdout.splitlines()[-1].startswith("0 of 11 differ;"), done.stdout + done.stderr
    report = (folder / "report.txt").read_text()
    assert "ok   corner 4 of the square | expected within 1.5 m in 30 s" in report
    assert done.returncode == 0
