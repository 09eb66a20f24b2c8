"""Pictures of the report: PNGs in memory, all of one style."""

from __future__ import annotations

import io

from matplotlib.figure import Figure

from qrsim.runs.picture import new_figure
from qrsim.studies.validate.recorded import Match
from qrsim.studies.validate.report import Picture

RECORDED, SIMULATED, OTHER, RESIDUAL = "black", "tab:red", "tab:blue", "tab:purple"
DPI = 90


def picture(figure: Figure, caption: str) -> Picture:
    """Render a Matplotlib figure as a PNG for the report; the figure is kept for vector output."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DPI, format="png")
    return Picture(buffer.getvalue(), caption, figure)


def match_figure(match: Match, titles: tuple[str, ...], units: tuple[str, ...]) -> Figure:
    """Draw recorded and simulated quantities one below the other, each with its residual below it."""
    count = len(match.names)
    figure = new_figure(11.0, 2.9 * count if count > 1 else 5.0)
    axes = figure.subplots(2 * count, 1, sharex=True, squeeze=False, height_ratios=(2, 1) * count)[:, 0]
    for i, (title, unit) in enumerate(zip(titles, units, strict=True)):
        top, bottom = axes[2 * i], axes[2 * i + 1]
        top.plot(match.time, match.recorded[:, i], color=RECORDED, lw=1.3, label="recorded")
        top.plot(match.time, match.simulated[:, i], color=SIMULATED, lw=1.0, label="simulated")
        top.set_ylabel(f"{title}\n[{unit}]")
        bottom.plot(match.time, match.residual[:, i], color=RESIDUAL, lw=0.8)
        bottom.axhline(0.0, color="gray", lw=0.6)
        bottom.set_ylabel(f"residual\n[{unit}]")
        for panel in (top, bottom):
            panel.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=9)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(float(match.time[0]), float(match.time[-1]))
    figure.align_ylabels()
    return figure
