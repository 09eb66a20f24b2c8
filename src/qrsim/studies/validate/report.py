"""Outcome of a part of the validation: checks that can fail, findings that cannot, pictures and numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from qrsim.files import Content

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Verdict = Literal["fits", "fits in part", "does not fit", "to note"]
# Shares of a record's variance that a simulation explains, from which on it fits, and fits in part.
FITS, FITS_IN_PART = 0.9, 0.5


@dataclass(frozen=True)
class Check:
    """A number that must lie within a tolerance of its expectation; it decides the exit code.

    Attributes:
        name: what was measured.
        value, expected, tolerance: in ``unit``.
        reason: where the expectation comes from, and why the tolerance is what it is.
    """

    name: str
    value: float
    expected: float
    tolerance: float
    unit: str
    reason: str

    @property
    def passed(self) -> bool:
        """Whether the value is within the tolerance; NaN does not pass."""
        return abs(self.value - self.expected) <= self.tolerance

    def to_json(self) -> dict[str, object]:
        """Return the check as a dict for JSON, with its result; non-finite values become None."""
        value = self.value if math.isfinite(self.value) else None
        return {
            "name": self.name,
            "value": value,
            "expected": self.expected,
            "tolerance": self.tolerance,
            "unit": self.unit,
            "passed": self.passed,
            "reason": self.reason,
        }


@dataclass(frozen=True)
class Finding:
    """A measure of how well a model describes a recording. It is reported and cannot fail.

    Attributes:
        name: what was compared.
        number: the number with its unit, as text.
        verdict: in a word or three.
        reading: one sentence.
    """

    name: str
    number: str
    verdict: Verdict
    reading: str

    def to_json(self) -> dict[str, str]:
        """Return the finding as a dict for JSON."""
        return {"name": self.name, "number": self.number, "verdict": self.verdict, "reading": self.reading}


@dataclass(frozen=True)
class Picture:
    """A PNG with its caption, and the figure that it shows, for vectors."""

    png: bytes
    caption: str
    figure: Figure | None = None


@dataclass(frozen=True)
class Outcome:
    """Outcome of a part.

    Attributes:
        method: how the numbers came about, a paragraph.
        reading: what they say, one sentence.
        checks, findings, pictures: in the order they are shown.
        numbers: every number behind them, for the JSON: nested dicts and lists.
        skipped: what was left out, and how to get it.
    """

    method: str
    reading: str
    checks: list[Check]
    findings: list[Finding]
    pictures: list[Picture]
    numbers: Content
    skipped: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether every check of this part of the report passed."""
        return all(check.passed for check in self.checks)


@dataclass(frozen=True)
class Part:
    """One part of the validation.

    Attributes:
        name: for --only.
        title: for the report.
        answers: which published figure it answers.
        recordings: names of the recordings it needs.
        run: takes the paths of the recordings by name; ``full`` False is a quick form for tests.
    """

    name: str
    title: str
    answers: str
    recordings: tuple[str, ...]
    run: Callable[[Mapping[str, Path], bool], Outcome]


def share_verdict(explained: float) -> Verdict:
    """Return the verdict on a simulation that explains the share ``explained`` of a recording's variance."""
    if explained >= FITS:
        return "fits"
    return "fits in part" if explained >= FITS_IN_PART else "does not fit"


def reference_check(name: str, value: float, reference: str, unit: str) -> Check:
    """Return the check that a value agrees with a published one, to 3 digits or as many as that has."""
    shown = reference.partition("e")[0].replace(".", "").lstrip("0")
    digits = min(3, len(shown))
    expected = float(reference)
    half = 0.5 * 10.0 ** (math.floor(math.log10(abs(expected))) - digits + 1)
    return Check(name, value, expected, half, unit, f"reference value {reference}; half a unit of its digit {digits}")


def worst(checks: Iterable[Check]) -> Check:
    """Return the check with the largest error as a fraction of its tolerance."""
    return max(checks, key=lambda check: abs(check.value - check.expected) / check.tolerance)
