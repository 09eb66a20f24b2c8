"""Figures of results."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from qrsim.core.arrays import NumpyArray
from qrsim.runs.picture import new_figure
from qrsim.studies.sweep.analysis import CONFIDENCE, Boundary, Response, Sensitivity, heat_map, share_interval
from qrsim.studies.sweep.results import Parameter, Results

NOT_FLOWN = "0.85"
BAND = f"{100 * CONFIDENCE:.0f} % interval"


# Letters of a title in an inch of a figure.
LETTERS_PER_INCH = 11


def _name(figure: Figure, results: Results, what: str) -> None:
    """Set a figure's title, which says what it shows (``what``) and is wrapped to its width."""
    some = "" if results.episodes == results.planned else f" of {results.planned}"
    text = f"{results.spec.name}: {what}\n{results.episodes}{some} episodes of {results.scenario['name']}"
    width = int(LETTERS_PER_INCH * figure.get_figwidth())
    figure.suptitle("\n".join(textwrap.fill(line, width) for line in text.split("\n")), fontsize=11)


def _metric(results: Results, name: str) -> str:
    """Return the axis label of a metric: name and unit."""
    unit = results.unit(name)
    return f"{name} [{unit}]" if unit != "1" else name


def _places(parameter: Parameter) -> NumpyArray:
    """Return where a parameter's L levels lie on a figure's axis (L,): their values, or 0, 1, 2, ... if not numeric."""
    return np.asarray(parameter.levels, float) if parameter.numeric else np.arange(len(parameter.levels), dtype=float)


def edges(parameter: Parameter) -> NumpyArray:
    """Return the limits (L + 1,) between a parameter's L levels on a figure's axis.

    Of numbers the outermost are the lowest and the highest that were flown: a map says nothing beyond them.
    """
    places = _places(parameter)
    if parameter.numeric:
        places = parameter.even(places)
    if len(places) == 1:
        found = places + np.array([-0.5, 0.5])
    else:
        between = 0.5 * (places[1:] + places[:-1])
        ends = [2 * places[0] - between[0], 2 * places[-1] - between[-1]]
        if parameter.numeric:
            values = parameter.even(parameter.values)
            ends = [float(values.min()), float(values.max())]
        found = np.concatenate([ends[:1], between, ends[1:]])
    return parameter.uneven(found) if parameter.numeric else found


def _name_levels(axis: Axis, parameter: Parameter) -> None:
    """Label the ticks of a figure's axis with the levels of a parameter that is not numeric."""
    if not parameter.numeric:
        texts = [text if len(text) < 24 else f"{text[:21]}..." for text in parameter.levels]
        axis.set_ticks(_places(parameter), texts)


def draw_responses(results: Results, metrics: Sequence[str], found: dict[str, list[Response]]) -> Figure:
    """Draw every metric over every parameter, with intervals, a row of panels for each metric."""
    rows, columns = len(metrics), len(results.parameters)
    figure = new_figure(4.4 * columns + 0.6, 3.0 * rows + 0.9)
    panels = figure.subplots(rows, columns, squeeze=False, sharey="row", sharex="col")
    for row, metric in zip(panels, metrics, strict=True):
        for axes, item in zip(row, found[metric], strict=True):
            places = _places(item.parameter)
            line = "o-" if item.parameter.numeric else "o"
            axes.errorbar(
                places,
                item.mean,
                yerr=[item.mean - item.low, item.high - item.mean],
                fmt="none",
                color="tab:blue",
                capsize=2,
                lw=1.0,
            )
            if item.parameter.numeric:
                axes.fill_between(places, item.low, item.high, color="tab:blue", alpha=0.2, lw=0)
            axes.plot(places, item.mean, line, color="tab:blue", ms=4)
            axes.grid(alpha=0.3)
        row[0].set_ylabel(_metric(results, metric), fontsize=9)
    for axes, parameter in zip(panels[-1], results.parameters.values(), strict=True):
        axes.set_xlabel(parameter.label)
        _scale(axes, parameter)
        _name_levels(axes.xaxis, parameter)
    _name(figure, results, f"mean over all other parameters and seeds, with its {BAND}")
    return figure


def draw_map(results: Results, pair: tuple[Parameter, Parameter], metric: str) -> Figure:
    """Draw the mean of a metric over two parameters as a colour map."""
    figure = new_figure(7.2, 5.6)
    axes = figure.subplots()
    image = _mesh(axes, pair, heat_map(*pair, results.metric(metric)), "viridis")
    figure.colorbar(image, ax=axes, label=_metric(results, metric))
    _name(figure, results, f"mean {metric}")
    return figure


def _mesh(
    axes: Axes, pair: tuple[Parameter, Parameter], values: NumpyArray, colours: str, most: float | None = None
) -> QuadMesh:
    """Draw values at pairs of levels (L1, L2) as a colour mesh, the first parameter to the right, 0 to ``most``."""
    one, other = pair
    least = None if most is None else 0.0
    image = axes.pcolormesh(edges(one), edges(other), values.T, cmap=colours, vmin=least, vmax=most)
    # What was not flown has no colour of the scale.
    axes.set_facecolor(NOT_FLOWN)
    _scale(axes, one, other)
    axes.set(xlabel=one.label, ylabel=other.label)
    _name_levels(axes.xaxis, one)
    _name_levels(axes.yaxis, other)
    return image


def _scale(axes: Axes, one: Parameter, other: Parameter | None = None) -> None:
    """Give the axes of logarithmic parameters a logarithmic scale."""
    if one.log:
        axes.set_xscale("log")
    if other is not None and other.log:
        axes.set_yscale("log")


def draw_boundary(results: Results, found: Boundary, pair: tuple[Parameter, Parameter] | None) -> Figure:
    """Draw the share of failed episodes over two parameters, and the fitted line where half of them fail."""
    numbers = {parameter.name: i for i, parameter in enumerate(found.parameters)}
    if pair is None or any(parameter.name not in numbers for parameter in pair):
        return _failure_curves(results, found)
    figure = new_figure(7.2, 5.6)
    axes = figure.subplots()
    shares = heat_map(*pair, results.failed.astype(float))
    image = _mesh(axes, pair, shares, "YlOrRd", most=1.0)
    figure.colorbar(image, ax=axes, label="part of the episodes that failed")
    which = [numbers[parameter.name] for parameter in pair]
    lines = [found.line(number, 120)[:, number] for number in which]
    grid = np.tile(found.middle, (120, 120, 1))
    grid[..., which[0]], grid[..., which[1]] = np.meshgrid(*lines)
    shown = [parameter.uneven(line) for parameter, line in zip(pair, lines, strict=True)]
    chances = np.where(_is_flown(pair, shown, shares), found.probability(grid), np.nan)
    curves = axes.contour(*shown, chances, [0.1, 0.5, 0.9], colors="black", linestyles=["dotted", "solid", "dashed"])
    axes.clabel(curves, fmt=lambda part: f"{100 * part:.0f} %")
    others = " (the others at their middle)" if len(found.parameters) > 2 else ""
    _name(figure, results, f"failed: {results.failure}\nlines: logistic fit{others}")
    return figure


def _is_flown(pair: tuple[Parameter, Parameter], lines: list[NumpyArray], values: NumpyArray) -> NumpyArray:
    """Return a mask (Y, X) of places in those cells of a map (L1, L2) that have episodes; ``lines`` are coordinates."""
    cells = [
        np.clip(np.searchsorted(edges(parameter), line, side="right") - 1, 0, len(parameter.levels) - 1)
        for parameter, line in zip(pair, lines, strict=True)
    ]
    return np.asarray(np.isfinite(values[np.ix_(*cells)]).T)


def _failure_curves(results: Results, found: Boundary) -> Figure:
    """Draw the share of failed episodes over each parameter."""
    figure = new_figure(4.8 * len(found.parameters) + 1.0, 4.2)
    panels = figure.subplots(1, len(found.parameters), squeeze=False, sharey=True)[0]
    for i, (axes, parameter) in enumerate(zip(panels, found.parameters, strict=True)):
        low, middle, high = failure_parts(
            parameter, results.failed, results.points if parameter.sampled else results.seeds
        )
        axes.errorbar(
            _places(parameter),
            middle,
            yerr=[middle - low, high - middle],
            fmt="o",
            color="tab:red",
            capsize=3,
            label=f"part that failed, {BAND}",
        )
        line = found.line(i, 200)
        shown = parameter.uneven(line[:, i])
        axes.plot(shown, found.probability(line), "k-", label="logistic fit")
        _scale(axes, parameter)
        band = found.band(line)
        if band is not None:
            axes.fill_between(shown, *band, color="black", alpha=0.15, lw=0)
        axes.axhline(0.5, color="0.6", lw=0.8)
        axes.set(xlabel=parameter.label, ylim=(-0.03, 1.03))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("part of the episodes that failed")
    panels[0].legend(fontsize=8)
    _name(figure, results, f"failed: {results.failure}")
    return figure


def failure_parts(
    parameter: Parameter, failed: NumpyArray, groups: NumpyArray
) -> tuple[NumpyArray, NumpyArray, NumpyArray]:
    """Return low end, share and high end of the share of failed episodes at each level (L,), by its exact interval.

    ``groups`` (E,) are what is independent; see ``share_interval``.
    """
    found = np.full((3, len(parameter.levels)), np.nan)
    for i in range(len(parameter.levels)):
        own = failed[parameter.level == i]
        if len(own):
            _, index = np.unique(groups[parameter.level == i], return_inverse=True)
            shares = np.bincount(index, own) / np.bincount(index)
            low, high = share_interval(float(own.mean()), shares, len(own))
            found[:, i] = low, own.mean(), high
    return found[0], found[1], found[2]


def draw_sensitivity(results: Results, found: Sensitivity, metric: str) -> Figure:
    """Draw the Sobol indices of a metric as bars, one pair for each parameter."""
    figure = new_figure(7.0, 1.8 + 0.7 * len(found.names))
    axes = figure.subplots()
    places = np.arange(len(found.names))
    pairs = (
        (found.total, found.total_half, "with others (total)", 0.2, "tab:orange"),
        (found.first, found.first_half, "alone (first order)", -0.2, "tab:blue"),
    )
    for values, half, label, shift, colour in pairs:
        axes.barh(places + shift, values, 0.38, xerr=half, label=label, color=colour, capsize=3)
    axes.set_yticks(places, found.names)
    axes.invert_yaxis()
    axes.set(xlabel=f"part of the variance of the mean {metric}, with its {BAND}")
    axes.grid(alpha=0.3, axis="x")
    axes.legend(fontsize=8)
    _name(figure, results, f"Sobol indices of {metric}")
    return figure
