"""The report of the validation as a PDF."""

from __future__ import annotations

import re
from typing import Any

import pytest
from matplotlib.figure import Figure

from qrsim.studies.validate import pdf
from qrsim.studies.validate.parts import Result
from qrsim.studies.validate.pictures import picture
from qrsim.studies.validate.report import Check, Finding, Outcome, Part

ABOUT = {"qrsim": "1.2", "made": "today", "platform": "here", "jax": "0"}


def result(value: float = 1.0, checks: int = 1) -> Result:
    """Return a part with a picture, a finding and checks of a value against 1."""
    figure = Figure(figsize=(4.0, 3.0))
    figure.subplots().plot([1.0, 3.0])
    found = [Check(f"check {i}", value, 1.0, 0.1, "m", "because " * 30) for i in range(checks)]
    shown = picture(figure, "a line")
    outcome = Outcome("By hand.", "One.", found, [Finding("a fit", "1 %", "fits", "Well.")], [shown], {})

    def run(paths: Any, full: bool) -> Outcome:
        return outcome

    return Result(Part("made_up", "Made up", "no figure", (), run), outcome)


def pages_of(content: bytes) -> int:
    """Return how many pages a PDF has."""
    (count,) = re.findall(rb"/Type /Pages\b.*?/Count (\d+)|/Count (\d+).*?/Type /Pages\b", content, re.DOTALL)
    return int(count[0] or count[1])


@pytest.mark.long
def test_a_report_has_text_pictures_and_numbers() -> None:
    """A page in front, one of text, one with the picture, one of numbers; many checks take more pages."""
    content = pdf.write_pdf([result()], ABOUT)
    assert content.startswith(b"%PDF-")
    assert pages_of(content) == 4
    assert pages_of(pdf.write_pdf([result(checks=40)], ABOUT)) > 5
    assert content == pdf.write_pdf([result()], ABOUT)


def test_a_part_that_was_skipped_says_why() -> None:
    """In front, and on its own page."""
    skipped = Result(result().part, None, "no recordings")
    assert pages_of(pdf.write_pdf([skipped], ABOUT)) == 2
    assert pdf.Line("Skipped: no recordings.") in list(pdf._front_page([skipped], ABOUT))


def test_a_check_that_fails_stands_out() -> None:
    """In front, and with its numbers."""
    front, tables = list(pdf._front_page([result(2.0)], ABOUT)), list(pdf._part_tables(result(2.0)))
    assert pdf.Line("1 of 1 checks failed.", bold=True) in front
    assert pdf.Line("FAIL: check 0", bold=True) in tables
    assert any("2 m; expected 1 ± 0.1: because" in line.text for line in tables)
    # Words beyond the margin would be lost.
    assert max(len(line.text) for line in tables) <= pdf.PER_LINE


def test_each_picture_is_a_file_of_its_own() -> None:
    """Named after its part."""
    (name,) = found = pdf.figures([result()])
    assert name == "made_up_1.pdf"
    assert found[name].startswith(b"%PDF-")
