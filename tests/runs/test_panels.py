"""Panels of any quantities: how they are named, and what is drawn."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight import STEP, write_flight
from matplotlib.figure import Figure

from qrsim.errors import RunError, UsageError
from qrsim.runs import open_run
from qrsim.runs.panels import draw_panels, parse_panel
from qrsim.runs.quantities import quantities


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return open_run(write_flight(tmp_path_factory.mktemp("panels") / "run", vehicles=3, stops={1: 25}))


def drawn(run: Any, *panels: str, **options: Any) -> Figure:
    """A figure; a warning of matplotlib or NumPy is a failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = draw_panels(run, panels, **options)
        figure.canvas.draw()
        return figure


def lines(axes: Any) -> list[Any]:
    """Lines that join points."""
    return [line for line in axes.lines if line.get_linestyle() != "None" and len(line.get_xdata()) > 1]


# ---------------------------------------------------------------- names


def test_all_quantities_have_their_unit(run):
    found = {item.name: item.column.unit for item in quantities(run)}
    assert found["truth.position_ned.z"] == "m"
    assert found["wind.gust_ned.x"] == "m/s"
    assert not [name for name in found if name.split(".")[-1] in ("tick", "vehicle", "time") or "events" in name]


@pytest.mark.parametrize(
    ("text", "names", "label"),
    [
        ("truth.position_ned.z", ["truth.position_ned.z"], "position_ned.z (down) [m]"),
        ("wind.gust_ned", [f"wind.gust_ned.{axis}" for axis in "xyz"], "gust_ned [m/s]"),
        (
            "measurements.gnss.position_ned.x, truth.position_ned.x",
            ["measurements.gnss.position_ned.x", "truth.position_ned.x"],
            "position_ned.x (north) [m]",
        ),
        ("measurements.barometer.height,truth.position_ned.z", None, "[m]"),
        ("truth.valid", ["truth.valid"], "valid"),
    ],
)
def test_panels(text, names, label, run):
    panel = parse_panel(run, text)
    assert panel.label == label
    if names:
        assert [item.name for item in panel.quantities] == names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("truth.positoin_ned.z", "has no quantity 'positoin_ned.z'; did you mean 'truth.position_ned.z'"),
        ("trut.valid", "no stream 'trut'.*did you mean 'truth.valid'"),
        ("position_ned.z", "did you mean 'truth.position_ned.z'"),
        ("nothing", "known: truth, measurements, commands, wind"),
        ("measurements.gnss", "not one quantity but several, such as measurements.gnss.position_ned;"),
        ("events.value", "cannot be drawn"),
        ("truth.valid,", "a panel needs the name of a quantity"),
        ("truth.valid,truth.valid", "truth.valid is given twice"),
        (
            "truth.position_ned.x,wind.gust_ned.x",
            r"truth\.position_ned\.x is in m and wind\.gust_ned\.x is in m/s; give each unit its own panel",
        ),
        (
            ",".join(
                f"{name}.{axis}"
                for axis in "xyz"
                for name in ("truth.position_ned", "measurements.gnss.position_ned", "commands.setpoint.position_ned")
            ),
            "9 quantities are too many",
        ),
    ],
)
def test_wrong_panels(text, message, run):
    with pytest.raises(UsageError, match=message):
        draw_panels(run, [text])


# ---------------------------------------------------------------- pictures


def test_each_vehicle_has_a_line_with_its_values_until_it_stops(run):
    figure = drawn(run, "truth.position_ned.y", "wind.gust_ned.z")
    first, second = figure.axes
    values = run["truth"]["position_ned.y"]
    assert len(lines(first)) == len(lines(second)) == 3
    for i, line in enumerate(lines(first)):
        there = np.arange(60) < (26 if i == 1 else 60)
        np.testing.assert_array_equal(line.get_ydata()[there], values[there, i])
        assert np.isnan(line.get_ydata()[~there]).all()
    [cross] = [line for line in first.lines if line.get_marker() == "X"]
    assert (cross.get_xdata(), cross.get_ydata()) == ([25 * STEP], [values[25, 1]])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["v0", "v1", "v2"]
    assert "3 vehicles, 1 stopped (X), 1.18 s" in figure.get_suptitle()
    assert second.get_xlabel() == "time [s]"
    assert first.get_title(loc="left") == "truth.position_ned.y"


def test_several_quantities_differ_in_style_and_vehicles_in_colour(run):
    [axes] = drawn(run, "truth.position_ned.x,measurements.gnss.position_ned.x").axes
    looks = {(line.get_linestyle(), tuple(line.get_color())) for line in lines(axes)}
    assert len(looks) == 6
    assert len({style for style, _ in looks}) == 2
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "truth.position_ned.x",
        "measurements.gnss.position_ned.x",
    ]


def test_one_vehicle_has_colours_for_the_quantities(run):
    figure = drawn(run, "wind.gust_ned.x,wind.gust_ned.y,wind.gust_ned.z", vehicles=["v2"])
    found = lines(figure.axes[0])
    assert {line.get_linestyle() for line in found} == {"-"}
    assert len({tuple(line.get_color()) for line in found}) == 3
    assert figure.get_suptitle() == "made_up, seed 5: v2, 1.18 s"
    assert not figure.legends


def test_a_vector_has_an_axis_of_its_own_for_each_part(run):
    every = drawn(run, "truth.position_ned, measurements.gnss.position_ned", "truth.valid", vehicles=["v0"]).axes
    assert len(every) == 4
    for axes, column, label in zip(every, "xyz", ("north", "east", "down"), strict=False):
        true, reported = lines(axes)
        np.testing.assert_array_equal(true.get_ydata(), run["truth"][f"position_ned.{column}"][:, 0])
        np.testing.assert_array_equal(reported.get_ydata(), run["measurements"][f"gnss.position_ned.{column}"][:, 0])
        assert axes.get_ylabel() == f"position_ned.{column} ({label}) [m]"
    assert every[3].get_title(loc="left") == "truth.valid"


def test_a_long_run_is_drawn_in_bins(tmp_path):
    run = open_run(write_flight(tmp_path / "run", vehicles=1, ticks=3000))
    figure = drawn(run, "truth.position_ned.x")
    [line] = lines(figure.axes[0])
    assert len(line.get_xdata()) == 400
    # 3000 ticks of 0.02 s in 400 bins.
    assert figure.get_suptitle().endswith("59.98 s; lines: mean and range of 0.15 s each")


def test_a_span_and_chosen_vehicles(run):
    figure = drawn(run, "truth.position_ned.x", vehicles=["v2", "v0"], start=0.2, end=0.4)
    [axes] = figure.axes
    for line, column in zip(lines(axes), (2, 0), strict=True):
        np.testing.assert_allclose(line.get_xdata(), np.arange(10, 21) * STEP)
        np.testing.assert_array_equal(line.get_ydata(), run["truth"]["position_ned.x"][10:21, column])
    assert axes.get_xlim() == (0.2, 0.4)
    assert figure.get_suptitle().endswith("2 vehicles, 1.18 s; shown: 0.2 to 0.4 s")


def test_a_value_between_gaps_is_a_point_and_no_line_crosses_a_gap(tmp_path):
    def holes(values: dict[str, dict[str, np.ndarray]]) -> None:
        values["measurements"]["barometer.height"][[3, 5, 20], 0] = np.nan

    run = open_run(write_flight(tmp_path / "run", vehicles=1, change=holes))
    [axes] = drawn(run, "measurements.barometer.height").axes
    [line] = lines(axes)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(line.get_ydata())), [3, 5, 20])
    [point] = [line for line in axes.lines if line.get_marker() == "."]
    np.testing.assert_allclose(point.get_xdata(), [4 * STEP])


def test_flags_are_steps_between_no_and_yes(run):
    [axes] = drawn(run, "truth.valid").axes
    assert {line.get_drawstyle() for line in lines(axes)} == {"steps-post"}
    assert [label.get_text() for label in axes.get_yticklabels()] == ["no", "yes"]


def test_many_vehicles_have_median_and_range(tmp_path):
    run = open_run(write_flight(tmp_path / "run", vehicles=30, stops=dict.fromkeys(range(30), 20)))
    figure = drawn(run, "truth.position_ned.y,measurements.gnss.position_ned.y")
    [axes] = figure.axes
    values = run["truth"]["position_ned.y"]
    true, reported = lines(axes)
    np.testing.assert_allclose(true.get_ydata()[:21], np.median(values[:21], axis=1))
    assert np.isnan(true.get_ydata()[21:]).all()
    assert len(reported.get_ydata()) == 60
    # Range and quartiles of each.
    assert len(axes.collections) == 4
    assert "30 vehicles, 30 stopped, 1.18 s; median, quartiles, range" in figure.get_suptitle()


def test_streams_of_different_decimation_share_the_axis_of_time(tmp_path):
    run = open_run(write_flight(tmp_path / "run", vehicles=1, every={"truth": 5, "measurements": 20}))
    [axes] = drawn(run, "truth.position_ned.x,measurements.gnss.position_ned.x").axes
    assert [len(line.get_xdata()) for line in lines(axes)] == [12, 3]
    assert axes.get_xlim() == (0.0, pytest.approx(55 * STEP))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vehicles": ["v7"]}, "has no vehicle 'v7'; known: v0, v1, v2"),
        ({"start": 5.0}, "no tick from 5 s; the log goes from 0 s to 1.18 s"),
        ({"start": 0.301, "end": 0.302}, "no tick from 0.301 s to 0.302 s"),
    ],
)
def test_wrong_options(options, message, run):
    with pytest.raises(UsageError, match=message):
        draw_panels(run, ["truth.position_ned.x"], **options)


def test_nothing_recorded(tmp_path: Path):
    run = open_run(write_flight(tmp_path / "run", ticks=0, end="running"))
    with pytest.raises(RunError, match="nothing to draw, because no tick was recorded"):
        draw_panels(run, ["truth.position_ned.x"])
