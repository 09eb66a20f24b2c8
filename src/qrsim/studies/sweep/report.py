"""Report of a store, for ``qrsim sweep-report``: analysis, files and text."""

from __future__ import annotations

import copy
import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content
from qrsim.files.atomic import write_atomically
from qrsim.scenarios.reading import dump_yaml
from qrsim.studies.sweep import analysis
from qrsim.studies.sweep.axes import COUNT, apply, overrides
from qrsim.studies.sweep.results import Parameter, Results
from qrsim.studies.sweep.varying import assignment

WORST = 10
SCENARIO = "scenario.yaml"


@dataclass(frozen=True)
class Report:
    """Analysis of a store.

    Attributes:
        results: of the store.
        metric: whose map and sensitivity these are.
        metrics: all that the study keeps.
        responses: of each metric, for each parameter.
        pair: the two parameters of the map, None where there is only one.
        boundary: of failure, or why there is none.
        sensitivity: Sobol indices, or why there are none.
        worst: numbers of the worst episodes.
        best: number of the best episode, None where no other than the worst has a value.
        ranking: the metrics by which they are the worst, each with whether small values are the bad ones.
    """

    results: Results
    metric: str
    metrics: tuple[str, ...]
    responses: dict[str, list[analysis.Response]]
    pair: tuple[Parameter, Parameter] | None
    boundary: analysis.Boundary | str
    sensitivity: analysis.Sensitivity | str
    worst: list[int]
    best: int | None
    ranking: dict[str, bool]


def find(path: Path, metric: str | None, pair: list[str]) -> Report:
    """Analyse a store of episodes: responses, boundary of failure, sensitivity and worst episodes, as a ``Report``.

    Args:
        path: of the store.
        metric: the one to look at; None: the first of the study, and for the worst episodes that of its failure.
        pair: names of two parameters for the maps; empty: the first two.

    Raises:
        UsageError: it is no store, or it has no such metric or parameter.
        RunError: nothing has been flown yet.
    """
    results = Results(path)
    metrics = tuple(results.spec.metrics)
    chosen = metric or metrics[0]
    values = results.metric(chosen)
    metrics = metrics if chosen in metrics else (chosen, *metrics)
    responses = {
        name: [
            analysis.response(results, parameter, results.metric(name), results.limits(name))
            for parameter in results.parameters.values()
        ]
        for name in metrics
    }
    ranking = {chosen: results.low_is_bad(chosen)}
    if metric is None:
        failure = results.spec.failure
        ranking = {**ranking, failure.metric: failure.below is not None}
        ranking = dict(sorted(ranking.items(), key=lambda item: item[0] != failure.metric))
    worst = analysis.worst(results, ranking, WORST)
    best = analysis.worst(results, {name: not low_is_bad for name, low_is_bad in ranking.items()}, 1)
    return Report(
        results,
        chosen,
        metrics,
        responses,
        _pair(results, pair),
        analysis.boundary(results),
        analysis.sensitivity(results, values),
        worst,
        best[0] if best and best != worst[:1] else None,
        ranking,
    )


def _pair(results: Results, names: list[str]) -> tuple[Parameter, Parameter] | None:
    """Return the two parameters of the map: the named ones, or two with several levels; None without."""
    for name in names:
        if name not in results.parameters:
            raise UsageError(f"--map {name}: no parameter is called so{did_you_mean(name, results.parameters)}")
    if names:
        if len(set(names)) != 2:
            raise UsageError(f"--map {' '.join(names)}: give two parameters")
        return results.parameters[names[0]], results.parameters[names[1]]
    several = [parameter for parameter in results.parameters.values() if len(parameter.levels) > 1]
    # Numbers first, because a boundary can be drawn between them.
    pairs = sorted(combinations(several, 2), key=lambda pair: -sum(parameter.numeric for parameter in pair))
    return pairs[0] if pairs else None


def replay(results: Results, episode: int, folder: Path) -> str:
    """Return a shell command that flies an episode again, records it into ``folder`` and shows it."""
    command, run = _flight(results, episode, folder)
    return f"{command} && qrsim view {shlex.quote(str(run))}"


def against_best(report: Report, folder: Path) -> str | None:
    """Return a shell command that flies the worst and the best episode again and shows both; None if no best."""
    if report.best is None:
        return None
    flights = [_flight(report.results, episode, folder) for episode in (report.worst[0], report.best)]
    shown = shlex.join(["qrsim", "view", *(str(run) for _, run in flights)])
    return " && ".join([*(command for command, _ in flights), shown])


def _flight(results: Results, episode: int, folder: Path) -> tuple[str, Path]:
    """Return a shell command that flies an episode again and records it, and the run folder that it writes."""
    values = results.values_at(episode)
    source, changes = results.source, dict(results.spec.set)
    name, counts = _scenario_name(values)
    if source is None or counts:
        source, changes = str(folder / name), {}
        values = {path: value for path, value in values.items() if path not in counts}
    words = ["qrsim", "run", source, "--seed", str(int(results.seeds[episode]))]
    settings = [assignment(path, value) for path, value in changes.items()]
    settings += [text for path, value in values.items() for text in overrides(results.scenario, path, value)]
    words += [word for setting in settings for word in ("--set", setting)]
    spec = results.spec
    words += ["--policy", spec.policy] if spec.policy else []
    words += ["--estimator", spec.estimator] if spec.estimator else []
    words += ["--policy-ticks", str(spec.policy_ticks)] if spec.policy_ticks != 1 else []
    words += ["--precision", spec.precision] if spec.precision != "float32" else []
    run = folder / f"episode_{int(results.positions[episode])}"
    return shlex.join([*words, "--out", str(run)]), run


def _scenario_name(values: Mapping[str, object]) -> tuple[str, Content]:
    """Return the file name of an episode's scenario, and path -> value for values that only this file holds."""
    counts = {path: value for path, value in values.items() if path.endswith(COUNT)}
    return "_".join(["scenario", *map(str, counts.values())]) + ".yaml", counts


def _write_scenarios(report: Report, folder: Path) -> list[str]:
    """Write the study's scenario and one for each number of vehicles in worst and best episodes; return the names."""
    results = report.results
    contents = {SCENARIO: results.scenario}
    for episode in [*report.worst, *([] if report.best is None else [report.best])]:
        name, counts = _scenario_name(results.values_at(episode))
        contents[name] = copy.deepcopy(results.scenario)
        for path, value in counts.items():
            apply(contents[name], path, value)
    for name, content in contents.items():
        write_atomically(folder / name, dump_yaml(content).encode())
    return list(contents)


def write(report: Report, folder: Path, form: str = "png") -> list[Path]:
    """Write a report's figures (``form``: png, pdf or svg), tables as JSON, and scenarios; return the files."""
    from qrsim.runs.picture import save_picture
    from qrsim.studies.sweep import figures

    results = report.results
    folder.mkdir(parents=True, exist_ok=True)
    pictures = {f"response.{form}": lambda: figures.draw_responses(results, report.metrics, report.responses)}
    pair, boundary, indices = report.pair, report.boundary, report.sensitivity
    if pair is not None:
        pictures[f"map.{form}"] = lambda: figures.draw_map(results, pair, report.metric)
    if not isinstance(boundary, str):
        pictures[f"boundary.{form}"] = lambda: figures.draw_boundary(results, boundary, pair)
    if not isinstance(indices, str):
        pictures[f"sensitivity.{form}"] = lambda: figures.draw_sensitivity(results, indices, report.metric)
    for name, draw in pictures.items():
        save_picture(draw, folder / name)
    scenarios = _write_scenarios(report, folder)
    write_atomically(folder / "report.json", f"{json.dumps(to_json(report, folder), indent=2)}\n".encode())
    return [folder / name for name in (*pictures, *scenarios, "report.json")]


def to_json(report: Report, folder: Path) -> Content:
    """Return the tables of a report as a dict for JSON; non-finite numbers are None."""
    results, boundary, indices = report.results, report.boundary, report.sensitivity
    found: Content = {**results.summary(), "metric": report.metric}
    found["responses"] = {
        metric: {item.parameter.name: _response_json(item) for item in items}
        for metric, items in report.responses.items()
    }
    found["failures"] = {
        parameter.name: _response_json(analysis.failures(results, parameter))
        for parameter in results.parameters.values()
    }
    found["boundary"] = boundary if isinstance(boundary, str) else _boundary_json(boundary)
    found["sensitivity"] = indices if isinstance(indices, str) else _sensitivity_json(indices)
    found["worst_by"] = list(report.ranking)
    found["worst"] = [_worst_json(report, episode, folder) for episode in report.worst]
    found["against_best"] = against_best(report, folder)
    return found


def _response_json(item: analysis.Response) -> Content:
    """Return the mean and interval of a metric at each level of a parameter, as a dict for JSON."""
    numbers = {name: _plain(getattr(item, name)) for name in ("mean", "low", "high")}
    return {"levels": item.parameter.levels.tolist(), **numbers}


def _boundary_json(found: analysis.Boundary) -> Content:
    """Return a fitted boundary of failure as a dict for JSON."""
    crossings = {p.name: found.crossing(i) for i, p in enumerate(found.parameters)}
    return {
        "terms": "squares" if found.squares else "linear",
        "coefficients": _plain(found.coefficients),
        "half_fail_at": {
            name: None if at is None else dict(zip(("value", "low", "high"), _plain(np.array(at)), strict=True))
            for name, at in crossings.items()
        },
    }


def _sensitivity_json(found: analysis.Sensitivity) -> Content:
    """Return the Sobol indices of each parameter, with their half intervals, as a dict for JSON."""
    columns = (found.first, found.first_half, found.total, found.total_half)
    names = ("first", "first_half", "total", "total_half")
    return {
        name: dict(zip(names, _plain(np.array([column[i] for column in columns])), strict=True))
        for i, name in enumerate(found.names)
    }


def _worst_json(report: Report, episode: int, folder: Path) -> Content:
    """Return seed, values, metrics and replay command of an episode as a dict for JSON."""
    results = report.results
    return {
        "seed": int(results.seeds[episode]),
        "values": results.values_at(episode),
        **{metric: _plain([results.metric(metric)[episode]])[0] for metric in (report.metric, *report.ranking)},
        "failed": bool(results.failed[episode]),
        "command": replay(results, episode, folder),
    }


def _plain(values: object) -> list[float | None]:
    """Convert numbers to a list for JSON, with None for NaN and infinity."""
    return [float(value) if np.isfinite(value) else None for value in np.asarray(values, float)]


def print_report(report: Report, folder: Path) -> None:
    """Print the tables of a report."""
    results = report.results
    summary = results.summary()
    some = "" if results.episodes == results.planned else f" of {results.planned} planned"
    print(f"{summary['study']}: {results.episodes} episodes{some} at {summary['points']} points")
    print(f"failed ({results.failure}): {summary['failed']} ({100 * summary['failed'] / results.episodes:.1f} %)\n")
    for parameter in results.parameters.values():
        _print_response(analysis.failures(results, parameter), f"share with {results.failure}")
    unit = results.unit(report.metric)
    for item in report.responses[report.metric]:
        _print_response(item, f"{report.metric}{'' if unit == '1' else f' [{unit}]'}")
    print("half of the episodes fail at (logistic fit, the other parameters at their middle):")
    _print_boundary(report.boundary)
    print("\nSobol indices (part of the variance, alone and with others):")
    _print_sensitivity(report.sensitivity)
    print(f"\nworst episodes ({_ranked_by(report)}):")
    columns = [results.metric(metric) for metric in report.ranking]
    for episode in report.worst:
        where = ", ".join(f"{name} {_value(value)}" for name, value in _named(results, episode).items())
        numbers = " ".join(f"{values[episode]:9.4g}" for values in columns)
        print(f"  {numbers}  seed {results.seeds[episode]}, {where}")
    if report.worst:
        print(f"\nto fly the first again: {replay(results, report.worst[0], folder)}")
        if (command := against_best(report, folder)) is not None:
            print(f"\nto see it over the best: {command}")


def _ranked_by(report: Report) -> str:
    """Return as text the metrics by which the report ranks the worst episodes."""
    parts = []
    for metric, low_is_bad in report.ranking.items():
        unit = report.results.unit(metric)
        parts.append(f"{'smallest' if low_is_bad else 'largest'} {metric}{'' if unit == '1' else f' [{unit}]'}")
    if report.ranking.keys() != {report.metric}:
        parts[0] += ", by which episodes fail"
    return "; then ".join(parts)


def _named(results: Results, episode: int) -> Content:
    """Return name -> value of an episode's parameters, by the names that the study gives them."""
    values = results.values_at(episode)
    return {results.spec.vary[path].name or path: value for path, value in values.items()}


def _value(value: object) -> str:
    """Format a value as text of at most 30 characters."""
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 30 else f"{text[:27]}..."


def _print_response(item: analysis.Response, what: str) -> None:
    """Print the mean and its 95 % interval at each level of a parameter; ``what`` names the metric."""
    print(f"{item.parameter.label:<28} {what}, 95 % interval")
    for level, *numbers in zip(item.parameter.levels, item.mean, item.low, item.high, strict=True):
        name = f"{level:.4g}" if item.parameter.numeric else str(level)[:26]
        mean, low, high = ("-" if np.isnan(number) else f"{number:.4g}" for number in numbers)
        print(f"  {name:<26} {mean:>9}   {low} to {high}")
    print()


def _print_boundary(found: analysis.Boundary | str) -> None:
    """Print where half of the episodes fail for each parameter, or why there is no boundary."""
    if isinstance(found, str):
        print(f"  none: {found}")
        return
    for i, parameter in enumerate(found.parameters):
        at = found.crossing(i)
        if at is None:
            print(f"  {parameter.label:<26} not within the values that were flown")
            continue
        interval = "" if np.isnan(at[1]) else f"   {at[1]:.4g} to {at[2]:.4g}"
        print(f"  {parameter.label:<26} {at[0]:>9.4g}{interval}")


def _print_sensitivity(found: analysis.Sensitivity | str) -> None:
    """Print the first and total Sobol index of each parameter, or why there are none."""
    if isinstance(found, str):
        print(f"  none: {found}")
        return
    for name, *numbers in zip(found.names, found.first, found.first_half, found.total, found.total_half, strict=True):
        print(f"  {name:<26} {numbers[0]:6.3f} ± {numbers[1]:.3f}   {numbers[2]:6.3f} ± {numbers[3]:.3f}")
