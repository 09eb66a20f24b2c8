"""Memory that a problem of SLAM needs, compared with what is free."""

from __future__ import annotations

import os

from qrsim.errors import RunError
from qrsim.studies.slam.flight import SIZE
from qrsim.studies.slam.graph import POSE

FIXED_BYTES = 200 * 2**20
SMALLER = "take a longer state_period, states poses, or fewer landmarks"


def state_size(states: str, bias: bool) -> int:
    """Return the number of unknowns of one state: "full" or "poses", with ``bias`` two more for GNSS errors."""
    return (SIZE if states == "full" else len(POSE)) + 2 * bias


def bytes_needed(states: int, size: int, landmarks: int) -> int:
    """Return the peak memory [bytes] that solving a problem of this size needs; ``size``: unknowns per state.

    Each state has its blocks of Jacobians and of the matrix, its rows of what the landmarks are eliminated with, and
    its ranges. The factors are above those of measured problems (docs/explanation/slam.md); compiled
    programs take FIXED_BYTES.
    """
    blocks, rows, ranges = 16 * size * size, 5 * size * (1 + 3 * landmarks), 40 * landmarks
    return FIXED_BYTES + 8 * states * (blocks + rows + ranges)


def available_bytes() -> int:
    """Return the free memory [bytes], or the total if the system does not report it."""
    try:
        with open("/proc/meminfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except OSError:
        pass
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_memory(
    states: int, size: int, landmarks: int, available: int, flights: int = 0, smaller: str = SMALLER
) -> None:
    """Raise RunError if a problem of this size does not fit into memory next to its flights [bytes]."""
    needed = bytes_needed(states, size, landmarks) + flights
    if needed > available:
        raise RunError(
            f"slam: {states} states of {size} numbers and {landmarks} landmarks need {needed / 2**30:.1f} GiB, and "
            f"{available / 2**30:.1f} GiB are free; {smaller}"
        )
