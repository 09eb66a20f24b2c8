"""In what two runs differ, on logs whose differences were put there."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight import AXES, MEAN, STEP, write_flight

from qrsim.errors import RunError, UsageError
from qrsim.runs import open_run
from qrsim.runs.compare import Comparison, compare_runs
from qrsim.runs.compare_figure import draw_comparison
from qrsim.runs.headlines import headlines
from qrsim.runs.settings import ABSENT, Setting

Values = dict[str, dict[str, np.ndarray]]


@pytest.fixture
def compared(tmp_path) -> Callable[..., Comparison]:
    """Return a function that compares a flight with another that differs by some options."""

    def compare(first: dict[str, Any] | None = None, tolerance: float = 0.0, streams: Any = (), **second: Any) -> Any:
        a = write_flight(tmp_path / "a", **(first or {}))
        b = write_flight(tmp_path / "b", **second)
        return compare_runs(open_run(a), open_run(b), tolerance, streams)

    return compare


def shift(tick: int, vehicle: int, by: float, column: str = "position_ned.x") -> Callable[[Values], None]:
    def change(values: Values) -> None:
        values["truth"][column][tick:, vehicle] += by

    return change


def test_the_same_flight_is_bit_identical(compared):
    found = compared(first={"stops": {1: 20}}, stops={1: 20})
    assert found.same
    assert found.bit_identical
    assert found.settings == ()
    assert found.differences == []
    # Not numbers after the stop, in both.
    assert {stream.stream: (stream.ticks, stream.equal) for stream in found.streams} == {
        "truth": (60, 4),
        "measurements": (60, 4),
        "commands": (60, 3),
        "wind": (60, 6),
    }
    assert (found.events.equal, found.events.only) == (3, ((), ()))


def test_a_difference_is_located_and_measured(compared):
    def change(values: Values) -> None:
        values["truth"]["position_ned.x"][30:, 1] += 0.5
        values["truth"]["position_ned.x"][40, 0] -= 2.0
        values["wind"]["gust_ned.z"][10, 0] += 1e-3

    found = compared(change=change)
    assert not found.same
    assert not found.bit_identical
    # What differs first is first.
    gust, position = found.differences
    assert (gust.quantity, position.quantity) == ("wind.gust_ned.z", "truth.position_ned.x")
    assert (position.unit, position.unmatched) == ("m", 0)
    assert (position.first.time, position.first.vehicle) == (pytest.approx(30 * STEP), "v1")
    assert np.diff(position.first.values) == pytest.approx(0.5)
    assert (position.largest.time, position.largest.vehicle) == (pytest.approx(40 * STEP), "v0")
    assert position.largest_difference == pytest.approx(2.0)
    assert position.rms == pytest.approx(math.sqrt((30 * 0.25 + 4.0) / 120))
    assert gust.rms == pytest.approx(1e-3 / math.sqrt(120))
    assert [stream.equal for stream in found.streams] == [3, 4, 3, 5]


def test_of_differences_at_one_time_the_relatively_larger_is_first(compared):
    def change(values: Values) -> None:
        values["truth"]["position_ned.y"][5] += 0.1
        values["wind"]["mean_ned.x"][5] += 0.1  # of a quantity that is constant

    assert [d.quantity for d in compared(change=change).differences] == ["wind.mean_ned.x", "truth.position_ned.y"]


@pytest.mark.parametrize(("tolerance", "same"), [(0.49, False), (0.51, True)])
def test_tolerance(compared, tolerance, same):
    found = compared(tolerance=tolerance, change=shift(30, 0, 0.5))
    assert found.same is same
    assert found.bit_identical is False
    assert len(found.differences) == (0 if same else 1)


def test_flags_have_no_tolerance(compared):
    def change(values: Values) -> None:
        values["truth"]["valid"][50, 1] = False

    found = compared(tolerance=10.0, change=change)
    [difference] = found.differences
    assert (difference.quantity, difference.first.values) == ("truth.valid", (1.0, 0.0))


def test_a_value_that_only_one_run_has(compared):
    def change(values: Values) -> None:
        values["measurements"]["barometer.height"][7:9, 0] = np.nan

    found = compared(tolerance=1.0, change=change)
    [difference] = found.differences
    assert difference.unmatched == 2
    assert difference.first.time == pytest.approx(7 * STEP)
    assert math.isnan(difference.first.values[1])
    assert (difference.largest_difference, difference.rms) == (0.0, 0.0)


def test_the_sign_of_zero_is_the_same_number_of_other_bits(compared):
    def change(values: Values) -> None:
        values["wind"]["gust_ned.x"][3, 0] = -0.0

    found = compared(change=change)
    assert found.same
    assert not found.bit_identical


def test_infinite_values(compared):
    def both(values: Values) -> None:
        values["wind"]["gust_ned.x"][3, 0] = np.inf

    assert compared(first={"change": both}, change=both).bit_identical


def test_parts_of_other_lengths_are_compared_tick_by_tick(tmp_path):
    # The second log has the same ticks in three parts of other lengths.
    first = open_run(write_flight(tmp_path / "a", ticks=60))
    second = open_run(write_flight(tmp_path / "b", ticks=45, change=shift(44, 0, 1.0)))
    assert first.info.parts["truth"] == second.info.parts["truth"] == 3
    found = compare_runs(first, second)
    truth = found.streams[0]
    assert (truth.ticks, truth.ticks_only) == (45, (15, 0))
    assert [stream.ticks_only for stream in found.streams] == [(15, 0)] * 4


def test_a_longer_run(compared):
    found = compared(ticks=80)
    assert not found.same
    assert found.settings == (Setting("ticks", (59, 79)),)
    assert all(stream.ticks_only == (0, 20) for stream in found.streams)
    # These flights turn half-way: until the first of them does, the true paths are the same.
    truth = [round(item.first.time / STEP) for item in found.differences if item.quantity.startswith("truth.")]
    assert truth == [31, 31]


def test_decimated_logs_are_compared_at_common_ticks(compared):
    found = compared(first={"every": {"truth": 4}}, every={"truth": 6, "wind": 3})
    truth, _, _, wind = found.streams
    assert (truth.ticks, truth.ticks_only, truth.equal) == (5, (10, 5), 4)
    assert (wind.ticks, wind.ticks_only, wind.equal) == (20, (40, 0), 6)
    assert found.differences == []
    assert not found.same
    assert {setting.path for setting in found.settings} == {"every.truth", "every.wind"}


def test_vehicles_are_matched_by_name(compared):
    def reverse(values: Values) -> None:
        for columns in values.values():
            for name, array in columns.items():
                columns[name] = array[:, ::-1].copy()

    found = compared(first={"vehicles": 3}, vehicles=3, names=["v2", "v1", "other"], change=reverse)
    assert found.vehicles == ("v1", "v2")
    assert found.vehicles_only == (("v0",), ("other",))
    assert found.differences == []
    assert not found.same


def test_no_vehicle_in_common(compared):
    found = compared(names=["x", "y"])
    assert found.vehicles == ()
    assert not found.same
    assert found.differences == []


def test_other_columns(compared):
    found = compared(sensors=("gnss",))
    assert found.streams[1].columns_only == (("barometer.height",), ())
    assert not found.same


def test_chosen_streams(compared):
    found = compared(change=shift(30, 0, 1.0), streams=["wind"])
    assert [stream.stream for stream in found.streams] == ["wind"]
    assert found.events is None
    assert found.same


def test_events_that_differ(compared):
    found = compared(first={"stops": {0: 20}}, stops={1: 25}, streams=["events"])
    assert found.events.equal == 2
    (mine,), (other,) = found.events.only
    assert (mine.vehicle, mine.tick, other.vehicle, other.tick) == ("v0", 20, "v1", 25)
    assert not found.same


def test_settings_are_compared_value_by_value(compared):
    yaml = "world:\n  wind: {speed: 5.0}\n  obstacles: [{x: 1.0}]\nstart: [0.0, 1.0]\n"
    other = "world:\n  wind: {speed: 7.0, gust: 1.0}\n  obstacles: [{x: 2.0}, {x: 3.0}]\nstart: [0.0, 2.0]\n"
    found = compared(first={"scenario_yaml": yaml}, scenario_yaml=other, seed=6)
    assert {setting.path: setting.values for setting in found.settings} == {
        "seed": (5, 6),
        "scenario.world.wind.speed": (5.0, 7.0),
        "scenario.world.wind.gust": (ABSENT, 1.0),
        "scenario.world.obstacles.0.x": (1.0, 2.0),
        "scenario.world.obstacles.1": (ABSENT, {"x": 3.0}),
        "scenario.start": ([0.0, 1.0], [0.0, 2.0]),
    }
    # They are told, and do not count.
    assert found.bit_identical


def test_an_unknown_stream(compared):
    with pytest.raises(UsageError, match="neither run has a stream 'trut'; did you mean 'truth'"):
        compared(streams=["trut"])


def test_a_run_without_ticks(compared):
    found = compared(ticks=0)
    assert not found.same
    assert found.streams[0].ticks_only == (60, 0)


# ---------------------------------------------------------------- the headline numbers


def with_power(values: Values) -> None:
    """180 W each, and estimates that are 1, 2 and 2 m off."""
    values["truth"]["power"] = np.full((60, 2), 180.0)
    for axis, off in zip(AXES, (1.0, 2.0, 2.0), strict=True):
        values["commands"][f"estimate.position_ned.{axis}"] = values["truth"][f"position_ned.{axis}"] + off


def test_headlines_of_a_made_up_flight(tmp_path):
    run = open_run(write_flight(tmp_path / "run", stops={1: 20}, change=with_power))
    found = {item.name: (item.value, item.unit) for item in headlines(run)}
    assert found["ended"] == ("finished", "")
    assert found["vehicles stopped"] == (1.0, "")
    assert found["waypoints reached"] == (1.0, "")
    assert found["estimate error, RMS"] == (pytest.approx(3.0), "m")
    assert found["GNSS error vertical, RMS"] == (pytest.approx(3.0), "m")
    assert found["wind, largest"] == (pytest.approx(13.0), "m/s")
    # v1 hangs in the air, and v0 comes 29 steps of 4 cm nearer on its second leg, 10 steps to the north.
    assert found["separation, smallest"] == (pytest.approx(math.hypot(10 * 0.04, 30.0 - 29 * 0.04)), "m")
    # 59 steps of 20 ms of one, and 20 of the other.
    assert found["energy"] == (pytest.approx(180.0 * 79 * STEP / 3600.0), "Wh")


def test_headlines_are_nan_where_nothing_was_recorded(tmp_path):
    found = {item.name: item.value for item in headlines(open_run(write_flight(tmp_path / "run", vehicles=1)))}
    for name in ("energy", "estimate error, RMS", "separation, smallest", "battery left, least", "score"):
        assert math.isnan(found[name])


def test_no_headlines_of_a_log_without_a_column_that_they_need(tmp_path):
    def change(values: Values) -> None:
        values["wind"].pop("gust_ned.z")

    assert headlines(open_run(write_flight(tmp_path / "run", change=change))) == []


# ---------------------------------------------------------------- the picture


def pair(folder: Path, **second: Any) -> tuple[Any, Any]:
    vehicles = second.get("vehicles", 2)
    return open_run(write_flight(folder / "a", vehicles=vehicles)), open_run(write_flight(folder / "b", **second))


def test_the_picture_has_both_paths_and_their_distance(tmp_path):
    def change(values: Values) -> None:
        for axis, by in zip(AXES, (3.0, 0.0, 4.0), strict=True):
            values["truth"][f"position_ned.{axis}"][10:, 1] += by

    plan, distance = draw_comparison(*pair(tmp_path, change=change)).axes
    paths = [line for line in plan.lines if len(line.get_xdata()) > 1]
    assert [line.get_linestyle() for line in paths] == ["-", "--"] * 2
    assert distance.get_title().endswith("at most 5 m")
    same, apart = distance.lines
    np.testing.assert_array_equal(same.get_ydata(), 0.0)
    np.testing.assert_allclose(apart.get_ydata(), np.where(np.arange(60) < 10, 0.0, 5.0))
    np.testing.assert_allclose(apart.get_xdata(), np.arange(60) * STEP)


def test_the_picture_of_many_vehicles_at_common_ticks(tmp_path):
    figure = draw_comparison(*pair(tmp_path, vehicles=12, every={"truth": 4}, change=shift(0, 3, 2.0)))
    [median] = figure.axes[1].lines
    np.testing.assert_array_equal(median.get_ydata(), np.zeros(15))
    assert not figure.legends


def test_nothing_in_common_to_draw(tmp_path):
    with pytest.raises(RunError, match="have no vehicle in common: nothing to draw"):
        draw_comparison(*pair(tmp_path, names=["x", "y"]))


def test_mean_wind_is_what_the_log_holds(compared):
    """The values in the table are those of the logs."""
    found = compared(wind=2.0)
    by_name = {d.quantity: d for d in found.differences}
    assert by_name["wind.mean_ned.x"].first.values == (MEAN[0], 2 * MEAN[0])
