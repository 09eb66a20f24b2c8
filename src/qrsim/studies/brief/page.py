"""The page of a brief: one HTML file without scripts, its pictures embedded, nothing fetched."""

from __future__ import annotations

import base64
from importlib.resources import files
from typing import NamedTuple

from qrsim.extras import load
from qrsim.studies.brief.briefing import Brief
from qrsim.studies.brief.figures import MOST_TRACKS, map_figure, margins_figure, png, time_figure
from qrsim.studies.brief.studying import TRACK_S

TEMPLATE = "page.html.jinja"


class Picture(NamedTuple):
    """A picture of the page."""

    title: str
    png: bytes


def write_page(brief: Brief) -> str:
    """Return the page as text.

    Raises:
        MissingExtraError: Jinja is not installed.
    """
    jinja = load("brief", "qrsim brief", "jinja2")
    # Every text is escaped; an unknown name in the template is an error.
    made = jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.filters |= {"shown": shown, "base64": lambda data: base64.b64encode(data).decode("ascii")}
    template = files("qrsim.studies.brief").joinpath(TEMPLATE).read_text("utf-8")
    page: str = made.from_string(template).render(about=brief.to_json(), pictures=_pictures(brief))
    return page + "\n"


def _pictures(brief: Brief) -> list[Picture]:
    runs = brief.runs
    if not len(runs):
        return []
    scenario, criteria = brief.flights.scenario, brief.operation.criteria
    tracks = runs.tracks(MOST_TRACKS)
    worst = [run for run in brief.worst() if run < len(tracks)]
    found = [Picture("Map", png(map_figure(scenario, tracks, worst)))]
    margins = margins_figure(runs, brief.nominal)
    if margins is not None:
        found.append(Picture("Margins", png(margins)))
    low = brief.operation.contingency.low_battery.at
    line = time_figure(runs, tracks, low, criteria.reserve, brief.sky, TRACK_S)
    return [*found, Picture("Time line", png(line))]


def shown(value: float | None, unit: str) -> str:
    """Format a number with its unit; shares in percent, a dash for None."""
    if value is None:
        return "-"
    if unit == "1":
        return f"{100.0 * value:.3g} %"
    return f"{value:.3g} {unit}" if abs(value) < 1000.0 else f"{value:.0f} {unit}"
