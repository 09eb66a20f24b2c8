"""The report as a PDF, and its pictures one by one: vectors, as a paper prints them."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from qrsim.studies.validate.page import SOURCE, number
from qrsim.studies.validate.parts import Result
from qrsim.studies.validate.report import Check, Finding, Picture, worst

# A4 [inch], margins, and what fits: lines of text and characters of a line, by size [pt].
PAGE, LEFT, TOP, BOTTOM = (8.27, 11.69), 0.09, 0.94, 0.06
TEXT, HEAD = 9.0, 15.0
PER_LINE, PER_BOLD_LINE, LEADING = 104, 88, 1.45


class Line(NamedTuple):
    """A line of text, its size [pt], and whether it is bold."""

    text: str
    size: float = TEXT
    bold: bool = False


def write_pdf(results: Sequence[Result], about: Mapping[str, object]) -> bytes:
    """Return the validation report as PDF: a page of results, then text, pictures and tables of each part.

    Args:
        results: in the order they are shown.
        about: what stands beside the parts in the JSON.
    """
    buffer = io.BytesIO()
    # Without a date, so that the same report is the same file.
    with PdfPages(buffer, metadata={"Title": f"Validation of qrsim {about['qrsim']}", "CreationDate": None}) as pages:
        for page in _paginate([*_front_page(results, about)]):
            pages.savefig(page)
        for result in results:
            for page in _paginate([*_part_text(result)]):
                pages.savefig(page)
            for shown in result.outcome.pictures if result.outcome else ():
                if shown.figure is not None:
                    pages.savefig(shown.figure, bbox_inches="tight", pad_inches=0.3)
            for page in _paginate([*_part_tables(result)]):
                pages.savefig(page)
    return buffer.getvalue()


def figures(results: Sequence[Result]) -> dict[str, bytes]:
    """Return file name, such as ``gnss_2.pdf``, -> PDF bytes, for each picture of the report."""
    found = {}
    for result in results:
        for i, shown in enumerate(result.outcome.pictures if result.outcome else (), start=1):
            if shown.figure is not None:
                found[f"{result.part.name}_{i}.pdf"] = _picture_pdf(shown)
    return found


def _picture_pdf(shown: Picture) -> bytes:
    """Return a picture of the report as PDF bytes without a date."""
    assert shown.figure is not None
    buffer = io.BytesIO()
    shown.figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    return buffer.getvalue()


def _wrapped_lines(text: str, indent: str = "", *, bold: bool = False) -> Iterator[Line]:
    """Yield the printed lines of a text, wrapped to the width of the PDF's page."""
    width = PER_BOLD_LINE if bold else PER_LINE
    for line in textwrap.wrap(text, width, subsequent_indent=indent) or [""]:
        yield Line(line, bold=bold)


def _front_page(results: Sequence[Result], about: Mapping[str, object]) -> Iterator[Line]:
    """Yield the printed lines of the report's first page: the results of all parts."""
    checks = [check for result in results if result.outcome for check in result.outcome.checks]
    failed = sum(not check.passed for check in checks)
    yield Line(f"Validation of qrsim {about['qrsim']}", 20.0, bold=True)
    yield Line(f"{about['made']}, {about['platform']}, jax {about['jax']}")
    yield Line("")
    yield Line(
        f"{failed} of {len(checks)} checks failed." if failed else f"All {len(checks)} checks passed.", bold=True
    )
    yield Line("")
    yield from _wrapped_lines(f"The simulator follows {SOURCE}.")
    yield from _wrapped_lines(
        "A check asks whether the program computes what it should; one that fails is an error. A finding says how well "
        "a model describes what was recorded, and fails nothing."
    )
    for result in results:
        yield Line("")
        yield Line(result.part.title, 12.0, bold=True)
        if result.outcome is None:
            yield from _wrapped_lines(f"Skipped: {result.skipped}.")
            continue
        good = sum(check.passed for check in result.outcome.checks)
        yield from _wrapped_lines(f"{good} of {len(result.outcome.checks)} checks. {result.outcome.reading}")


def _part_text(result: Result) -> Iterator[Line]:
    """Yield the printed lines about one part of the report: method, interpretation and pictures."""
    yield Line(result.part.title, HEAD, bold=True)
    yield Line("")
    yield from _wrapped_lines(f"Answers {result.part.answers}.")
    if result.outcome is None:
        yield from _wrapped_lines(f"Skipped: {result.skipped}.")
        return
    yield Line("")
    yield from _wrapped_lines(result.outcome.method)
    yield Line("")
    yield from _wrapped_lines(result.outcome.reading, bold=True)
    for words in result.outcome.skipped:
        yield from _wrapped_lines(f"Skipped: {words}.")
    for i, shown in enumerate(result.outcome.pictures, start=1):
        yield Line("")
        yield from _wrapped_lines(f"Picture {i}: {shown.caption}")


def _part_tables(result: Result) -> Iterator[Line]:
    """Yield the printed lines of the findings and checks of one part of the report."""
    if result.outcome is None:
        return
    yield Line(f"{result.part.title}: numbers", HEAD, bold=True)
    for found in result.outcome.findings:
        yield Line("")
        yield from _finding_lines(found)
    for check in result.outcome.checks:
        yield Line("")
        yield from _check_lines(check)
    if result.outcome.checks:
        narrow = worst(result.outcome.checks)
        used = 100.0 * abs(narrow.value - narrow.expected) / narrow.tolerance
        yield Line("")
        yield from _wrapped_lines(f"Nearest to its bound: {narrow.name}, at {used:.0f} % of it.")


def _finding_lines(found: Finding) -> Iterator[Line]:
    """Yield the printed lines of one finding."""
    yield from _wrapped_lines(f"{found.verdict}: {found.name}: {found.number}", "    ", bold=True)
    yield from _wrapped_lines(f"    {found.reading}", "    ")


def _check_lines(check: Check) -> Iterator[Line]:
    """Yield the printed lines of a check: value, expectation and tolerance."""
    yield from _wrapped_lines(f"{'pass' if check.passed else 'FAIL'}: {check.name}", "    ", bold=not check.passed)
    unit = f" {check.unit}" if check.unit else ""
    comparison = (
        f"{number(check.value)}{unit}; expected {number(check.expected)} ± {check.tolerance:.2g}: {check.reason}"
    )
    yield from _wrapped_lines(f"    {comparison}", "    ")


def _paginate(lines: Sequence[Line]) -> Iterator[Figure]:
    """Yield pages, as Matplotlib figures, that hold the printed lines."""
    page, height = None, 0.0
    for line in lines:
        needed = line.size * LEADING / 72.0 / PAGE[1]
        if page is None or height - needed < BOTTOM:
            if page is not None:
                yield page
            page, height = Figure(figsize=PAGE), TOP
        height -= needed
        page.text(LEFT, height, line.text, fontsize=line.size, weight="bold" if line.bold else "normal")
    if page is not None:
        yield page
