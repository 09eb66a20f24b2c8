"""Since when a user waits."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from qrsim.runs.waiting import waiting_since


def test_in_somebody_elses_program_it_is_now():
    before = time.perf_counter()
    assert before <= waiting_since() <= time.perf_counter()


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="only Linux says when a process was started")
def test_from_a_shell_it_is_the_start_of_the_process():
    """Half a second is slept before the question is asked."""
    program = (
        "import sys, time; sys.argv = ['/usr/bin/qrsim', 'run']; time.sleep(0.5)\n"
        "from qrsim.runs.waiting import waiting_since; print(time.perf_counter() - waiting_since())"
    )
    began = time.perf_counter()
    waited = float(subprocess.run([sys.executable, "-c", program], stdout=-1, text=True, check=True).stdout)
    assert 0.5 <= waited <= time.perf_counter() - began + 0.02
