"""Reports, of results whose answers are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.sweep.conftest import flown, planned

from qrsim.cli import main
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.sweep import analysis
from qrsim.studies.sweep.figures import edges
from qrsim.studies.sweep.report import against_best, find, print_report, replay, to_json, write
from qrsim.studies.sweep.results import Results
from qrsim.studies.sweep.store import Store

WIND, MASS = "world.wind.speed_20ft", "fleets.pelicans.vehicle.mass"
Made = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def made(folder: Path, of: Made, batches: int | None = None, **changes: Any) -> Path:
    """Return a store whose first metric is a function of wind, mass and a normal number of each seed."""
    plan = planned(folder, **changes)
    store = Store(folder / "made.zarr", plan)
    noise = np.random.default_rng(1).standard_normal(plan.study.spec.seeds)
    for index in range(plan.batches if batches is None else batches):
        batch = plan.batch(index)
        values = of(batch.numbers[WIND], batch.numbers[MASS], noise[batch.seeds]).astype(np.float32)
        store.write(batch, dict.fromkeys(store.metrics, values))
    store.close()
    return folder / "made.zarr"


def test_a_response_is_the_mean_over_all_else_with_the_interval_of_the_seeds(tmp_path: Path) -> None:
    path = made(tmp_path, lambda wind, mass, noise: 2.0 * wind + 10.0 * (mass - 1.65) + noise, seeds=30)
    results = Results(path)
    found = analysis.response(results, results.parameters["wind"], results.metric("tracking_error_rms_m"))
    noise = np.random.default_rng(1).standard_normal(30)
    half = 2.045 * noise.std(ddof=1) / np.sqrt(30)
    np.testing.assert_allclose(found.mean, 2.0 * found.parameter.levels + noise.mean(), atol=1e-4)
    np.testing.assert_allclose(found.high - found.mean, half, rtol=1e-3)


def _folder(tmp_path: Path) -> Path:
    (tmp_path / "flags").mkdir()
    return tmp_path / "flags"


def test_a_share_has_an_exact_interval() -> None:
    # Clopper and Pearson (1934): of 10 trials, 0 and 3 successes, at 95 %.
    np.testing.assert_allclose(analysis.share_interval(0.0, np.zeros(10), 10), (0.0, 0.30850), atol=1e-5)
    flags = np.repeat([1.0, 0.0], [3, 7])
    np.testing.assert_allclose(analysis.share_interval(0.3, flags, 10), (0.06674, 0.65245), atol=1e-5)
    # Ten seeds that each fail at all of 5 points or at none know no more than ten episodes do, if not quite as much:
    # 9 of variance p (1 - p)/9, times (t_49/t_9)^2 = (2.0096/2.2622)^2.
    low, high = analysis.share_interval(0.3, flags, 50)
    np.testing.assert_allclose((low, high), (0.0427, 0.7183), atol=1e-4)
    # Where no seed ever failed, the points of a seed say nothing new.
    np.testing.assert_allclose(analysis.share_interval(0.0, np.zeros(10), 50), (0.0, 0.30850), atol=1e-5)
    # 50 independent episodes: half of the seeds' variance would say more than 50, which there are not.
    np.testing.assert_allclose(analysis.share_interval(0.4, np.full(10, 0.4) + [0, 1e-6] * 5, 50)[0], 0.245, atol=0.01)


def test_each_level_has_its_rate_of_failure(tmp_path: Path) -> None:
    """Winds of which the strongest stops every flight, and the others none."""
    failure = {"metric": "tracking_error_rms_m", "above": 2.5}
    results = Results(made(tmp_path, lambda wind, mass, noise: wind, seeds=10, failure=failure))
    found = analysis.failures(results, results.parameters["wind"])
    np.testing.assert_array_equal(found.parameter.levels, [0.0, 2.0, 4.0])
    np.testing.assert_array_equal(found.mean, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(found.high[0], 0.30850, atol=1e-5)
    np.testing.assert_allclose(found.low[-1], 1.0 - 0.30850, atol=1e-5)


@pytest.mark.long
def test_no_interval_leaves_its_metric_and_shares_stay_above_0(tmp_path: Path) -> None:
    # Next to 0 in most episodes: Student's t would go below it.
    path = made(tmp_path, lambda wind, mass, noise: np.where(noise > 1.0, 3.0, 0.0), seeds=12)
    report = find(path, None, [])
    for items in report.responses.values():
        for item in items:
            assert (item.low >= 0.0).all()
            assert (item.high > item.mean).all()
    flags = made(_folder(tmp_path), lambda wind, mass, noise: (noise > 5.0).astype(float), seeds=12)
    [wind, *_] = find(flags, None, []).responses["tracking_error_rms_m"]
    # None of 12 seeds: 1 - 0.025^(1/12).
    np.testing.assert_allclose(wind.high, 0.26465, atol=1e-4)
    np.testing.assert_array_equal(wind.low, 0.0)


def test_a_map_ends_where_the_data_do(tmp_path: Path) -> None:
    path = made(tmp_path, lambda wind, mass, noise: wind, seeds=2)
    results = Results(path)
    for parameter in results.parameters.values():
        found = edges(parameter)
        assert len(found) == len(parameter.levels) + 1
        assert (found[0], found[-1]) == pytest.approx((parameter.levels[0], parameter.levels[-1]))


@pytest.mark.long
def test_pictures_of_another_format(tmp_path: Path) -> None:
    path = made(tmp_path, lambda wind, mass, noise: wind, seeds=2)
    files = write(find(path, None, []), tmp_path / "report", "svg")
    assert {"response.svg", "map.svg"} <= {file.name for file in files}
    assert (tmp_path / "report" / "map.svg").read_bytes().startswith(b"<?xml")


def test_sobol_indices_are_those_of_the_function(tmp_path: Path) -> None:
    ranges = {WIND: {"low": 0.0, "high": 1.0, "name": "wind"}, MASS: {"low": 1.5, "high": 2.5, "name": "mass"}}
    changes = {"vary": ranges, "sampling": {"type": "saltelli", "points": 1024}, "seeds": 1, "batch": None}
    path = made(tmp_path, lambda wind, mass, noise: 3.0 * wind + 4.0 * mass + 6.0 * wind * (mass - 2.0), **changes)
    report = find(path, None, [])
    assert not isinstance(report.sensitivity, str)
    # Variances of the terms of uniform parameters; at the middle of wind the factor of mass is 4 + 6 * 0.5.
    alone, together = np.array([9 / 12, 49 / 12]), 36 / 144
    total = alone.sum() + together
    shares = alone / total
    np.testing.assert_allclose(report.sensitivity.first, shares, atol=0.02)
    np.testing.assert_allclose(report.sensitivity.total, (alone + together) / total, atol=0.02)


@pytest.mark.long
def test_the_boundary_of_failure_is_found_with_its_interval(tmp_path: Path) -> None:
    vary = {
        WIND: {"low": 0.0, "high": 10.0, "count": 11, "name": "wind"},
        MASS: {"low": 1.5, "high": 2.5, "count": 5, "name": "mass"},
    }
    path = made(
        tmp_path,
        lambda wind, mass, noise: wind + 2.0 * (mass - 2.0) + 0.5 * noise,
        vary=vary,
        seeds=60,
        batch=None,
        failure={"metric": "tracking_error_rms_m", "above": 6.3},
    )
    found = analysis.boundary(Results(path))
    assert not isinstance(found, str)
    crossing = found.crossing(0)
    assert crossing is not None
    at, low, high = crossing
    # The seeds' own mean moves it; it is common to all points.
    true = 6.3 - 0.5 * np.median(np.random.default_rng(1).standard_normal(60))
    assert at == pytest.approx(true, abs=0.15)
    assert low < true < high
    assert high - low < 1.0
    low_chance, high_chance = found.probability(np.array([[3.0, 2.0], [9.0, 2.0]]))
    assert low_chance < 0.02
    assert high_chance > 0.98


def test_between_a_level_that_never_fails_and_one_that_always_does_nothing_is_known(tmp_path: Path) -> None:
    vary = {WIND: {"values": [0.0, 2.0, 4.0, 6.0], "name": "wind"}, MASS: {"values": [1.5, 1.7], "name": "mass"}}
    path = made(
        tmp_path, lambda wind, mass, noise: wind, vary=vary, seeds=8, failure={"metric": "wind_max_m_s", "above": 3.0}
    )
    found = analysis.boundary(Results(path))
    assert not isinstance(found, str)
    crossing = found.crossing(0)
    assert crossing is not None
    assert crossing[1] == pytest.approx(2.0)
    assert crossing[2] == pytest.approx(4.0)


def test_nothing_is_said_where_there_is_nothing(tmp_path: Path) -> None:
    results = Results(made(tmp_path, lambda wind, mass, noise: wind, failure={"metric": "wind_max_m_s", "above": 99.0}))
    assert analysis.boundary(results) == "no episode failed (wind_max_m_s > 99 m/s)"
    assert "saltelli" in str(analysis.sensitivity(results, results.metric("wind_max_m_s")))


def test_the_worst_is_shown_over_the_best(tmp_path: Path) -> None:
    """Of a larger wind the tracking error is larger; the command flies both and opens one page."""
    report = find(made(tmp_path, lambda wind, mass, noise: wind), None, [])
    folder, results = tmp_path / "report", report.results
    assert report.best is not None
    winds = [results.values_at(episode)[WIND] for episode in (report.worst[0], report.best)]
    assert winds == [4.0, 0.0]
    command = str(against_best(report, folder))
    runs = [folder / f"episode_{int(results.positions[episode])}" for episode in (report.worst[0], report.best)]
    assert [part.split(" --out ")[-1] for part in command.split(" && ")[:2]] == list(map(str, runs))
    assert command.endswith(f" && qrsim view {runs[0]} {runs[1]}")


def test_a_report_of_a_sweep_that_still_runs(tmp_path: Path) -> None:
    report = find(made(tmp_path, lambda wind, mass, noise: wind + mass, batches=5), None, [])
    assert (report.results.episodes, report.results.planned) == (25, 60)
    mean = report.responses["tracking_error_rms_m"][0].mean
    assert np.isfinite(mean[:2]).all()
    assert np.isnan(mean[2])


@pytest.mark.long
def test_the_command_writes_pictures_and_tables(tmp_path: Path, capsys: Any) -> None:
    store = flown(tmp_path)
    assert main(["sweep-report", str(store)]) == 0
    told = capsys.readouterr().out
    assert "small: 60 episodes at 12 points" in told
    assert "to fly the first again: qrsim run hover_ideal --seed" in told
    folder = tmp_path / "store-report"
    assert {"response.png", "map.png", "scenario.yaml", "report.json"} <= {item.name for item in folder.iterdir()}
    assert main(["sweep-report", str(store), "--json", "--metric", "wind_max_m_s", "--out", str(tmp_path / "r")]) == 0
    found = json.loads(capsys.readouterr().out)
    largest = [worst["wind_max_m_s"] for worst in found["worst"]]
    assert largest == sorted(largest, reverse=True)
    assert found["worst"][0]["values"][WIND] == 4.0
    assert len(found["responses"]["wind_max_m_s"]["mass"]["mean"]) == 4


def ranked(folder: Path, **changes: Any) -> Path:
    """Return a store whose largest RMS error is in another episode than its largest error."""
    plan = planned(folder, vary={WIND: {"values": [0.0, 2.0, 4.0], "name": "wind"}}, seeds=1, **changes)
    store = Store(folder / "made.zarr", plan)
    numbers = {"tracking_error_rms_m": [1.0, 2.0, 3.0], "tracking_error_max_m": [4.0, 9.0, 4.0]}
    for index in range(plan.batches):
        batch = plan.batch(index)
        at = (batch.numbers[WIND] / 2.0).astype(int)
        found = {name: np.float32(values)[at] for name, values in numbers.items()}
        store.write(batch, {name: found.get(name, np.zeros(len(at), np.float32)) for name in store.metrics})
    store.close()
    return folder / "made.zarr"


@pytest.mark.parametrize(
    ("metric", "failure", "winds", "said"),
    [
        (
            None,
            {"metric": "tracking_error_max_m", "above": 5.0},
            [2.0, 4.0, 0.0],
            "worst episodes (largest tracking_error_max_m [m], by which episodes fail; then largest track",
        ),
        # What fails below a limit is worst where it is small, whatever the metric is of.
        (
            None,
            {"metric": "tracking_error_max_m", "below": 5.0},
            [4.0, 0.0, 2.0],
            "worst episodes (smallest tracking_error_max_m [m], by which episodes fail; then largest track",
        ),
        # Nobody has stopped.
        (
            None,
            None,
            [4.0, 2.0, 0.0],
            "worst episodes (largest stopped, by which episodes fail; then largest tracking_err",
        ),
        (
            "tracking_error_rms_m",
            {"metric": "tracking_error_max_m", "above": 5.0},
            [4.0, 2.0, 0.0],
            "worst episodes (largest tracking_error_rms_m [m]):",
        ),
    ],
)
def test_the_worst_episodes_are_those_by_what_failed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
    metric: str | None,
    failure: Any,
    winds: list[float],
    said: str,
) -> None:
    monkeypatch.setattr(analysis, "boundary", lambda results: "not asked for")
    report = find(ranked(tmp_path, failure=failure), metric, [])
    print_report(report, tmp_path)
    assert said in capsys.readouterr().out
    found = to_json(report, tmp_path)
    assert [item["values"][WIND] for item in found["worst"]] == winds
    assert found["worst"][0]["tracking_error_rms_m"] == winds[0] / 2.0 + 1.0
    assert found["worst_by"][0] == (metric or (failure or {"metric": "stopped"})["metric"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.zarr"], "none.zarr: there is no such store"),
        (["stor.zarr"], "did you mean 'store.zarr'?"),
        (["store.zarr", "--metric", "wind_max"], "did you mean 'wind_max_m_s'"),
        (["store.zarr", "--map", "wnd", "--map", "mass"], "did you mean 'wind'"),
        (["store.zarr", "--map", "mass"], "give two parameters"),
        (["study.yaml"], "it is no store of a sweep"),
    ],
)
def test_what_cannot_be_reported_is_said(
    tmp_path: Path, words: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    made(tmp_path, lambda wind, mass, noise: wind, batches=2).rename(tmp_path / "store.zarr")
    monkeypatch.chdir(tmp_path)
    assert main(["sweep-report", *words]) == 2
    assert said in capsys.readouterr().err


def test_an_empty_store_is_told(tmp_path: Path, capsys: Any) -> None:
    assert main(["sweep-report", str(made(tmp_path, lambda wind, mass, noise: wind, batches=0))]) == 1
    assert "no episode has been flown yet" in capsys.readouterr().err


@pytest.mark.long
def test_the_worst_of_several_numbers_of_vehicles_is_flown_from_a_scenario_of_its_own(tmp_path: Path) -> None:
    """Its vehicles would be too many words for a command."""
    content = load_scenario("patrol_plain").spec.model_dump(mode="json")
    counts = {"fleets.pelicans.vehicles.count": {"values": [1, 3], "name": "vehicles"}}
    plan = planned(tmp_path, scenario=content, vary=counts, seeds=1, metrics=["collided"])
    store = Store(tmp_path / "made.zarr", plan)
    for index in range(plan.batches):
        store.write(plan.batch(index), dict.fromkeys(store.metrics, np.full(1, index, np.float32)))
    store.close()
    report, folder = find(tmp_path / "made.zarr", None, []), tmp_path / "report"
    write(report, folder)
    command = replay(report.results, report.worst[0], folder)
    assert f"qrsim run {folder / 'scenario_3.yaml'} --seed" in command
    assert "vehicles" not in command.partition("--out")[0].replace("scenario_3.yaml", "")
    assert len(load_scenario(str(folder / "scenario_3.yaml")).spec.fleets["pelicans"].vehicles) == 3
