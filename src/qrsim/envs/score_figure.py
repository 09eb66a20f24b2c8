"""The picture of ``qrsim score``: the returns of each policy, and an episode of the first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qrsim.envs.scoring import Scored
from qrsim.runs.colours import VEHICLES, share
from qrsim.runs.picture import new_figure

# Episodes of a policy lie beside each other in their row, the same episode at the same place.
SPREAD = 0.3


def draw_scores(task: str, found: Sequence[Scored]) -> Figure:
    """Draw each policy's returns with mean and interval, and the first policy's first episode from above."""
    drawn = found[0].picture is not None
    figure = new_figure(12.0 if drawn else 7.0, 4.8)
    axes = figure.subplots(1, 2 if drawn else 1, squeeze=False)[0]
    _draw_returns(axes[0], found)
    if drawn:
        axes[1].imshow(found[0].picture)
        axes[1].set_axis_off()
    seeds = len(found[0].returns)
    figure.suptitle(f"{task}: {seeds} episode{'s' * (seeds != 1)}, the same for every policy")
    return figure


def _draw_returns(axes: Axes, found: Sequence[Scored]) -> None:
    """Draw the returns of all episodes of each policy in a plot, with their mean and confidence interval."""
    every = np.concatenate([each.returns for each in found])
    for row, each in enumerate(found):
        colour = share(VEHICLES[row % len(VEHICLES)])
        beside = np.linspace(-SPREAD, SPREAD, len(each.returns)) if len(each.returns) > 1 else np.zeros(1)
        for alive, marker in ((True, "o"), (False, "x")):
            those = each.alive == alive
            axes.plot(each.returns[those], row + beside[those], marker, color=colour, ms=4, alpha=0.7)
        mean = each.interval
        if np.isfinite(mean.low):
            axes.plot([mean.low, mean.high], [row, row], "-", color="black", lw=2.5)
        axes.plot([mean.mean], [row], "D", color="black", ms=6)
    axes.set_yticks(range(len(found)), [each.name for each in found])
    axes.invert_yaxis()
    if np.ptp(every) > 100.0 * max(1e-9, float(np.min(np.abs(every)))):
        axes.set_xscale("symlog", linthresh=max(1e-3, float(np.quantile(np.abs(every), 0.1))))
        low, high = float(every.min()), float(every.max())
        axes.set_xlim(low * (1.5 if low < 0.0 else 0.7), high * (0.7 if high < 0.0 else 1.5))
    axes.set_xlabel("return of an episode; x: a vehicle stopped; black: mean, 95 % interval")
    axes.grid(alpha=0.3)
