"""Imported first by the command line: Ctrl-C during the slow imports ends the program at once."""

from __future__ import annotations

import os
import sys

from qrsim.interruptions import leave_at_once

# By any other name somebody imports the command line into a program of their own.
if os.path.basename(sys.argv[0] if sys.argv else "") in ("qrsim", "qrsim.exe"):
    leave_at_once()
