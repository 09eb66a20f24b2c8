"""Turbulence: spectra and traces against the closed forms of MIL-F-8785C and against JSBSim."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.files import Content
from qrsim.studies.validate.hover_gusts import (
    CASE,
    EVERY,
    FROM_DEG,
    SPEED,
    in_wind_axes,
    jsbsim_gusts,
    mean_wind,
    our_gusts,
    statistics,
)
from qrsim.studies.validate.jsbsim_gusts import INSTALL, TYPES, is_installed, jsbsim_series, jsbsim_theory
from qrsim.studies.validate.report import Check, Finding, Outcome, Part, Picture
from qrsim.studies.validate.spectra import (
    BANDS,
    CASES,
    COMPONENTS,
    DT,
    LOWEST_OMEGA,
    Case,
    closed_form,
    compare,
    our_series,
    sampled_closed_form,
    scales,
    welch,
)
from qrsim.studies.validate.statistics import CONFIDENCE, p_values, widest_z

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEED = 19801105
STEPS, FEW_STEPS = 131_072, 65_536
TRACE_S, VEHICLES, FEW_VEHICLES = 200.0, 512, 64
JSBSIM_WINDOWS, FEW_WINDOWS = 40, 4
MODELS = {"dryden_first_order": "the paper's first-order gusts", "dryden": "the full Dryden gusts"}
SPECTRA_DB = 0.8
COMPONENTS_IN_WORDS = dict(
    zip(COMPONENTS, ("u (along)", "v (across)", "w (down)", "q (angular, pitch)", "r (angular, yaw)"), strict=True)
)


def study_case(
    case: Case, steps: int, seed: int, sources: Sequence[str]
) -> tuple[Content, dict[str, Floats], dict[str, Floats]]:
    """Simulate gusts of each source ('ours', or a turbulence of JSBSim); return statistics, series, and levels [dB].

    Raises:
        RunError: no jsbsim where it is asked for.
    """
    results: Content = dict(case._asdict())
    series, levels = {}, {}
    for name in sources:
        ours = name == "ours"
        series[name] = our_series(case, steps, seed) if ours else jsbsim_series(case, TYPES[name], steps, seed)
        theory = partial(sampled_closed_form, case) if ours else partial(jsbsim_theory, case, TYPES[name])
        results[name], levels[name] = compare(series[name], theory, case)
    return results, series, levels


def spectra_figure(case: Case, sources: dict[str, Floats], levels: dict[str, Floats]) -> Figure:
    """Draw the spectra of u, v, w of one case, and below them each source's level over the closed form [dB]."""
    from qrsim.runs.picture import new_figure

    figure = new_figure(11.0, 6.0)
    axes = figure.subplots(2, 3, sharex=True, sharey="row", height_ratios=(3, 2))
    labels = {"ours": "qrsim, dryden", "jsbsim_type_3": "JSBSim type 3", "jsbsim_type_4": "JSBSim type 4"}
    centres = LOWEST_OMEGA * 10.0 ** (0.1 * (np.arange(BANDS) + 0.5))
    for i, name in enumerate(COMPONENTS[:3]):
        top, bottom = axes[0][i], axes[1][i]
        for source, series in sources.items():
            omega, estimate = welch(series)
            inside = (omega >= LOWEST_OMEGA) & (omega * DT <= 1.0)
            top.loglog(omega[inside], estimate[i, inside] / math.pi, linewidth=0.8, label=labels[source])
            bottom.semilogx(centres, levels[source][i], marker=".", linewidth=0.8)
        fine = np.geomspace(LOWEST_OMEGA, 1.0 / DT, 200)
        top.loglog(fine, closed_form(case, fine)[i] / math.pi, "k--", linewidth=1.0, label="MIL-F-8785C")
        bottom.axhline(0.0, color="k", linestyle="--", linewidth=1.0)
        bottom.set_ylim(-2.5, 2.5)
        top.set_title(f"{name}, {case.height:g} m above ground, {case.airspeed:g} m/s")
        bottom.set_xlabel("angular frequency [rad/s]")
    axes[0][0].set_ylabel("one-sided density [(m/s)$^2$/(rad/s)]")
    axes[1][0].set_ylabel("over the closed form [dB]")
    axes[0][0].legend()
    return figure


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Compare simulated gusts with closed forms and JSBSim, in full or quickly; return the outcome for the report."""
    from qrsim.studies.validate.pictures import picture

    oracle = is_installed()
    steps = STEPS if full else FEW_STEPS
    case = CASES["low"]
    spectra, series, levels = study_case(case, steps, SEED, ("ours", *TYPES) if oracle else ("ours",))
    vehicles = VEHICLES if full else FEW_VEHICLES
    gusts = {name: our_gusts(name, TRACE_S, vehicles, SEED + number) for number, name in enumerate(MODELS)}
    hover: dict[str, object] = {name: statistics(name, found) for name, found in gusts.items()}
    traces = {MODELS[name]: found[:, 0] for name, found in gusts.items()}
    if oracle:
        windows = JSBSIM_WINDOWS if full else FEW_WINDOWS
        flown = {name: jsbsim_gusts(kind, windows * TRACE_S, SEED) for name, kind in TYPES.items()}
        hover |= {name: _jsbsim_variances(found, windows) for name, found in flown.items()}
        traces["JSBSim type 4"] = flown["jsbsim_type_4"][: len(gusts["dryden"])]
        for name, kind in TYPES.items():
            spectra[name]["exact_db_from_closed_form"] = _spectral_distance(case, kind)
    numbers = {
        "spectra": {"time_step_s": DT, "steps": steps, **spectra},
        "hover": {
            "height_m": CASE.height,
            "airspeed_m_s": CASE.airspeed,
            "mean_wind_ned_m_s": mean_wind().tolist(),
            "sigma_m_s": scales(CASE)[1].tolist(),
            "time_constant_s": (scales(CASE)[0] / CASE.airspeed).tolist(),
            "seconds": TRACE_S,
            "vehicles": vehicles,
            **hover,
        },
    }
    caption = (
        f"Spectra {case.height:g} m above the ground at {case.airspeed:g} m/s: gusts along (u), across (v) and down (w)"
        " the wind; below them each source's level over the closed form in third octaves."
    )
    return Outcome(
        method="Two things are held against the closed forms of MIL-F-8785C, low altitude. First spectra and variances"
        f" of {DT * steps:.0f} s of gusts at a speed at which a record has many time constants. Second the published"
        f" case: mean wind of 2 ft/s ({SPEED:.2f} m/s) from {FROM_DEG:g}°, {vehicles} vehicles that hover at 20 ft for"
        f" {TRACE_S:g} s (the paper does not say its height; at 20 ft the mean wind is its named value)."
        + (" JSBSim, an independent flight simulator, generates the same gusts by its own code." if oracle else ""),
        reading=_summarise(numbers, oracle),
        checks=[*_spectra_checks(spectra["ours"], steps), *_hover_checks(hover, vehicles), *_mean_checks()],
        findings=_gust_findings(numbers, oracle),
        pictures=[_draw_traces(traces), picture(spectra_figure(case, series, levels), caption)],
        numbers=numbers,
        skipped=[] if oracle else [f"JSBSim is not installed, so its spectra and traces are left out; {INSTALL}"],
    )


def _jsbsim_variances(gusts_ned: Floats, windows: int) -> Content:
    """Return JSBSim's gust variances over the closed form, and their spread between windows of 200 s."""
    scaled = np.square(in_wind_axes(gusts_ned) / scales(CASE)[1])
    by_window = scaled.reshape(windows, -1, 3).mean(axis=1)
    return {
        axis: {
            "variance_over_closed_form": float(np.mean(by_window[:, i])),
            "std_of_windows": float(np.std(by_window[:, i])),
        }
        for i, axis in enumerate(("along", "across", "down"))
    }


def _spectral_distance(case: Case, kind: int) -> float:
    """Return the largest difference [dB] of JSBSim's spectra of u, v and w from the closed forms."""
    omega = LOWEST_OMEGA * 10.0 ** (0.1 * (np.arange(BANDS) + 0.5))
    ratio = jsbsim_theory(case, kind, omega)[:3] / closed_form(case, omega)[:3]
    return float(np.max(np.abs(10.0 * np.log10(ratio))))


def _spectra_checks(ours: Content, steps: int) -> list[Check]:
    """Return the checks of variances and spectral levels of the gusts that a moving aircraft meets."""
    z = widest_z(len(COMPONENTS))
    # The bands' levels are means over Welch's segments, whose number grows with the record.
    bound = SPECTRA_DB * math.sqrt(max(1.0, STEPS / steps))
    checks = [
        Check(
            f"variance of {COMPONENTS_IN_WORDS[name]} over {DT * steps:.0f} s: distance from its closed form",
            ours[name]["variance"]["z"],
            0.0,
            z,
            "standard errors",
            f"the error is exact, from the spectrum; {100 * CONFIDENCE:g} % for all {len(COMPONENTS)} together",
        )
        for name in COMPONENTS
    ]
    return checks + [
        Check(
            f"spectrum of {COMPONENTS_IN_WORDS[name]}: rms distance from its closed form over {BANDS} third octaves",
            ours[name]["rms_db_from_own_theory"],
            0.0,
            bound,
            "dB",
            "the lowest bands hold one or two bins of a periodogram and are uncertain by up to 0.7 dB each, all"
            " together by 0.3 dB" + (", more in this short record" if steps < STEPS else ""),
        )
        for name in COMPONENTS
    ]


def _hover_checks(hover: Content, vehicles: int) -> list[Check]:
    """Return the checks of variances and autocovariances of the gusts that hovering vehicles meet."""
    count = sum(len(list(p_values(hover[name]))) for name in MODELS)
    z = widest_z(count)
    return [
        Check(
            f"{words}, hovering: {what.replace('_', ' ')} {axis}, in units of the variance",
            found["value"],
            found["expected"],
            z * found["standard_error"],
            "",
            f"closed form; {z:.1f} standard errors of the mean of {vehicles} vehicles, {100 * CONFIDENCE:g} % for all"
            f" {count} together",
        )
        for name, words in MODELS.items()
        for axis, found_by_name in hover[name].items()
        for what, found in found_by_name.items()
    ]


def _mean_checks() -> list[Check]:
    """Return the checks of the mean wind's speed, bearing and vertical component."""
    north, east, down = mean_wind()
    bearing = math.degrees(math.atan2(-east, -north)) % 360.0
    speed = float(np.hypot(north, east))
    return [
        Check("mean wind at 20 ft, speed", speed, SPEED, 1e-6, "m/s", "2 ft/s by definition; rounding"),
        Check("mean wind, bearing it comes from", bearing, FROM_DEG, 1e-4, "°", "30° as published; rounding"),
        Check("mean wind, down", float(down), 0.0, 1e-9, "m/s", "a mean wind is level; rounding"),
    ]


def _gust_findings(numbers: Content, oracle: bool) -> list[Finding]:
    """Return the findings on published gust traces and, with ``oracle``, on JSBSim's turbulence."""
    hover, spectra = numbers["hover"], numbers["spectra"]
    lags = hover["time_constant_s"]
    found = [
        Finding(
            "length of the published traces",
            f"time constant {lags[0]:.0f} s horizontally, {lags[2]:.0f} s vertically",
            "to note",
            f"In so weak a wind {TRACE_S:g} s are {TRACE_S / lags[0]:.1f} time constants: one trace can be far from its"
            " standard deviation and look like a different wind, so traces are compared in the mean of many.",
        )
    ]
    if not oracle:
        return found
    for name, words in (
        ("jsbsim_type_4", "JSBSim type 4, the second-order filters of MIL-F-8785C by the bilinear transform"),
        ("jsbsim_type_3", "JSBSim type 3, the first-order recursions of MIL-STD-1797A"),
    ):
        exact = spectra[name]["exact_db_from_closed_form"]
        p = min(p_values(spectra[name]))
        found.append(
            Finding(
                words,
                f"its recursions are at most {exact:.1f} dB from the closed form of u, v and w; its series agree with"
                f" them (smallest p of 5 variances {p:.2g})",
                "fits" if exact < 1.0 else "fits in part",
                "An independent program arrives at these spectra, but for its discretisation."
                if name == "jsbsim_type_4"
                else "Its v and w are of first order, not of the standard's form, and it departs where it must.",
            )
        )
    ratios = hover["jsbsim_type_4"]
    found.append(
        Finding(
            "JSBSim type 4, hovering in the published wind",
            "variance over the closed form "
            + ", ".join(f"{axis} {ratios[axis]['variance_over_closed_form']:.2f}" for axis in ratios),
            "to note",
            "JSBSim's airspeed includes the gusts, which are not small against 2 ft/s, so that its time constants move"
            " about; a single trace of 200 s varies by"
            f" {ratios['along']['std_of_windows']:.1f} (along) and {ratios['down']['std_of_windows']:.1f} (down).",
        )
    )
    return found


def _summarise(numbers: Content, oracle: bool) -> str:
    """Return one sentence that concludes the comparison of simulated gusts with theory; ``oracle``: with JSBSim."""
    ours = numbers["spectra"]["ours"]
    largest = max(ours[axis]["largest_db_from_closed_form"] for axis in COMPONENTS[:3])
    reading = f"Gusts have the standard's variances and correlations within chance, and its spectra to {largest:.1f} dB"
    return reading + (", as JSBSim's second-order model has." if oracle else ".")


def _draw_traces(traces: dict[str, Floats]) -> Picture:
    """Draw one gust trace of each turbulence model around the mean wind."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import picture

    figure = new_figure(11.0, 6.0)
    panels = figure.subplots(3, 1, sharex=True)
    mean, sigma = mean_wind(), scales(CASE)[1]
    for i, (panel, axis) in enumerate(zip(panels, ("north", "east", "down"), strict=True)):
        for (name, gusts), colour in zip(traces.items(), ("tab:red", "tab:blue", "gray"), strict=False):
            time = DT * EVERY * (1 + np.arange(len(gusts)))
            panel.plot(time, mean[i] + gusts[:, i], color=colour, lw=0.9, label=name)
        panel.axhline(mean[i], color="black", lw=1.0, label="mean wind")
        for sign in (-2.0, 2.0):
            panel.axhline(
                mean[i] + sign * sigma[i], color="black", lw=0.8, ls="--", label="± 2 sigma" if sign > 0 else None
            )
        panel.set_ylabel(f"air {axis}\n[m/s]")
        panel.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=5, fontsize=9)
    panels[-1].set(xlabel="time [s]", xlim=(0.0, TRACE_S))
    return picture(
        figure,
        "The air's velocity at a hovering vehicle, 200 s of each model: mean wind of 2 ft/s from 30°, at 20 ft. The"
        " traces are independent draws: what is alike are their sizes and how fast they change.",
    )


PART = Part(
    "turbulence",
    "Turbulence",
    "the turbulence figure: traces over 200 s in a mean wind of 2 ft/s from 30°",
    (),
    _run_part,
)
