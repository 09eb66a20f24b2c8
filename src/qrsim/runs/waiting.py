"""Since when the user of a command waits."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path


def waiting_since() -> float:
    """Return the time at which this process was started from a shell, on the clock of ``time.perf_counter`` [s].

    In a program of somebody else's, and where the system does not say, it is now.
    """
    now = time.perf_counter()
    if os.path.basename(sys.argv[0] if sys.argv else "") not in ("qrsim", "qrsim.exe"):
        return now
    try:
        # Behind the name, which may have spaces: the 22nd field, in ticks since the system was started.
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        age = float(Path("/proc/uptime").read_text().split()[0]) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return now
    return now - max(age, 0.0)
