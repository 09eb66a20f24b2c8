"""The page of a brief: one HTML file without scripts, its pictures embedded, nothing fetched."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from importlib.resources import files
from typing import NamedTuple

from matplotlib.figure import Figure

from qrsim.extras import load
from qrsim.studies.brief.briefing import Brief
from qrsim.studies.brief.figures import MOST_TRACKS, losses, map_figure, margins_figure, png, polar_figure, time_figure
from qrsim.studies.brief.judging import measured
from qrsim.studies.brief.studying import TRACK_S

TEMPLATE = "page.html.jinja"


class Picture(NamedTuple):
    """A picture of the page."""

    title: str
    png: bytes


def write_page(brief: Brief) -> str:
    """Return the brief as an HTML page.

    Raises:
        MissingExtraError: Jinja is not installed.
    """
    jinja = load("brief", "qrsim brief", "jinja2")
    # Every text is escaped; an unknown name in the template is an error.
    made = jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.filters |= {"shown": shown, "base64": lambda data: base64.b64encode(data).decode("ascii")}
    template = files("qrsim.studies.brief").joinpath(TEMPLATE).read_text("utf-8")
    pictures = [Picture(title, png(figure)) for title, figure in figures_of(brief)]
    page: str = made.from_string(template).render(
        about=brief.to_json(),
        measured=measured,
        conditions=conditions(brief),
        missing=brief.missing_text(),
        volumes=brief.volumes_text(),
        pictures=pictures,
    )
    return page + "\n"


def figures_of(brief: Brief) -> Iterator[tuple[str, Figure]]:
    """Yield (title, figure) for each figure of a brief, in the order of the page."""
    runs, criteria = brief.runs, brief.operation.criteria
    if len(runs):
        tracks = runs.tracks(MOST_TRACKS)
        worst = [run for run in brief.worst() if run < len(tracks)]
        yield "Map", map_figure(brief.flights.scenario, tracks, worst, losses(runs, tracks))
        margins = margins_figure(runs, brief.nominal)
        if margins is not None:
            yield "Margins", margins
        low = brief.operation.contingency.low_battery.at
        yield "Time line", time_figure(runs, tracks, low, criteria.reserve, brief.sky, TRACK_S)
    if brief.boundary is not None and brief.boundary.flown:
        yield "Wind", polar_figure(brief.boundary, brief.flights.wind)


def conditions(brief: Brief) -> str:
    """Return a sentence about the wind, vehicles and flight lengths that a brief is about."""
    wind, flights = brief.operation.wind, brief.flights
    blows = f"wind of {wind.file}" if wind.file else f"wind {wind.speed:g} m/s from {wind.from_deg:g} deg"
    blows += "" if wind.file else f" at {wind.height:g} m, with an error of {wind.std:g} m/s and {wind.from_std:g} deg"
    models = ", ".join(dict.fromkeys(mission.vehicle for mission in brief.operation.missions))
    lengths = zip(flights.names, flights.planned_s, strict=True)
    planned = ", ".join(f"{name} {length:.0f} s" for name, length in lengths)
    return f"Simulated flights: {blows}, and its gusts; {models}; planned: {planned}."


def shown(value: float | None, unit: str) -> str:
    """Format a number with its unit; shares in percent, a dash for None."""
    if value is None:
        return "-"
    if unit == "1":
        return f"{100.0 * value:.3g} %"
    if unit == "m":
        return f"{value:.1f} m"
    return f"{value:.3g} {unit}" if abs(value) < 1000.0 else f"{value:.0f} {unit}"
