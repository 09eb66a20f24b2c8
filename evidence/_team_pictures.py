"""The picture of the study of independent errors of a team."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from evidence._pictures import picture

COLOURS = {"per_vehicle": "tab:red", "common_only": "tab:blue", "budget": "black"}
STYLES = {"own": ("--", "o"), "field": ("-", "s")}
WORDS = {"per_vehicle": "all of its own", "common_only": "all but noise shared", "budget": "error budget"}
GUSTS = {"own": "gusts of its own", "field": "one field"}
ROWS = (
    ("relative_error_rms_m", "neighbours off their\nplaces, rms [m]", ("block", "relative", "line")),
    ("separation_min_m", "smallest distance [m]", ("block", "relative", "line")),
    ("collided", "share of flights that\ncome nearer than 0.65 m", ("block", "relative", "line")),
    ("missed_share", "part of the strip\nthat nobody sees", ("line",)),
)
TITLES = {
    "block": "block, each on its own path",
    "relative": "block by relative positions",
    "line": "line that searches",
}


def draw(points: dict[str, Any], path: Path) -> None:
    """Draw every number against the spacing; bars are intervals of 95 %."""
    with picture(
        path, (11.0, 12.0), len(ROWS), len(TITLES), sharex=True, squeeze=False, dpi=90, legends=False
    ) as panels:
        for i, (metric, words, teams) in enumerate(ROWS):
            for j, (team, title) in enumerate(TITLES.items()):
                axes = panels[i][j]
                if team not in teams:
                    axes.set_axis_off()
                    continue
                _panel(axes, points[team], metric)
                axes.set_title(title if i == 0 else "", fontsize=11)
                axes.tick_params(labelbottom=True)
                if j == 0 or len(teams) == 1:
                    axes.set_ylabel(words)
                if i == 2 or len(teams) == 1:
                    axes.set_xlabel("spacing [m]")
        handles, labels = panels[0][0].get_legend_handles_labels()
        panels[-1][0].legend(
            handles, labels, loc="center left", bbox_to_anchor=(0.0, 0.5), fontsize=10, title="receivers, gusts"
        )


def _panel(axes: Any, team: dict[str, Any], metric: str) -> None:
    shift = 0.0
    for turbulence, by_gnss in team.items():
        line, mark = STYLES[turbulence]
        for gnss, by_spacing in by_gnss.items():
            places = [float(name.replace("_", ".")) * (1.0 + 0.012 * shift) for name in by_spacing]
            found = [each[metric] for each in by_spacing.values()]
            values = [each["value"] for each in found]
            bars = [[each["value"] - each["low"] for each in found], [each["high"] - each["value"] for each in found]]
            axes.errorbar(
                places,
                values,
                yerr=bars,
                color=COLOURS[gnss],
                ls=line,
                marker=mark,
                ms=4,
                lw=1.2,
                capsize=2,
                label=f"{WORDS[gnss]}, {GUSTS[turbulence]}",
            )
            shift += 1.0
    axes.set_ylim(bottom=0.0)
    axes.set_xticks([3, 5, 10])
