"""Figures of cooperative SLAM: the trajectories of all vehicles, and errors alone and together."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from qrsim.runs.picture import new_figure
from qrsim.studies.slam.cooperative import CooperativeSlam
from qrsim.studies.slam.team_study import TeamStudy

SHORT = {
    "white": "white",
    "own_as_white": "own,\ntaken\nfor white",
    "own_as_own_states": "own,\nas states",
    "shared_as_white": "shared,\ntaken\nfor white",
    "shared_as_own_states": "shared,\nas states\nof each",
    "shared_as_one_state": "shared,\nas one state",
}


def draw_together(solved: CooperativeSlam, title: str) -> Figure:
    """Draw estimated trajectories of several vehicles and their landmarks in plan view, north up."""
    figure = new_figure(7.0, 6.6)
    axes = figure.subplots()
    for vehicle, (places, truth) in enumerate(zip(solved.position_ned, solved.truth_ned, strict=True)):
        label = "true trajectories" if vehicle == 0 else None
        axes.plot(truth[:, 1], truth[:, 0], "-", color="black", lw=0.8, label=label)
        axes.plot(places[:, 1], places[:, 0], "-", color=f"C{vehicle}", lw=1.0, label=f"vehicle {vehicle}")
    known = solved.determined
    truth = solved.rangings[0].true_ned
    if truth is not None:
        axes.plot(truth[:, 1], truth[:, 0], "k*", ms=9, label="true landmarks")
    places = solved.landmarks_ned[known]
    axes.plot(places[:, 1], places[:, 0], "o", color="tab:green", mfc="none", ms=7, label="landmarks")
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.grid(alpha=0.3)
    axes.set_title(title, fontsize=10)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)
    return figure


def draw_gain(found: TeamStudy) -> Figure:
    """Draw the first vehicle's error of each seed alone and in the team, and relative errors, by case."""
    figure = new_figure(12.0, 5.0)
    panels = figure.subplots(1, 2, sharey=True)
    for i, case in enumerate(found.alone):
        errors = [[each.trajectory_rmse_m[0] for each in part[case]] for part in (found.alone, found.together)]
        relative = [each.relative_rmse_m for each in found.together[case]]
        for pair in np.transpose(errors):
            panels[0].plot([i - 0.17, i + 0.17], pair, "-", color="0.8", lw=0.5, zorder=1)
        drawn = (
            (panels[0], i - 0.17, errors[0], "tab:red", "alone"),
            (panels[0], i + 0.17, errors[1], "tab:blue", f"with {found.vehicles - 1} more"),
            (panels[1], float(i), relative, "tab:green", "relative, all pairs"),
        )
        for axes, place, values, colour, label in drawn:
            axes.plot(np.full(len(values), place), values, ".", color=colour, ms=5, label=None if i else label)
            axes.plot(place, np.median(values), "_", color="black", ms=22, mew=2, zorder=3)
    for axes, title in zip(
        panels, ("error of the first vehicle", "error of positions relative to each other"), strict=True
    ):
        axes.set_xticks(range(len(found.alone)), [SHORT[case] for case in found.alone], fontsize=8)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
        axes.set_title(f"{title}, RMS of each seed", fontsize=10)
        axes.grid(alpha=0.3, axis="y", which="both")
        axes.legend(fontsize=8)
    panels[0].set_ylabel("[m]")
    figure.suptitle(f"{found.vehicles} vehicles, {len(found.seeds)} seeds, by their GNSS errors; bars: medians")
    return figure
