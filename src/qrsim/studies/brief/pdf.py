"""A brief as a PDF in A4: one side for one vehicle, two for several."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Sequence

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Rectangle

from qrsim.studies.brief.briefing import Brief
from qrsim.studies.brief.figures import COLOURS, png
from qrsim.studies.brief.page import figures_of

# A4 [inch], left edge and width of the text in parts of it, size of the text [pt], its lines, and characters of one.
PAGE, LEFT, WIDE = (8.27, 11.69), 0.06, 0.88
SIZE, LEADING, PER_LINE = 6.6, 1.3, 148
DPI = 200


def write_pdf(brief: Brief) -> bytes:
    """Return a brief as PDF, one page for one vehicle, else two; equal briefs give equal bytes."""
    buffer = io.BytesIO()
    first = Figure(figsize=PAGE)
    height = _head(first, brief)
    height = _lines(first, height, _criteria(brief))
    notes = list(_notes(brief))
    alone = len(brief.flights.names) == 1
    low = _room(len(notes)) if alone else 0.03
    _pictures(first, brief, height - 0.005, low)
    if alone:
        _lines(first, low, notes)
    with PdfPages(buffer, metadata={"Title": f"{brief.operation.operation}", "CreationDate": None}) as pages:
        pages.savefig(first, dpi=DPI)
        if not alone:
            second = Figure(figsize=PAGE)
            _lines(second, 0.96, notes)
            pages.savefig(second, dpi=DPI)
    return buffer.getvalue()


def _step() -> float:
    """Return the height of a line of text, as a fraction of the page's height."""
    return SIZE * LEADING / 72.0 / PAGE[1]


def _room(lines: int) -> float:
    """Return the height on the page, as a fraction, at which its last ``lines`` lines begin."""
    return min(0.4, 0.035 + lines * _step())


def _head(page: Figure, brief: Brief) -> float:
    """Draw title, origin and verdict of a brief; return the height below them, as a fraction of the page."""
    verdict, why = brief.verdict
    about = brief.to_json()
    page.text(LEFT, 0.955, brief.operation.operation, fontsize=15, weight="bold")
    told = f"Flights from {about['at']}; {about['runs']} runs from seed {about['first_seed']}; qrsim {about['qrsim']}"
    missing = brief.missing_text()
    page.text(LEFT, 0.938, f"{told}; {missing}" if missing else told, fontsize=7.5)
    reasons = textwrap.wrap(why, 105)[:3]
    size = 0.018 + 0.012 * len(reasons)
    low = 0.93 - size
    page.add_artist(Rectangle((LEFT, low), WIDE, size, color=COLOURS[verdict], transform=page.transFigure))
    page.text(LEFT + 0.012, low + size / 2.0, verdict.upper(), fontsize=13, weight="bold", color="white", va="center")
    page.text(LEFT + 0.17, low + size / 2.0, "\n".join(reasons), fontsize=8, color="white", va="center")
    return low - 0.015


def _criteria(brief: Brief) -> Iterator[tuple[str, str]]:
    """Yield (line of text, colour) for each criterion of a brief."""
    for row in brief.rows:
        word = row.verdict if row.decides else f"{row.verdict} (reported only)"
        for i, line in enumerate(textwrap.wrap(f"{word.upper()}: {row.why}", PER_LINE, subsequent_indent="      ")):
            yield line, COLOURS[row.verdict] if i == 0 else "black"


def _notes(brief: Brief) -> Iterator[tuple[str, str]]:
    """Yield (line of text, colour) for the notes of a brief: volumes, faults, assumptions and worst seeds."""
    about = brief.to_json()
    lines = [f"SORA: {brief.volumes_text()}"]
    for fault in dict.fromkeys(each.fault for each in brief.outcomes):
        own = [each for each in brief.outcomes if each.fault == fault]
        shares = {
            "come home": [each.home for each in own],
            "land elsewhere": [each.elsewhere for each in own],
            "leave the area": [each.left_area for each in own],
            "crash or collide": [each.crashed for each in own],
        }
        told = ", ".join(f"{_percents(found)} {words}" for words, found in shares.items() if any(found))
        lines.append(f"Fault {fault} at {_percents([each.part for each in own])} of the mission: {told or 'none ends'}")
    lines += [*about["assumed"], *about["not_modelled"]]
    if about["worst"]:
        seeds = ", ".join(str(each["seed"]) for each in about["worst"])
        lines.append(f"Seeds of the worst runs: {seeds}. The page brief.html has the commands that fly them again.")
    for line in lines:
        for part in textwrap.wrap(line, PER_LINE, subsequent_indent="      "):
            yield part, "#333333"


def _percents(shares: Sequence[float]) -> str:
    """Return shares as percentages in text, separated by slashes."""
    return "/".join(f"{100 * share:.0f}" for share in shares) + " %"


def _lines(page: Figure, height: float, lines: Iterator[tuple[str, str]] | list[tuple[str, str]]) -> float:
    """Write (text, colour) lines downwards from a height (fraction of the page); return the height below them."""
    for text, colour in lines:
        height -= _step()
        page.text(LEFT, height, text, fontsize=SIZE, color=colour, parse_math=False)
    return height


def _pictures(page: Figure, brief: Brief, high: float, low: float) -> None:
    """Draw the figures of a brief in two columns between two heights, fractions of the page."""
    images = [imread(io.BytesIO(png(figure)), format="png") for _, figure in figures_of(brief)]
    rows = max(1, (len(images) + 1) // 2)
    size = (high - low) / rows
    for number, image in enumerate(images):
        row, column = divmod(number, 2)
        axes = page.add_axes((LEFT + column * WIDE / 2, high - (row + 1) * size, WIDE / 2 - 0.01, size))
        axes.imshow(image, interpolation="lanczos")
        axes.set_axis_off()
        axes.set_anchor("N")
