"""Refuse modules of the core whose share of typed expressions is too small.

The long tier runs this, and not 'make lint', because for a report mypy reads everything again. It reads the report of
``mypy --any-exprs-report FOLDER``, FOLDER/any-exprs.txt: a line for each module with its expressions of type Any, all
its expressions, and the share of the others.
"""

from __future__ import annotations

# Share of expressions [%] whose type must be known, in these packages and modules.
LEAST = 95.0
HELD = ("qrsim.world", "qrsim.interface", "qrsim.engine.backend")


def shares_of(report: str) -> dict[str, float]:
    """Return the share of typed expressions [%] of each module of a report that has expressions."""
    shares = {}
    for line in report.splitlines():
        words = line.split()
        if len(words) == 4 and words[1].isdigit() and words[2] != "0":
            shares[words[0]] = 100.0 * (1.0 - int(words[1]) / int(words[2]))
    return shares


def complaints(report: str) -> list[str]:
    """Return what is wrong with a report, a line for each module; none if nothing is."""
    found, shares = [], shares_of(report)
    for held in HELD:
        modules = {name: share for name, share in shares.items() if name == held or name.startswith(f"{held}.")}
        if not modules:
            found.append(f"{held}: not in mypy's report")
        for name, share in modules.items():
            if share < LEAST:
                found.append(f"{name}: {share:.2f} % of the expressions are typed, at least {LEAST:g} % must be")
    return found
