"""The translation match: velocity and position of the outdoor flight, and the limits of that comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.files import Content
from qrsim.studies.validate.outdoor import (
    AXES,
    RECORDING,
    Outdoor,
    fit_wind,
    fly_in_wind,
    fly_pieces,
    fly_recorded,
    specific_force_errors,
    velocity_match,
)
from qrsim.studies.validate.recorded import DT, Match
from qrsim.studies.validate.report import Check, Finding, Outcome, Part, Picture, reference_check, share_verdict

# docs/explanation/paper.md: held against recordings.
REFERENCE_VELOCITY = {"north": "3.736", "east": "2.389", "down": "1.547"}
REFERENCE_FORCE = {
    "ours": {"x": "0.63", "y": "0.36", "z": "3.05"},
    "reference": {"x": "0.76", "y": "0.47", "z": "4.33"},
}
HORIZONS_S = (1.0, 2.0, 5.0, 10.0, 20.0)
PIECE_SPACING = 250


class Windy(NamedTuple):
    """Simulations of the whole flight in winds.

    Attributes:
        wind: (2,) fitted to all rows [m/s], north and east components of the moving air.
        wind_first_half: (2,) fitted to the first half.
        velocity, position: by the name of the wind, (T, 3) each.
    """

    wind: Floats
    wind_first_half: Floats
    velocity: dict[str, Floats]
    position: dict[str, Floats]


def fly_winds(flight: Outdoor) -> Windy:
    """Simulate the outdoor flight in calm and in two fitted constant winds (by all rows, by the first half)."""
    steps = len(flight.commands)

    def fly(winds: Floats) -> tuple[Floats, Floats]:
        """Return velocities and positions (T, W, 3) of the flight in W constant winds (W, 3)."""
        count = len(winds)
        commands = np.broadcast_to(flight.commands[:, :, None], (steps, 5, count))
        return fly_in_wind(np.broadcast_to(flight.start, (count, 13)), commands, winds)

    basis, _ = fly(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    still = basis[:, 0]
    response = np.moveaxis(basis[:, 1:] - still[:, None], 1, 2)
    recorded = flight.recorded[:, 6:9]
    half = steps // 2
    wind, first = (fit_wind(still[:to], response[:to], recorded[:to]) for to in (steps, half))
    names = ("still air", "fitted wind", "wind of the first half")
    velocity, position = fly(np.array([[0.0, 0.0, 0.0], [*wind, 0.0], [*first, 0.0]]))
    return Windy(
        wind,
        first,
        {name: velocity[:, i] for i, name in enumerate(names)},
        {name: position[:, i] for i, name in enumerate(names)},
    )


def horizons(flight: Outdoor, wind: Floats) -> dict[str, dict[str, float]]:
    """Return case of wind -> horizon ("2_s") -> rms error [m/s] of horizontal velocity after open-loop flight."""
    steps = round(max(HORIZONS_S) / DT)
    found: dict[str, dict[str, float]] = {}
    for name, wind_ned in (("still_air", np.zeros(3)), ("fitted_wind", np.array([*wind, 0.0]))):
        simulated, recorded = fly_pieces(flight, wind_ned, steps, PIECE_SPACING)
        found[name] = {
            f"{horizon:g}_s": _rms((simulated - recorded)[round(horizon / DT) - 1, :, :2]) for horizon in HORIZONS_S
        }
    start = flight.before[np.arange(0, len(flight.commands) - steps, PIECE_SPACING), 6:8]
    found["no_change"] = {
        f"{horizon:g}_s": _rms(recorded[round(horizon / DT) - 1, :, :2] - start) for horizon in HORIZONS_S
    }
    return found


def _rms(difference: Floats) -> float:
    """Return the root mean square length of vectors (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(np.square(difference), axis=-1))))


def consistency(flight: Outdoor) -> dict[str, float]:
    """Compare the recording's velocity with the derivative of its position; return measures by name, with units."""
    position, velocity = flight.recorded[:, :3], flight.recorded[:, 6:9]
    derivative = np.gradient(position, DT, axis=0)
    result = {
        f"rms_{axis}_m_s": float(np.sqrt(np.mean((derivative - velocity)[:, i] ** 2)))
        for i, axis in enumerate(AXES[:2])
    }
    result["correlation_of_third_column"] = float(np.corrcoef(derivative[:, 2], velocity[:, 2])[0, 1])
    result["mean_velocity_down_m_s"] = float(np.mean(velocity[:, 2]))
    result["climb_by_velocity_m"] = -float(np.sum(velocity[:, 2])) * DT
    result["climb_by_position_m"] = float(position[-1, 2] - position[0, 2])
    return result


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Compare the outdoor flight, recorded at ``paths``, with the simulation; return the outcome for the report."""
    flight = fly_recorded(paths[RECORDING])
    match, force = velocity_match(flight), specific_force_errors(flight)
    winds, own = fly_winds(flight), consistency(flight)
    numbers = _results(flight, match, force, winds) | {"record": own, "restarted": horizons(flight, winds.wind)}
    return Outcome(
        method="A Pelican flew outdoors by stick commands, in unmeasured wind. The model gets the commands of"
        " the first 160 s and the first row's attitude; velocity is then one integral of what it computes, position a"
        " second. The record's commands lead its motion by 0.5 s, which the comparison takes out. The horizontal wind"
        " is fitted by linear least squares, exact because the model is linear in the wind.",
        reading=_summarise(numbers),
        checks=_reference_checks(match, force),
        findings=_flight_findings(numbers, own),
        pictures=_draw_match(flight, match, winds, numbers),
        numbers=numbers,
    )


def _reference_checks(match: Match, force: dict[str, dict[str, float]]) -> list[Check]:
    """Return the checks of simulation errors against the reference implementation's scores."""
    errors = match.mean_square()
    checks = [
        reference_check(f"mean squared error of the velocity {axis}", errors[axis], REFERENCE_VELOCITY[axis], "(m/s)²")
        for axis in AXES
    ]
    forms = {"ours": "specific force", "reference": "specific force, form of the reference implementation"}
    return checks + [
        reference_check(f"mean squared error of the {forms[form]}, {axis}", force[form][axis], published, "(m/s²)²")
        for form, axes in REFERENCE_FORCE.items()
        for axis, published in axes.items()
    ]


def _results(flight: Outdoor, match: Match, force: dict[str, dict[str, float]], winds: Windy) -> Content:
    """Return the numbers of the comparison (errors of velocity, force and path) as a dict for JSON."""
    half = len(match.time) // 2
    recorded = Match(match.time, match.recorded, winds.velocity["fitted wind"], AXES)
    second = {
        name: Match(match.time[half:], match.recorded[half:], winds.velocity[wind][half:], AXES)
        for name, wind in (("still_air", "still air"), ("wind_of_first_half", "wind of the first half"))
    }
    drift = {
        name.replace(" ", "_"): np.linalg.norm(_from_start(flight, position)[:, :2], axis=1)
        for name, position in winds.position.items()
    }
    return {
        "velocity_mean_squared_error": match.mean_square(),
        "velocity_explained_share": match.explained(),
        "velocity_record_variance": dict(zip(AXES, np.var(match.recorded, axis=0).tolist(), strict=True)),
        "specific_force_mean_squared_error": force,
        "fitted_wind": {
            "north_m_s": float(winds.wind[0]),
            "east_m_s": float(winds.wind[1]),
            "speed_m_s": float(np.hypot(*winds.wind)),
            "from_deg": math.degrees(math.atan2(-winds.wind[1], -winds.wind[0])) % 360.0,
            "velocity_mean_squared_error": recorded.mean_square(),
            "velocity_explained_share": recorded.explained(),
        },
        "second_half": {name: part.mean_square() | {"explained": part.explained()} for name, part in second.items()},
        "wind_of_first_half_m_s": {"north": float(winds.wind_first_half[0]), "east": float(winds.wind_first_half[1])},
        "horizontal_position_error_m": {
            name: {f"after_{seconds}_s": float(error[round(seconds / DT) - 1]) for seconds in (10, 40, 80, 160)}
            | {"largest": float(np.max(error))}
            for name, error in drift.items()
        },
    }


def _from_start(flight: Outdoor, position: Floats) -> Floats:
    """Return simulated minus recorded position (T, 3) [m], each counted from its first row."""
    return np.asarray((position - flight.start[:3]) - (flight.recorded[:, :3] - flight.before[0, :3]))


def _summarise(numbers: Content) -> str:
    """Return the text that concludes the comparison of the translation model with the recorded flight."""
    share, windy = numbers["velocity_explained_share"], numbers["fitted_wind"]["velocity_explained_share"]
    lost = numbers["horizontal_position_error_m"]["still_air"]["after_160_s"]
    return (
        "The reference scores are reproduced, and they are no proof of a good model: in still air the velocity explains"
        f" {100 * share['north']:.0f} % (north) and {100 * share['east']:.0f} % (east) of the record, with a fitted"
        f" constant wind {100 * windy['north']:.0f} % and {100 * windy['east']:.0f} %, and the position is"
        f" {lost:.0f} m away after 160 s in still air."
    )


def _flight_findings(numbers: Content, own: dict[str, float]) -> list[Finding]:
    """Return the findings on velocity and position of the outdoor flight, with and without wind."""
    share, fitted, drift = numbers["velocity_explained_share"], numbers["fitted_wind"], numbers["restarted"]
    windy, lost = fitted["velocity_explained_share"], numbers["horizontal_position_error_m"]
    second = numbers["second_half"]["wind_of_first_half"]["explained"]
    still_second = numbers["second_half"]["still_air"]["explained"]
    worst = min(share["north"], share["east"])
    return [
        Finding(
            "horizontal velocity in still air, 160 s",
            f"{100 * share['north']:.0f} % north, {100 * share['east']:.0f} % east of the variance explained",
            share_verdict(worst),
            "A share below 0 is worse than a constant at the record's mean would be.",
        ),
        Finding(
            "horizontal velocity in a fitted constant wind",
            f"{100 * windy['north']:.0f} % north, {100 * windy['east']:.0f} % east; the fit is"
            f" {fitted['speed_m_s']:.2f} m/s from {fitted['from_deg']:.0f}°",
            share_verdict(min(windy["north"], windy["east"])),
            "Fitted and judged on the same rows, so this is the best a constant wind can do; it also takes up any"
            " constant error of attitude or thrust, and need not be wind.",
        ),
        Finding(
            "the same, fitted to the first 80 s and judged on the second",
            f"{100 * second['north']:.0f} % north, {100 * second['east']:.0f} % east; in still air"
            f" {100 * still_second['north']:.0f} % and {100 * still_second['east']:.0f} %",
            share_verdict(min(second["north"], second["east"])),
            "Rows that the fit has not seen.",
        ),
        Finding(
            "position, integrated twice over 160 s",
            f"{lost['still_air']['largest']:.0f} m away at most in still air, {lost['fitted_wind']['largest']:.0f} m in"
            " the fitted wind",
            "does not fit",
            "This is the drift of a double integral: an error of 0.1 m/s in velocity alone is 16 m after 160 s. That"
            " the run in the fitted wind ends near the record is the fit's doing, which leaves no mean error.",
        ),
        Finding(
            "horizontal velocity, restarted from the record every 5 s",
            f"rms error after 1, 5, 20 s: {_format_errors(drift['fitted_wind'])} m/s in the fitted wind;"
            f" {_format_errors(drift['no_change'])} m/s for a constant velocity",
            share_verdict(1.0 - (drift["fitted_wind"]["5_s"] / drift["no_change"]["5_s"]) ** 2),
            "The accuracy of the model without accumulated errors; the verdict is on the share of the squared"
            " changes within 5 s that it explains. The wind comes from the same flight.",
        ),
        Finding(
            "vertical motion of the record itself",
            f"its velocity adds up to a climb of {own['climb_by_velocity_m']:.0f} m, its position to"
            f" {abs(own['climb_by_position_m']):.0f} m; correlation of velocity down and the derivative of the third"
            f" position column {own['correlation_of_third_column']:.2f}",
            "to note",
            "Velocity and position contradict each other, so the vertical score says little; the third position column"
            " moves as a height (positive up), and is drawn as one.",
        ),
    ]


def _format_errors(errors: dict[str, float]) -> str:
    """Format velocity errors after 1, 5 and 20 s as text."""
    return ", ".join(f"{errors[name]:.2f}" for name in ("1_s", "5_s", "20_s"))


def _draw_match(flight: Outdoor, match: Match, winds: Windy, numbers: Content) -> list[Picture]:
    """Return the pictures of recorded against simulated flight, and of the error over the horizon."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import OTHER, RECORDED, SIMULATED, picture

    colours = {"still air": SIMULATED, "fitted wind": OTHER}
    recorded = flight.recorded[:, :3] - flight.before[0, :3]
    recorded[:, 2] *= -1.0
    figure = new_figure(11.0, 11.0)
    panels = figure.subplots(6, 1, sharex=True)
    for i, axis in enumerate(AXES):
        for panel, truth, runs, start, unit in (
            (panels[i], match.recorded, winds.velocity, np.zeros(3), "velocity\n{} [m/s]"),
            (panels[3 + i], recorded, winds.position, flight.start[:3], "position\n{} [m]"),
        ):
            panel.plot(match.time, truth[:, i], color=RECORDED, lw=1.2, label="recorded")
            for name, colour in colours.items():
                panel.plot(match.time, runs[name][:, i] - start[i], color=colour, lw=0.9, label=f"simulated, {name}")
            panel.set_ylabel(unit.format(axis))
            panel.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=9)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(float(match.time[0]), float(match.time[-1]))
    figure.align_ylabels()
    traces = picture(
        figure,
        "Velocity and position of the outdoor flight, from recorded commands alone: nothing pulls the simulation back,"
        " so velocity shows the error of one integration and position that of two. The record's third position column"
        " is drawn as a height.",
    )
    return [traces, _draw_horizons(numbers["restarted"])]


def _draw_horizons(restarted: dict[str, dict[str, float]]) -> Picture:
    """Draw the rms velocity error over the time since the simulation was restarted from the recording."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import OTHER, SIMULATED, picture

    figure = new_figure(7.0, 3.6)
    axes = figure.subplots()
    styles = {"no_change": ("gray", "velocity stays constant"), "still_air": (SIMULATED, "model, still air")}
    styles["fitted_wind"] = (OTHER, "model, fitted wind")
    for name, (colour, label) in styles.items():
        axes.plot(HORIZONS_S, list(restarted[name].values()), "o-", color=colour, label=label)
    axes.set(xlabel="time since the last restart [s]", ylabel="rms error of the\nhorizontal velocity [m/s]")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9, loc="lower right")
    return picture(figure, "Error of the horizontal velocity where the model starts again from the record every 5 s.")


PART = Part(
    "translation",
    "Translation",
    "the translation figure: recorded and simulated velocity and position of an outdoor flight",
    (RECORDING,),
    _run_part,
)
