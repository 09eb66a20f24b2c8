"""What the command line does before it imports anything large."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os, sys
sys.argv[0] = "qrsim"
import qrsim.starting
print(os.environ["OPENBLAS_NUM_THREADS"], "numpy" in sys.modules)
"""


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_one_thread_of_blas_is_chosen_before_numpy_is_imported(given: dict[str, str], threads: str) -> None:
    """Two take a hundred times the CPU of one for the matrices of SLAM; a user's own choice stays."""
    others = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=others | given, capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == [threads, "False"]
