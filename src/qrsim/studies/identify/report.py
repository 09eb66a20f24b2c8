"""The report: a page of Markdown with its pictures beside it."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from qrsim.runs.picture import new_figure
from qrsim.studies.flight_logs.signals import SIGNALS
from qrsim.studies.identify.constants import VELOCITY
from qrsim.studies.identify.problem import cut
from qrsim.studies.identify.result import Result, write_text
from qrsim.studies.identify.scores import LAGS, open_loop

RECORDED, START, FOUND = "black", "tab:blue", "tab:red"
DPI = 100


def write_report(result: Result, folder: Path) -> list[Path]:
    """Write an identification's report.md, figures and identified.json into a folder; return the files."""
    import json

    pictures = {"constants.png": constants_figure(result)}
    for i in range(len(result.pieces)):
        pictures[f"held_out_{i}.png"] = held_out_figure(result, i)
        pictures[f"residuals_{i}.png"] = residual_figure(result, i)
    written = []
    for name, figure in pictures.items():
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=DPI, format="png")
        write_text(folder / name, buffer.getvalue())
        written.append(folder / name)
    write_text(folder / "identified.json", json.dumps(result.to_json(), indent=2) + "\n")
    write_text(folder / "report.md", page(result))
    return [*written, folder / "identified.json", folder / "report.md"]


def constants_figure(result: Result) -> Figure:
    """Draw each fitted constant divided by its initial value, with its 95 % interval."""
    found = result.constants()
    figure = new_figure(8.0, 1.2 + 0.32 * len(found))
    axes = figure.subplots()
    for row, each in enumerate(found.values()):
        start = each["start"] or 1.0
        axes.plot([each["low"] / start, each["high"] / start], [row, row], color=FOUND, lw=2)
        axes.plot(each["value"] / start, row, "o", color=FOUND)
    axes.axvline(1.0, color=START, lw=1, label="start (published)")
    axes.set_yticks(range(len(found)), list(found))
    axes.invert_yaxis()
    axes.set_xlabel("identified constant over its start, with 95 % interval")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize=9)
    return figure


def held_out_figure(result: Result, i: int) -> Figure:
    """Draw the held-out part of log ``i``: recorded, and simulated open loop with the constants before and after."""
    piece = cut(result.pieces[i].log, math.inf, result.train, 1.0)
    nuisances = result.answer.nuisances[i]
    separate = result.question.separate
    before = open_loop(piece, result.question.start, {"delay": nuisances["delay"]}, separate)
    after = open_loop(piece, result.answer.values, nuisances, separate)
    figure = new_figure(11.0, 1.9 * len(piece.channels) + 0.6)
    panels = np.atleast_1d(figure.subplots(len(piece.channels), 1, sharex=True))
    for c, (panel, name) in enumerate(zip(panels, piece.channels, strict=True)):
        for n in range(piece.windows.shape[1]):
            rows = piece.used[:, n]
            time = piece.log.time[piece.windows[rows, n]]
            first = n == 0
            panel.plot(time, piece.recorded[rows, n, c], color=RECORDED, lw=1.2, label="recorded" if first else None)
            panel.plot(time, before[rows, n, c], color=START, lw=0.9, label="start" if first else None)
            panel.plot(time, after[rows, n, c], color=FOUND, lw=0.9, label="identified" if first else None)
        panel.set_ylabel(f"{name.replace('_', ' ')}\n[{SIGNALS[name].unit}]")
        panel.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=9)
    panels[-1].set_xlabel("time [s] (held-out part, open loop)")
    return figure


def residual_figure(result: Result, i: int) -> Figure:
    """Draw the residuals of the training part of log ``i``, and their autocorrelations."""
    piece, residuals = result.pieces[i], result.answer.residuals[i]
    figure = new_figure(11.0, 1.6 * len(piece.channels) + 0.6)
    panels = figure.subplots(len(piece.channels), 2, squeeze=False, width_ratios=(3, 1), sharex="col")
    for c, name in enumerate(piece.channels):
        left, right = panels[c]
        for n in range(piece.windows.shape[1]):
            rows = piece.used[:, n]
            left.plot(piece.log.time[piece.windows[rows, n]], residuals[rows, n, c], color="tab:purple", lw=0.6)
        left.set_ylabel(name.replace("_", "\n"))
        values = np.where(piece.used, residuals[:, :, c], 0.0)
        total = float(np.sum(values**2)) or 1.0
        lags = range(min(2 * LAGS, len(values) - 1) + 1)
        right.stem(
            [lag * piece.log.dt for lag in lags],
            [float(np.sum(values[: len(values) - lag] * values[lag:])) / total for lag in lags],
            basefmt=" ",
            markerfmt=".",
        )
        right.axhline(0.0, color="gray", lw=0.6)
        right.set_ylim(-0.6, 1.05)
        for panel in (left, right):
            panel.grid(alpha=0.3)
    panels[0][0].set_title("residuals of the training part, in standard deviations")
    panels[0][1].set_title("autocorrelation")
    panels[-1][0].set_xlabel("time [s]")
    panels[-1][1].set_xlabel("lag [s]")
    return figure


def page(result: Result) -> str:
    """Return the report of an identification as Markdown."""
    lines = ["# Identified vehicle", ""]
    lines += ["| constant | unit | value | 95 % interval | start |", "|---|---|---|---|---|"]
    for name, each in result.constants().items():
        span = f"{each['low']:.5g} to {each['high']:.5g}"
        lines.append(f"| {name} | {each['unit']} | {each['value']:.6g} | {span} | {each['start']:.6g} |")
    lines += [
        "",
        *(f"- **{', '.join(names)}** {verdict}." for verdict, names in result.other_verdicts().items()),
        *(f"- {words[0].upper()}{words[1:]}." for words in result.effective_in_words()),
    ]
    lines += ["", "![constants](constants.png)", ""]
    for i in range(len(result.pieces)):
        lines += _log_section(result, i)
    return "\n".join(lines) + "\n"


def _log_section(result: Result, i: int) -> list[str]:
    """Return the lines of Markdown about log ``i`` of an identification."""
    content = result.to_json()["logs"][i]
    lines = [
        f"## {Path(content['file']).name} ({content['kind']})",
        "",
        *(f"- {note}" for note in content["notes"]),
        "",
    ]
    lines += ["| signal | unit | std | noise | std/noise | |", "|---|---|---|---|---|---|"]
    for name, each in content["channels"].items():
        words = "identified" if each.get("identified") else "" if each["moves"] else "does not move"
        numbers = f"{each['std']:.3g} | {each['noise']:.2g} | {each['ratio']:.3g}"
        lines.append(f"| {name} | {each['unit']} | {numbers} | {words} |")
    lines += ["", "| of this log | value | 95 % interval |", "|---|---|---|"]
    for name, each in content["nuisances"].items():
        span = f"{each['low']:.4g} to {each['high']:.4g}" if "low" in each else "given"
        lines.append(f"| {name} [{each['unit']}] | {each['value']:.4g} | {span} |")
    scores = content["held_out"]
    lines += [
        "",
        f"Mean squared error over the held-out {scores['rows']} rows, open loop from the first of them:",
        "",
        "| signal | variance | start | start, same wind and trims | identified | lower by |",
        "|---|---|---|---|---|---|",
    ]
    for name, error in scores["identified"].items():
        before, both = scores["start"][name], scores["start_with_nuisances"][name]
        change = scores["lower_percent"].get(name, 0.0)
        lines.append(
            f"| {name} | {scores['variance'][name]:.4g} | {before:.4g} | {both:.4g} | {error:.4g} | {change:.1f} % |"
        )
    if scores.get("velocity_5_s"):
        five = scores["velocity_5_s"]
        cases = (
            ("start", "start"),
            ("start with the same wind and trims", "start_with_nuisances"),
            ("identified", "identified"),
            ("no change", "no_change"),
        )
        told = ", ".join(f"{words} {five[name]:.4g}" for words, name in cases)
        lines += ["", f"Horizontal velocity within 5 s of {five['pieces']} starts from the record, (m/s)²: {told}."]
    lines += ["", "| residual | lag 1 | correlated over [s] | Ljung-Box p | with a command |", "|---|---|---|---|---|"]
    for name, each in content["whiteness"].items():
        first = f"| {name} | {each['lag_1']:.3f} | {each['correlated_s']:.2f} |"
        lines.append(f"{first} {each['ljung_box_p']:.2g} | {each['input']:.2f} |")
    lines += ["", f"![held out](held_out_{i}.png)", "", f"![residuals](residuals_{i}.png)", ""]
    if any(name in scores["identified"] for name in VELOCITY):
        lines += ["Velocity over a long time is an integral in unknown wind; the 5 s horizons show more.", ""]
    return lines
