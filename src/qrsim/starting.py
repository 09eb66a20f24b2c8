"""Imported first by the command line: Ctrl-C during the slow imports ends the program at once; exit is quick too."""

from __future__ import annotations

import atexit
import gc
import os
import sys

from qrsim.files.interruptions import leave_at_once

# By any other name somebody imports the command line into a program of their own.
if os.path.basename(sys.argv[0] if sys.argv else "") in ("qrsim", "qrsim.exe"):
    leave_at_once()
    # Before NumPy. Its matrices are small: more threads take a hundred times the CPU, and change the last bits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # The system takes the memory back as a whole; to search it for garbage first takes a third of a second of CPU time.
    atexit.register(gc.freeze)
