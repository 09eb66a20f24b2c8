"""Mutants that compute the same as what is there, each with the reason: (file, line's text, column in it, mutation)."""

from __future__ import annotations

# One entry is one line, so that two lists of them join.
# ruff: noqa: E501
# fmt: off
EQUIVALENT: dict[tuple[str, str, int, str], str] = {
    ("qrsim/models/atmosphere/dryden.py", "_COS_15, _SIN_15 = math.cos(math.pi / 12.0), math.sin(math.pi / 12.0)", 38, "sign"): "the cosine is even",
}
