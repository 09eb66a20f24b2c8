"""GNSS: a recorded stationary receiver against two hundred simulated ones."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.tree import record_of
from qrsim.files import Content
from qrsim.models.gnss.errors import PRESETS, GaussMarkov2
from qrsim.models.gnss.receivers import OrnsteinUhlenbeckErrors
from qrsim.studies.validate.published import RANGE_ERRORS
from qrsim.studies.validate.receiver import (
    PERIOD,
    Recorded,
    allan_deviations,
    dilution,
    range_autocovariance,
    recorded_receiver,
    sampled_allan_variance,
    simulated_receivers,
    sky_over,
)
from qrsim.studies.validate.report import Check, Finding, Outcome, Part, Picture, Verdict
from qrsim.studies.validate.statistics import CONFIDENCE, mean_and_error, widest_z

RECORDING, ORBITS = "gps_static.csv", "ngs15992_16to17.sp3"
# The rows that the reference implementation's own test takes.
ROWS = 350
START = datetime(2010, 8, 31, 16, 0, 0, tzinfo=UTC)
SEEDS, FEW_SEEDS = 200, 40
BAND = (0.05, 0.95)
AXES = ("north", "east", "down")
# Windows in rows: 0.4 s to half the record.
LENGTHS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 175])
# Windows at which the simulation is held against its closed form.
CHECKED = (1, 16, 64)
PAPER = "gauss_markov_2"
MODELS: dict[str, tuple[object, str]] = {
    PAPER: (GaussMarkov2(), "second-order Gauss-Markov, 0.589 m, 40.1 s and 4 s: the model behind the paper's figures"),
    "ou": (OrnsteinUhlenbeckErrors(), "Ornstein-Uhlenbeck, 12.35 m, 2000 s: the reference implementation's other one"),
    "consumer": (
        record_of(
            GaussMarkov2, *(PRESETS["consumer"][name] for name in ("std", "time_constant", "drive_time_constant"))
        ),
        "second-order, 4.95 m, 1100 s and 100 s: this project's preset from error budgets",
    ),
}


class Simulated(NamedTuple):
    """Receivers under one error model.

    Attributes:
        positions: (T, seeds, 3) errors [m].
        deviations: (K, seeds, 3) Allan deviations [m].
        band: (2, K, 3) of them, at BAND.
        expected: (K, 3) exact Allan variances [m^2].
    """

    positions: Floats
    deviations: Floats
    band: Floats
    expected: Floats


def simulate(name: str, orbits: Path, record: Recorded, seeds: int) -> tuple[Simulated, tuple[int, int]]:
    """Simulate receivers under error model ``name``; return them, and their (least, most) satellites used."""
    errors = MODELS[name][0]
    every = round(record.period / PERIOD)
    sky = sky_over(orbits, record.site, START, ROWS * record.period, errors)
    positions, used = simulated_receivers(sky, ROWS, every, seeds)
    deviations = allan_deviations(positions, record.period, LENGTHS)
    autocovariance = range_autocovariance(RANGE_ERRORS[name], record.period, 2 * int(LENGTHS[-1]))
    ranges = [sampled_allan_variance(autocovariance, int(length)) for length in LENGTHS]
    band = np.quantile(deviations, BAND, axis=1)
    return Simulated(positions, deviations, band, np.outer(ranges, dilution(sky))), used


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Compare a recorded GNSS receiver with simulated ones, in full or few; return the outcome for the report."""
    record = recorded_receiver(paths[RECORDING])
    seeds = SEEDS if full else FEW_SEEDS
    runs, used = {}, (0, 0)
    for name in MODELS:
        runs[name], used = simulate(name, paths[ORBITS], record, seeds)
    chosen = record.position_ned[:ROWS]
    deviation = allan_deviations(chosen, record.period, LENGTHS)
    inside = {name: (run.band[0] <= deviation) & (deviation <= run.band[1]) for name, run in runs.items()}
    numbers = _results(record, deviation, runs, inside, seeds, used)
    first, last = record.satellites
    return Outcome(
        method=f"A receiver stood still on the ground for {record.period * len(record.position_ned):.0f} s on 8 March"
        f" 2011 (2.5 Hz, {first} to {last} satellites); as in the reference implementation's own test, rows 1 to {ROWS}"
        f" are used, {record.period * ROWS:.0f} s. Each of {seeds} simulated receivers stands at the same place for as"
        f" long, with range errors of its own. The dates differ: the only orbit file is of 31 August 2010, so its"
        f" satellites at 16:00 UTC stand for those of the recording ({_format_range(used)} above 10°). This gives a"
        " typical geometry, not that of the day; the bands are off by the ratio of the two dilutions of precision."
        " Neighbouring averaging times share their data, so that a curve leaves a band over several of them at once.",
        reading=_summarise(numbers),
        checks=_allan_checks(runs, seeds),
        findings=_model_findings(numbers),
        pictures=[_draw_walk(record, runs[PAPER]), _draw_allan(record, deviation, runs, seeds)],
        numbers=numbers,
    )


def _format_range(range_of: tuple[int, int]) -> str:
    """Format a range (least, most) of counts as text."""
    first, last = range_of
    return f"{first}" if first == last else f"{first} to {last}"


def _allan_checks(runs: dict[str, Simulated], seeds: int) -> list[Check]:
    """Return the checks of simulated receivers' Allan variances against their closed forms."""
    count = len(runs) * len(CHECKED)
    z, checks = widest_z(count), []
    for name, run in runs.items():
        for length in CHECKED:
            at = int(np.flatnonzero(length == LENGTHS)[0])
            # Of one seed: the mean over the axes, whose errors are not independent.
            ratios = np.mean(np.square(run.deviations[at]) / run.expected[at], axis=1)
            mean, error = mean_and_error(ratios)
            checks.append(
                Check(
                    f"{name}: Allan variance over {0.4 * length:g} s, divided by its closed form",
                    float(mean),
                    1.0,
                    z * float(error),
                    "",
                    f"exact from the published autocovariance and the geometry; {z:.1f} standard errors of the mean of"
                    f" {seeds} seeds, {100 * CONFIDENCE:g} % for all {count} together",
                )
            )
    return checks


def _results(
    record: Recorded, deviation: Floats, runs: dict[str, Simulated], inside: Content, seeds: int, used: tuple[int, int]
) -> Content:
    """Return the numbers of the comparison of recorded and simulated receivers as a dict for JSON."""
    windows = [round(float(length) * record.period, 6) for length in LENGTHS]
    chosen = record.position_ned[:ROWS]
    numbers: Content = {
        "rows": ROWS,
        "rows_in_file": len(record.position_ned),
        "seeds": seeds,
        "satellites_recorded": list(record.satellites),
        "satellites_simulated": list(used),
        "windows_s": windows,
        "recorded": {
            "allan_deviation_m": dict(zip(AXES, deviation.T.tolist(), strict=True)),
            "wander_std_m": dict(zip(AXES, np.std(chosen, axis=0).tolist(), strict=True)),
            "wander_range_m": dict(zip(AXES, np.ptp(chosen, axis=0).tolist(), strict=True)),
        },
    }
    for name, run in runs.items():
        spread = np.std(run.positions, axis=0)
        numbers[name] = {
            "band_low_m": dict(zip(AXES, run.band[0].T.tolist(), strict=True)),
            "band_high_m": dict(zip(AXES, run.band[1].T.tolist(), strict=True)),
            "closed_form_m": dict(zip(AXES, np.sqrt(run.expected).T.tolist(), strict=True)),
            "inside": {
                axis: [window for window, good in zip(windows, inside[name][:, i], strict=True) if good]
                for i, axis in enumerate(AXES)
            },
            "inside_share": float(np.mean(inside[name])),
            "wander_std_band_m": {axis: np.quantile(spread[:, i], BAND).tolist() for i, axis in enumerate(AXES)},
            "recorded_over_median": {
                axis: (deviation[:, i] / np.median(run.deviations[:, :, i], axis=1)).tolist()
                for i, axis in enumerate(AXES)
            },
        }
    return numbers


def _describe_outside(numbers: Content, name: str) -> str:
    """Return as text, by axis, the windows at which the recording leaves the band of error model ``name``."""
    words = []
    for axis in AXES:
        good = numbers[name]["inside"][axis]
        recorded = numbers["recorded"]["allan_deviation_m"][axis]
        high = numbers[name]["band_high_m"][axis]
        above = [w for w, r, h in zip(numbers["windows_s"], recorded, high, strict=True) if r > h]
        below = [w for w in numbers["windows_s"] if w not in good and w not in above]
        parts = [
            f"{_window_spans(numbers['windows_s'], part)} {word}"
            for part, word in ((below, "below"), (above, "above"))
            if part
        ]
        words.append(f"{axis} {', '.join(parts) or 'nowhere'}")
    return "; ".join(words)


def _window_spans(windows: list[float], chosen: list[float]) -> str:
    """Return the chosen windows [s] as text, neighbouring ones as spans such as '0.4-3.2 s'."""
    spans: list[list[float]] = []
    for window in chosen:
        if spans and windows.index(window) == windows.index(spans[-1][-1]) + 1:
            spans[-1].append(window)
        else:
            spans.append([window])
    return ", ".join(f"{span[0]:g}-{span[-1]:g} s" if len(span) > 1 else f"{span[0]:g} s" for span in spans)


def _model_findings(numbers: Content) -> list[Finding]:
    """Return the findings on GNSS error models: how well the recording lies within their simulated bands."""
    found = []
    for name, (_, words) in MODELS.items():
        share = numbers[name]["inside_share"]
        verdict: Verdict = "fits" if share >= 0.9 else "fits in part" if share >= 0.5 else "does not fit"
        found.append(
            Finding(
                f"Allan deviation under {name}",
                f"the recording is within the 90 % band at {100 * share:.0f} % of windows and axes",
                verdict,
                f"{words[0].upper()}{words[1:]}. Outside: {_describe_outside(numbers, name)}.",
            )
        )
    wander, band = numbers["recorded"]["wander_std_m"], numbers[PAPER]["wander_std_band_m"]
    good = [axis for axis in AXES if band[axis][0] <= wander[axis] <= band[axis][1]]
    return [
        *found,
        Finding(
            f"how far the position wanders in {0.4 * ROWS:.0f} s, under {PAPER}",
            "; ".join(
                f"{axis} {wander[axis]:.2f} m, band {band[axis][0]:.2f} to {band[axis][1]:.2f} m" for axis in AXES
            ),
            "fits" if len(good) == 3 else "fits in part" if good else "does not fit",
            f"Standard deviation about its own mean; within the 90 % band: {', '.join(good) or 'none'}.",
        ),
        Finding(
            "resolution of the recording",
            "1e-7°, which is 11 mm north and 7 mm east; 1 mm in height",
            "to note",
            "Rounding alone gives 3 mm north and 2 mm east at the shortest window, so that the curve cannot be lower.",
        ),
    ]


def _summarise(numbers: Content) -> str:
    """Return one sentence that concludes the comparison of GNSS error models with the recording."""
    share = numbers[PAPER]["inside_share"]
    return (
        "The simulation has the Allan deviation that its model should have; the recording is within the paper's model's"
        f" 90 % band at {100 * share:.0f} % of windows and axes, where 90 % would be expected of a model that is true."
    )


def _draw_walk(record: Recorded, run: Simulated) -> Picture:
    """Draw the position of a recorded and of a simulated stationary receiver as it wanders."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import RECORDED, SIMULATED, picture

    figure = new_figure(11.0, 4.6)
    plan, height = figure.subplots(1, 2, width_ratios=(2, 3))
    chosen = record.position_ned[:ROWS] - record.position_ned[:ROWS].mean(axis=0)
    time = record.period * np.arange(ROWS)
    centred = run.positions - run.positions.mean(axis=0)
    for seed, style in enumerate(("-", "--", ":")):
        colour = ("tab:red", "tab:orange", "tab:pink")[seed]
        plan.plot(
            centred[:, seed, 1], centred[:, seed, 0], style, color=colour, lw=0.9, label=f"simulated, seed {seed}"
        )
        height.plot(time, -centred[:, seed, 2], style, color=colour, lw=0.9)
    plan.plot(chosen[:, 1], chosen[:, 0], color=RECORDED, lw=1.3, label="recorded")
    height.plot(time, -chosen[:, 2], color=RECORDED, lw=1.3)
    low, high = np.quantile(-centred[:, :, 2], BAND, axis=1)
    height.fill_between(time, low, high, color=SIMULATED, alpha=0.12, lw=0, label="90 % of all seeds")
    plan.set(xlabel="east [m]", ylabel="north [m]", aspect="equal", title="plan view")
    height.set(xlabel="time [s]", ylabel="up [m]", title="height")
    plan.legend(fontsize=8)
    height.legend(fontsize=8)
    for axes in (plan, height):
        axes.grid(alpha=0.3)
    return picture(
        figure,
        f"The random walk of a receiver that stands still: recorded, and three simulated ones under {PAPER}, each about"
        " its own mean.",
    )


def _draw_allan(record: Recorded, deviation: Floats, runs: dict[str, Simulated], seeds: int) -> Picture:
    """Draw the Allan deviation of the recorded receiver over the bands of simulated error models."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import RECORDED, picture

    figure = new_figure(11.0, 4.6)
    panels = figure.subplots(1, 3, sharey=True)
    windows = LENGTHS * record.period
    every = allan_deviations(record.position_ned, record.period, LENGTHS)
    for i, (panel, axis) in enumerate(zip(panels, AXES, strict=True)):
        for (name, run), colour in zip(runs.items(), ("tab:red", "tab:green", "tab:blue"), strict=True):
            low, high = run.band[:, :, i]
            panel.fill_between(
                windows, low, high, color=colour, alpha=0.2, lw=0, label=f"{name}: 90 % of {seeds} seeds"
            )
            panel.plot(windows, np.sqrt(run.expected[:, i]), color=colour, lw=0.9, ls="--")
        panel.plot(windows, deviation[:, i], "o-", color=RECORDED, ms=3, lw=1.2, label=f"recorded, rows 1 to {ROWS}")
        panel.plot(windows, every[:, i], ":", color=RECORDED, lw=1.0, label="recorded, all rows")
        panel.set(xscale="log", yscale="log", xlabel="averaging time [s]", title=axis)
        panel.grid(alpha=0.3, which="both")
    panels[0].set_ylabel("overlapping Allan deviation [m]")
    panels[0].legend(fontsize=7.5, loc="upper left")
    return picture(
        figure,
        "How much averages of the position over neighbouring windows differ. Bands: simulated receivers; dashed: the"
        " closed form of each model; black: the recording.",
    )


PART = Part(
    "gnss",
    "GNSS",
    "the GNSS figures: random walk and Allan deviation of a receiver that stands still, recorded and simulated",
    (RECORDING, ORBITS),
    _run_part,
)
