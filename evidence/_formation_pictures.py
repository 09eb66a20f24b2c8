"""Pictures of the study of formations in gusts: spacing by spacing, and a gust that travels through a line."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from tests.models.atmosphere import field_reference as of

from evidence import IMAGES
from evidence._pictures import picture

SPACINGS, GUST = IMAGES / "turbulence_spacing.png", IMAGES / "turbulence_gust.gif"
# Of the animation: wind [m/s], height and distance of the vehicles [m], their number, times [s] and time of a frame.
WIND, HEIGHT, APART, VEHICLES = 8.0, 15.0, 10.0, 5
LASTS_S, FRAME_S, PAUSE_MS = 12.0, 0.25, 120
# Colours of a picture of few, so that the file is small.
LEVELS = np.linspace(-3.0, 3.0, 13)
COLOURS = 48

Values = np.ndarray[Any, Any]


def draw_spacings(grids: dict[str, Any], closed: Callable[[float], dict[str, float]], path: Path = SPACINGS) -> None:
    """Draw correlation and relative motion of neighbours against the spacing of their grid.

    Args:
        grids: by spacing, the results of each kind of gusts.
        closed: the correlations in closed form at a spacing [m].
        path: of the picture.
    """
    spacings = np.array([float(name.replace("_", ".")) for name in grids])
    fine = np.geomspace(spacings.min(), spacings.max(), 100)
    with picture(path, (11.0, 4.2), 1, 2) as (left, right):

        def band(panel: Any, rows: list[dict[str, float]], label: str, colour: str, marker: str) -> None:
            value, low, high = (np.array([row[name] for row in rows]) for name in ("value", "low", "high"))
            panel.errorbar(
                spacings, value, [value - low, high - value], fmt=marker, ms=4, lw=1.0, color=colour, label=label
            )

        for name, colour in (("horizontal", "tab:blue"), ("vertical", "tab:green")):
            left.plot(fine, [closed(float(r))[name] for r in fine], color=colour, lw=1.2)
            for kind, marker in (("dryden_field", "o"), ("dryden", "x")):
                band(
                    left, [row[kind]["correlation"][name] for row in grids.values()], f"{kind}, {name}", colour, marker
                )
        left.set(xscale="log", xlabel="spacing [m]", ylabel="correlation of neighbours' gusts", ylim=(-0.15, 1.05))
        for name, colour in (("north", "tab:blue"), ("down", "tab:green")):
            for kind, marker in (("dryden_field", "o-"), ("dryden", "x--")):
                band(
                    right,
                    [row[kind]["relative_std"][name] for row in grids.values()],
                    f"{kind}, {name}",
                    colour,
                    marker,
                )
        right.set(
            xscale="log", xlabel="spacing [m]", ylabel="std of relative position of neighbours [m]", ylim=(0.0, None)
        )
        for panel in (left, right):
            panel.set_xticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])


def draw_gust(path: Path = GUST, lasts_s: float = LASTS_S) -> None:
    """Draw how gusts along the wind travel past vehicles that hover in a line, as an animation."""
    from PIL import Image

    turbulence = of.component(convection_ned=[WIND, 0.0])
    field = of.draw(turbulence)
    times = np.arange(0.0, lasts_s + 1e-6, FRAME_S)
    north, east = np.linspace(-25.0, 65.0, 61), np.linspace(-16.0, 16.0, 25)
    plane = np.stack([*np.meshgrid(north, east, indexing="ij"), np.full((61, 25), -HEIGHT)], axis=-1).reshape(-1, 3)
    stand = np.array([[APART * i, 0.0, -HEIGHT] for i in range(VEHICLES)])

    def gusts(places: Values, time: float) -> Values:
        seconds = int(time)
        return np.asarray(of.gust(turbulence, field, places, seconds, time - seconds)[0][:, 0])

    met = np.array([gusts(stand, time) for time in times])
    frames = []
    for number, time in enumerate(times.tolist()):
        image = _frame((north, east, gusts(plane, time).reshape(61, 25)), (times, met), number)
        frames.append(image.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE))
    path.parent.mkdir(parents=True, exist_ok=True)
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=PAUSE_MS, loop=0, optimize=True)


def _frame(plane: tuple[Values, Values, Values], series: tuple[Values, Values], number: int) -> Any:
    """Return a picture of a plane seen from above (north, east, gusts) and of what was met so far (times, gusts)."""
    from PIL import Image

    from qrsim.runs.picture import new_figure

    (north, east, gust), (times, met) = plane, series
    figure = new_figure(7.0, 4.6)
    above, below = figure.subplots(2, 1, height_ratios=(1.1, 1.0))
    drawn = above.contourf(north, east, gust.T, LEVELS, cmap="PuOr_r", extend="both")
    figure.colorbar(drawn, ax=above, label="gust down the wind [m/s]", ticks=[-3, 0, 3])
    colours = [f"C{i}" for i in range(VEHICLES)]
    above.scatter(APART * np.arange(VEHICLES), np.zeros(VEHICLES), c=colours, s=45, edgecolors="black", zorder=3)
    above.annotate("wind", (-8.0, 12.0), (-22.0, 12.0), arrowprops={"arrowstyle": "->"}, va="center")
    above.set(xlabel="north, down the wind [m]", ylabel="east [m]", aspect="equal")
    for i in range(VEHICLES):
        below.axhline(3.0 * i, color="0.85", lw=0.6, zorder=0)
        below.plot(times[: number + 1], 3.0 * i + met[: number + 1, i], color=colours[i], lw=1.4)
    below.axvline(times[number], color="0.6", lw=0.8)
    below.set(xlim=(0.0, times[-1]), ylim=(-3.5, 3.0 * VEHICLES + 0.5), xlabel="time [s]", ylabel="met at")
    below.set_yticks(3.0 * np.arange(VEHICLES), [f"{APART * i:g} m" for i in range(VEHICLES)])
    file = io.BytesIO()
    figure.savefig(file, dpi=90, format="png")
    file.seek(0)
    return Image.open(file).convert("RGB")
