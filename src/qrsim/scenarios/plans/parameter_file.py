"""Reads files of parameters: .params of QGroundControl, and .param and .parm of Mission Planner and MAVProxy."""

from __future__ import annotations

import math
from pathlib import Path

from qrsim.errors import ScenarioError, UsageError, readable, shortened
from qrsim.files.user_files import read_text

SUFFIX, MOST_LINES = ".params", 5000
# Of QGroundControl: system, component, name, value, type.
_COLUMNS = 5


def beside(plan: str) -> str | None:
    """Return the path of the parameter file with the same name as a plan file; None if it does not exist."""
    path = Path(plan).expanduser().with_suffix(SUFFIX)
    return str(Path(plan).with_suffix(SUFFIX)) if path.is_file() else None


def read_parameters(source: str) -> dict[str, float]:
    """Read a parameter file; return name -> value, of repeated names the last.

    Raises:
        UsageError: the file cannot be read or has too many lines.
        ScenarioError: a line has no name and value; every fault with its line.
    """
    with readable(source):
        lines = read_text(source).splitlines()
    if len(lines) > MOST_LINES:
        raise UsageError(f"{source}: has {len(lines)} lines; allowed: {MOST_LINES}")
    found, problems = {}, []
    for number, line in enumerate(lines, 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        name, value = words[2:4] if len(words) == _COLUMNS else words if len(words) == 2 else ("", "")
        try:
            found[name] = float(value)
        except ValueError:
            name = ""
        if not name or not math.isfinite(found[name]):
            problems.append(f"line {number}: {shortened(line, 60)!r} has no name and number of a parameter")
    if problems:
        raise ScenarioError(source, problems)
    return found
