"""Mutants that compute the same as what is there, each with the reason: (file, line's text, column in it, mutation)."""

from __future__ import annotations

EQUIVALENT: dict[tuple[str, str, int, str], str] = {}
