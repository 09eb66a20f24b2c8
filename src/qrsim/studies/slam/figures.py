"""Figures of a study: trajectories and landmarks, Allan deviations, errors over seeds and correlation times."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from qrsim.core.arrays import NumpyArray
from qrsim.runs.picture import new_figure
from qrsim.studies.slam import example
from qrsim.studies.slam.estimate import Slam
from qrsim.studies.slam.flight import Flight, Floats
from qrsim.studies.slam.intervals import allan, interval
from qrsim.studies.slam.study import ARMS, Study, Sweep

# Of ellipses; in a plan of a trajectory so many of them.
CONFIDENCE, ELLIPSES = 0.95, 30
COLOURS = {"white": "tab:blue", "coloured": "tab:red"}
SHORT = {
    "guess": "initial\nguess",
    "ten": "10 iterations,\ndiagonal",
    "ten_metres": "10 iterations,\nmetres",
    "converged": "converged",
    "plain": "GNSS error\ntaken for white",
    "bias": "GNSS error\nas a state",
}


def draw_run(solved: Slam) -> Figure:
    """Draw the estimated trajectory and landmarks of one run."""
    figure = new_figure(7.0, 6.6)
    axes = figure.subplots()
    known = solved.ranging.true_ned
    _draw_plan(axes, solved.flight, solved.position_ned, solved.landmarks_ned, known, solved.determined)
    every = max(1, len(solved.time) // ELLIPSES)
    _draw_ellipses(axes, solved.position_ned[::every], solved.position_covariance[::every], "tab:orange")
    told = solved.determined
    label = f"{100 * CONFIDENCE:g} % ellipses of the estimate"
    _draw_ellipses(axes, solved.landmarks_ned[told], solved.landmarks_covariance[told], "tab:green", label)
    axes.set_title(f"{solved.flight.name}: graph {solved.graph}", fontsize=10)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    return figure


def ellipse_of(covariance: Floats, confidence: float = CONFIDENCE) -> tuple[Floats, float]:
    """Return a covariance's (2, 2) error ellipse: semi-axes (2,) [m], longer first, and the longer one's bearing [rad].

    Args:
        covariance: (2, 2) of north and east [m^2].
        confidence: probability that a normal error lies in the ellipse.
    """
    values, vectors = np.linalg.eigh(covariance)
    # Chi-square of two degrees of freedom is exponential.
    axes = np.sqrt(-2.0 * np.log1p(-confidence) * np.maximum(values[::-1], 0.0))
    return np.asarray(axes), float(np.arctan2(vectors[1, 1], vectors[0, 1]) % np.pi)


def _draw_ellipses(axes: Axes, places: Floats, covariances: Floats, colour: str, label: str | None = None) -> None:
    """Draw the error ellipses of positions (N, 3) with covariances (N, 3, 3) in plan view, north up."""
    for place, covariance in zip(places, covariances, strict=True):
        half, bearing = ellipse_of(covariance[:2, :2])
        axes.add_patch(
            Ellipse(
                (place[1], place[0]),
                2.0 * half[0],
                2.0 * half[1],
                angle=90.0 - np.degrees(bearing),
                fill=False,
                color=colour,
                alpha=0.6,
                lw=0.7,
                label=label,
            )
        )
        label = None


def draw_trajectories(study: Study, index: int = 0) -> Figure:
    """Draw trajectories and landmarks of a study's ``index``-th seed, in a panel per estimator and GNSS noise."""
    arms = [arm for arm in ARMS[study.graph] if arm not in ("guess", "ten_metres")]
    shown = [(noise, arm) for arm in arms for noise in study.flights if (noise, arm) in study.arms]
    columns = 2 if len(shown) == 4 else len(shown)
    rows = len(shown) // columns
    figure = new_figure(5.2 * columns + 0.4, 4.9 * rows + 0.9)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, (noise, arm) in zip(panels, shown, strict=True):
        found = study.arms[noise, arm]
        _draw_plan(
            axes,
            study.flights[noise][index],
            found.position_ned[index],
            found.landmarks_ned[index],
            study.landmarks_ned[index],
            found.determined[index],
        )
        error = study.trajectory_errors(noise, arm)[index]
        what = f"{noise} GNSS noise, {SHORT[arm]}".replace("\n", " ")
        axes.set_title(f"{what}:\ntrajectory RMSE {error:.2f} m", fontsize=10)
    # A landmark that is not determined is in some panels only.
    named = dict(pair[::-1] for axes in panels for pair in zip(*axes.get_legend_handles_labels(), strict=True))
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=3, fontsize=9)
    figure.suptitle(f"Range-only SLAM, graph '{study.graph}', seed {study.seeds[index]}")
    return figure


def _draw_plan(
    axes: Axes, flight: Flight, position: Floats, landmarks: Floats, truth: Floats | None, determined: NumpyArray
) -> None:
    """Draw a flight and an estimate of it (trajectory, landmarks) in plan view, north up."""
    axes.plot(flight.estimate[:, 1], flight.estimate[:, 0], ".", color="0.75", ms=1.5, label="the sensors' estimate")
    axes.plot(flight.truth[:, 1], flight.truth[:, 0], "-", color="black", lw=0.9, label="true trajectory")
    axes.plot(position[:, 1], position[:, 0], "-", color="tab:orange", lw=0.9, label="SLAM trajectory")
    if truth is not None:
        axes.plot(truth[:, 1], truth[:, 0], "k*", ms=9, label="true landmarks")
        for i in np.flatnonzero(determined):
            axes.plot([truth[i, 1], landmarks[i, 1]], [truth[i, 0], landmarks[i, 0]], "-", color="tab:green", lw=1.0)
    known = landmarks[determined]
    axes.plot(known[:, 1], known[:, 0], "o", color="tab:green", mfc="none", ms=7, label="SLAM landmarks")
    if truth is not None and not np.all(determined):
        lost = truth[~np.asarray(determined)]
        axes.plot(lost[:, 1], lost[:, 0], "x", color="tab:red", ms=10, label="landmark not determined")
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.grid(alpha=0.3)


def draw_allan(study: Study) -> Figure:
    """Draw the Allan deviation of GNSS and of estimation errors, pooled over a study's seeds and both axes."""
    arms = [arm for arm in ARMS[study.graph] if arm != "guess"]
    figure = new_figure(5.2 * (1 + len(arms)) * 0.8, 4.6)
    panels = figure.subplots(1, 1 + len(arms), sharex=True, sharey=True)
    for noise, flown in study.flights.items():
        period = flown[0].fix_period
        windows, deviation = allan([flight.fix_error for flight in flown], period)
        panels[0].loglog(windows, deviation, "o-", ms=3, color=COLOURS[noise], label=noise)
        for axes, arm in zip(panels[1:], arms, strict=True):
            if (noise, arm) in study.arms:
                windows, deviation = allan(study.position_errors(noise, arm, period), period)
                axes.loglog(windows, deviation, "o-", ms=3, color=COLOURS[noise], label=noise)
    slope = np.array([windows[0], windows[-1]])
    highest = max(line.get_ydata()[0] for line in panels[0].get_lines())
    panels[0].loglog(slope, highest * (slope / slope[0]) ** -0.5, "k--", lw=0.8, label="slope -1/2")
    solutions = ("SLAM, " + SHORT[arm].replace("\n", " ") for arm in arms)
    for axes, title in zip(panels, ["GNSS fixes", *solutions], strict=True):
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("averaging window [s]")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=9)
    panels[0].set_ylabel("Allan deviation of the position error [m]")
    count = f"{len(study.seeds)} seed{'s' if len(study.seeds) > 1 else ''}"
    figure.suptitle(f"Position errors of the fixes and of SLAM at fix epochs, graph '{study.graph}', {count}")
    return figure


def draw_errors(study: Study) -> Figure:
    """Draw the error of each seed with every estimator; a line joins the two GNSS noises of a seed."""
    figure = new_figure(10.5, 4.8)
    arms, noises = list(ARMS[study.graph]), list(study.flights)
    measures = {"trajectory": study.trajectory_errors, "landmarks": study.landmark_errors}
    for axes, (name, measure) in zip(figure.subplots(1, 2), measures.items(), strict=True):
        for i, arm in enumerate(arms):
            places = {noise: i + 0.17 * (2 * noises.index(noise) - (len(noises) - 1)) for noise in noises}
            found = {noise: measure(noise, arm) for noise in noises if (noise, arm) in study.arms}
            for values in np.array(list(found.values())).T if len(found) > 1 else []:
                axes.plot([places[noise] for noise in found], values, "-", color="0.8", lw=0.5, zorder=1)
            for noise, values in found.items():
                label = noise if i == 0 else None
                axes.plot(np.full(len(values), places[noise]), values, ".", color=COLOURS[noise], ms=5, label=label)
                if np.isfinite(values).any():
                    axes.plot(places[noise], np.nanmedian(values), "_", color="black", ms=22, mew=2, zorder=3)
        axes.set_xticks(range(len(arms)), [SHORT[arm] for arm in arms], fontsize=8)
        axes.set_yscale("log")
        for formatter in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
            formatter("{x:g}")
        axes.set_title(f"{name}: root mean square error of each seed", fontsize=10)
        axes.set_ylabel("[m]")
        axes.grid(alpha=0.3, axis="y", which="both")
    labels = [f"{noise} GNSS noise" for noise in noises]
    figure.legend(figure.axes[0].get_legend_handles_labels()[0], labels, loc="outside lower center", ncols=2)
    figure.suptitle(f"Graph '{study.graph}', {len(study.seeds)} seeds; bars: medians")
    return figure


def draw_sweep(sweep: Sweep) -> Figure:
    """Draw the trajectory error over the correlation time of GNSS errors of equal variance."""
    figure = new_figure(6.4, 4.6)
    axes = figure.subplots()
    # White noise stands left of the shortest time constant.
    abscissa = np.array([tau if tau != example.WHITE else sweep.time_constants[1] / 4 for tau in sweep.time_constants])
    # Side by side, so that both intervals are seen.
    for values, label, colour, aside in (
        (sweep.plain, "GNSS error taken for white", "tab:red", 0.96),
        (sweep.bias, "GNSS error as a state", "tab:green", 1.04),
    ):
        known = np.isfinite(values).any(axis=1)
        found = [interval(row) for row in values[known]]
        mean = np.array([item["mean"] for item in found])
        low, high = (np.array([item.get(end, item["mean"]) for item in found]) for end in ("low", "high"))
        axes.errorbar(
            aside * abscissa[known],
            mean,
            yerr=[mean - low, high - mean],
            fmt="o-",
            capsize=3,
            color=colour,
            label=label,
        )
    axes.set_xscale("log")
    labels = ["white", *(f"{tau:g}" for tau in sweep.time_constants[1:])]
    axes.set_xticks(abscissa, labels)
    axes.minorticks_off()
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("correlation time of the GNSS error [s]")
    axes.set_ylabel("trajectory error, mean over seeds [m]")
    count = sweep.plain.shape[1]
    seeds = f"{count} seeds, 95 % intervals" if count > 1 else "1 seed"
    axes.set_title(f"GNSS errors of equal variance, graph 'gnss', {seeds}", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend()
    return figure
