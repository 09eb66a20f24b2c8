"""The report as one HTML page, by Jinja: style and pictures are embedded, nothing is fetched."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.resources import files

from qrsim.extras import load
from qrsim.studies.validate.parts import Result
from qrsim.studies.validate.report import FITS, FITS_IN_PART, Finding, Verdict, worst

TEMPLATE = "page.html.jinja"
_CLASSES: dict[Verdict, str] = {"fits": "fits", "fits in part": "part", "does not fit": "not", "to note": "note"}
SOURCE = (
    "A. Symington, R. De Nardi, S. Julier, S. Hailes, “Simulating Quadrotor UAVs in Outdoor Scenarios”, IROS 2014,"
    " pp. 3382-3388"
)


def write_page(results: Sequence[Result], about: Mapping[str, object]) -> str:
    """Return the validation report as an HTML page; ``about`` states version and machine.

    Args:
        results: in the order they are shown.
        about: what stands beside the parts in the JSON.

    Raises:
        MissingExtraError: Jinja is not installed.
    """
    jinja = load("validate", "qrsim validate", "jinja2")
    # Every text of a report is escaped; an unknown name in the template is an error.
    made = jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.filters |= {
        "number": number,
        "base64": _base64,
        "counted": _count_verdicts,
        "style": _CLASSES.get,
        "worst": worst,
    }
    checks = [check for result in results if result.outcome for check in result.outcome.checks]
    page: str = made.from_string(files("qrsim.studies.validate").joinpath(TEMPLATE).read_text("utf-8")).render(
        results=[(result.part, result.outcome, result.skipped) for result in results],
        about=about,
        source=SOURCE,
        count=len(checks),
        failed=sum(not check.passed for check in checks),
        fits=FITS,
        fits_in_part=FITS_IN_PART,
    )
    return page + "\n"


def number(value: float) -> str:
    """Format a number with four significant digits."""
    return f"{value:.4g}".replace("e-0", "e-").replace("-", "\N{MINUS SIGN}")


def _base64(data: bytes) -> str:
    """Encode bytes as base64 text."""
    return base64.b64encode(data).decode("ascii")


def _count_verdicts(findings: Sequence[Finding]) -> list[tuple[Verdict, int]]:
    """Return (verdict, number of findings with it), without findings that are only notes."""
    counts = Counter(found.verdict for found in findings)
    return [(verdict, counts[verdict]) for verdict in _CLASSES if counts[verdict] and verdict != "to note"]
