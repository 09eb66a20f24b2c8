"""What plots of a page are drawn from: thinned values, derived quantities, answers to browsers."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.models.scene.area import BoxArea
from qrsim.runs import Column, RunInfo, RunWriter, open_run
from qrsim.runs.layout import Event
from qrsim.view import highlights
from qrsim.view.derived import FENCE, nearest, to_fence
from qrsim.view.highlights import highlights_of
from qrsim.view.plots import Plots, binned, extremes
from qrsim.view.recording import Member, Recording
from qrsim.view.series import Series

STEP, TICKS, NAMES = 0.1, 200, ("a_0", "<b>")
AXES = ("x", "y", "z")


@pytest.fixture(scope="module")
def plots(tmp_path_factory: pytest.TempPathFactory) -> Plots:
    """Of a run of two vehicles: the first flies north at 1 m/s from the start, the second stays 5 m east of it."""
    path = tmp_path_factory.mktemp("plots") / "run"
    info = RunInfo.collect(scenario="x", seed=1, precision="float64", time_step=STEP, vehicles=NAMES)
    vectors = {
        "truth": ["position_ned", "attitude"],
        "commands": ["estimate.position_ned", "estimate_std.position_ned"],
    }
    axes = {"attitude": ("roll", "pitch", "yaw")}
    columns = {
        stream: [Column(f"{name}.{axis}", "m") for name in names for axis in axes.get(name, AXES)]
        for stream, names in vectors.items()
    }
    ticks = np.arange(TICKS)
    values = {stream: {column.name: np.zeros((TICKS, 2)) for column in own} for stream, own in columns.items()}
    values["truth"]["position_ned.x"][:, 0] = ticks * STEP
    values["truth"]["position_ned.y"][:, 1] = 5.0
    values["commands"]["estimate.position_ned.x"][:, 0] = ticks * STEP + 3.0
    for axis in AXES:
        values["commands"][f"estimate_std.position_ned.{axis}"][:] = 2.0
    with RunWriter.create(path, info=info, scenario_yaml="name: x\n", columns=columns) as writer:
        for stream, own in values.items():
            writer.append(stream, ticks, ticks * STEP, own)
    with pytest.warns(UserWarning, match="cannot be built"):
        return Plots(Recording(open_run(path)))


def asked(plots: Plots, *lines: list[Any], start: float = 0.0, end: float = 19.9, bins: int = 10) -> tuple[Any, Any]:
    """Return the head of an answer and its arrays (parts, 2 bins)."""
    data = plots.answer({"number": 7, "lines": list(lines), "from": start, "to": end, "bins": bins})
    assert data is not None
    size = int.from_bytes(data[:4], "little")
    return json.loads(data[4 : 4 + size]), np.frombuffer(data[4 + size :], "<f4").reshape(-1, 2 * bins)


def test_a_line_keeps_extremes_and_its_band(plots: Plots):
    head, (times, value, low, high) = asked(plots, ["commands.estimate.position_ned.x", 0])
    assert head["number"] == 7
    [line] = head["lines"]
    assert (line["low"], line["lowAt"], line["band"]) == (3.0, 0.0, True)
    assert (line["high"], line["highAt"]) == (pytest.approx(22.9), pytest.approx(19.9))
    assert times[2] == pytest.approx(1.99)
    # Of each bin of 20 ticks the first and the last value.
    np.testing.assert_allclose(value[:4], [3.0, 4.9, 5.0, 6.9], atol=1e-5)
    # 1.96 standard deviations of 2 m.
    np.testing.assert_allclose(low[:2], 3.0 - 3.92, atol=1e-5)
    np.testing.assert_allclose(high[:2], 4.9 + 3.92, atol=1e-5)


def test_what_is_derived(plots: Plots):
    names = ("nearest_vehicle", "estimate_error", "estimate_error_sigmas", "height")
    head, (_, apart, error, sigmas, height) = asked(plots, *(["derived." + name, 0] for name in names))
    assert head["lines"][0]["low"] == pytest.approx(5.0)
    assert apart[-1] == pytest.approx(math.hypot(19.9, 5.0), abs=1e-3)
    np.testing.assert_allclose(error, 3.0, atol=1e-5)
    np.testing.assert_allclose(sigmas, 1.5, atol=1e-5)
    np.testing.assert_array_equal(height, 0.0)
    # The scenario cannot be built, so its area is not known; no speed was logged.
    assert {"derived.fence_distance", "derived.speed"}.isdisjoint(plots.quantities)


def test_highlights_say_who_and_when(plots: Plots, monkeypatch: pytest.MonkeyPatch):
    # The first vehicle begins 5 m from the second, whose estimate is 5 m = 2.5 standard deviations off.
    assert plots.highlights() == [
        (None, "stopped: 0 of 2", "stops"),
        (0.0, "closest pair: a_0 and <b>, 5.00 m at 0.00 s", "separation"),
        (0.0, "largest error of the estimate: <b>, 5.00 m", "estimate"),
        (0.0, "estimate first outside its 95 % band (1.96 sigma on the worst axis): <b> 0.00 s", "estimate"),
    ]
    # The first one's error is 3 m = 1.5 standard deviations.
    outside = "first outside its 95 % band (1.0 sigma on the worst axis): a_0 0.00 s, <b> 0.00 s"
    for band, told in ((1.0, outside), (9.0, "never outside its 95 % band (9.0 sigma on the worst axis)")):
        monkeypatch.setattr(highlights, "BAND", band)
        assert plots.highlights()[-1][1] == f"estimate {told}"
    data = plots.answer({"number": 3, "lines": [], "highlights": True})
    assert data is not None
    assert json.loads(data[4:])["highlights"][2] == [0.0, "largest error of the estimate: <b>, 5.00 m", "estimate"]


@pytest.mark.parametrize(
    ("past", "stops", "told"),
    [
        # The first vehicle is at the fence at 7.5 s, and 0.1 m beyond it from the next tick on.
        ([], {}, (7.6, "outside the fence: a_0 by up to 12.40 m from 7.60 s on")),
        # Back inside at 9 s, and the second one outside at 8 s.
        (
            [(90, 200, 0, 3.0), (80, 100, 1, -1.0)],
            {},
            (
                7.6,
                "outside the fence: a_0 by up to 1.40 m from 7.60 s to 9.00 s; "
                "<b> by up to 1.00 m from 8.00 s to 10.00 s",
            ),
        ),
        # It stopped there, in an area that is not known: its log has the last place inside for good.
        ([(75, 200, 0, 0.001)], {0: 7.52}, (7.52, "outside the fence: a_0 at 7.52 s")),
        # Never outside: the closest approach, at its first tick.
        ([(75, 200, 0, 0.001)], {}, (7.5, "closest to the fence: a_0, 0.00 m")),
    ],
)
def test_beyond_a_fence_the_first_time_counts(
    plots: Plots, past: list[Any], stops: dict[int, float], told: tuple[float, str], monkeypatch: pytest.MonkeyPatch
):
    member = plots._recording.members[0]
    events = [(Event(at, 376, "a_0", "out_of_area", None, None, ""), vehicle) for vehicle, at in stops.items()]
    monkeypatch.setattr(member.recording, "stops", events)
    series = Series(member, member)
    values = np.stack([7.5 - np.arange(TICKS) * STEP, np.full(TICKS, 5.0)], axis=1)
    for first, last, vehicle, value in past:
        values[first:last, vehicle] = value
    series.quantities[FENCE] = series.quantities["derived.height"]
    series._kept[FENCE] = (np.arange(TICKS) * STEP, values)
    assert list(highlights._fence(series)) == [(pytest.approx(told[0]), told[1])]


@pytest.mark.filterwarnings("ignore:.*cannot be built:UserWarning")
def test_where_two_runs_part(plots: Plots):
    recording = plots._recording.members[0].recording
    # Run B is 2 s late, so that its first vehicle is 2 m behind that of A once B has begun.
    both = [Member("A", recording), Member("B", recording, shift=2.0, first=2)]
    found = [line[:2] for line in highlights_of([Series(own, both[0]) for own in both])]
    assert (2.0, "first 1 m from run A: B a_0 2.00 s") in found
    assert "farthest from run A: B a_0, 2.00 m" in [text for _, text in found]
    # The earliest of B's times that are shown.
    assert (2.0, "closest pair: B a_0 and <b>, 5.00 m at 2.00 s") in found


def test_one_value_is_exact(plots: Plots):
    _, (_, value) = asked(plots, ["truth.position_ned.x", 0], start=7.3, end=7.301)
    np.testing.assert_allclose(value, 7.3, atol=1e-5)


def test_the_catalogue_has_sets_and_escapes_nothing_itself(plots: Plots):
    about: Any = plots.about()
    assert about["vehicles"] == ["a_0", "<b>"]
    sets = dict(about["together"])
    assert sets["north: estimate with its 95 % band, truth"] == [
        "commands.estimate.position_ned.x",
        "truth.position_ned.x",
    ]


@pytest.mark.parametrize(
    "wish",
    [
        None,
        {"lines": "all"},
        {"lines": [], "from": 0.0, "to": math.nan, "bins": 10},
        {"lines": [], "from": 5.0, "to": 5.0, "bins": 10},
        {"lines": [], "from": "0", "to": 1.0, "bins": 10},
    ],
)
def test_nonsense_is_not_answered(wish: object, plots: Plots):
    assert plots.answer(wish) is None


def test_lines_that_there_are_not_are_null(plots: Plots):
    lines = [["truth.nothing", 0], ["truth.position_ned.x", 2], ["truth.position_ned.x", -1], ["../x", 0], [3, 0], "x"]
    head, parts = asked(plots, *lines)
    assert head["lines"] == [None] * 6
    assert len(parts) == 1


@pytest.mark.filterwarnings("ignore:.*cannot be built:UserWarning")
def test_a_damaged_part_has_no_line(plots: Plots, tmp_path: Path):
    copy = shutil.copytree(plots._recording.run.folder, tmp_path / "copy")
    first, *_ = sorted((copy / "commands").glob("*.parquet"))
    last = sorted((copy / "commands").glob("*.parquet"))[-1]
    last.write_bytes(b"not a table")
    line = ["commands.estimate.position_ned.y", 0]
    found = Plots(Recording(open_run(copy)))
    head, parts = asked(found, line, ["truth.position_ned.y", 1])
    assert head["lines"][0] is None
    assert head["lines"][1]["high"] == 5.0
    assert len(parts) == 2
    # A page without a server has it as well, without the values of this stream.
    values = dict(zip(found.quantities, next(found.of_vehicles()), strict=True))
    assert np.isnan(values[line[0]]).all()
    assert np.isfinite(values["truth.position_ned.y"]).all()
    # Where the first part is gone too, its columns are not known.
    first.write_bytes(b"")
    assert line[0] not in Plots(Recording(open_run(copy))).quantities


def test_bins_outside_of_a_run_are_empty():
    time, values = np.arange(10.0), np.arange(10.0)
    found = binned(time, values, np.linspace(-5.0, 20.0, 26))
    assert np.isnan(found[:10]).all()
    assert found[10] == 0.0
    assert np.isnan(found[-10:]).all()
    assert extremes(time, np.full(10, np.nan), np.array([0.0, 9.0]))["low"] is None
    assert np.isnan(binned(np.zeros(0), np.zeros(0), np.array([0.0, 1.0]))).all()


def test_a_peak_of_one_tick_survives():
    values = np.zeros(100_000)
    values[31_415] = 1.0
    found = binned(np.arange(100_000) * 0.01, values, np.linspace(0.0, 1000.0, 101))
    assert found.max() == 1.0
    assert np.flatnonzero(found)[0] // 2 == 31


def test_distances_to_the_fence_and_to_others():
    area = BoxArea(x_min=-10.0, x_max=20.0, y_min=-30.0, y_max=30.0, z_min=-15.0, z_max=0.0)
    place = {"x": 18.5, "y": 0.0, "z": -10.0}
    found = to_fence(area).compute(lambda name: np.full((1, 1), place[name[-1]]))
    assert found == pytest.approx(1.5)
    place["z"] = -16.0
    assert to_fence(area).compute(lambda name: np.full((1, 1), place[name[-1]])) == pytest.approx(-1.0)
    assert np.isnan(nearest(np.zeros((3, 1, 3)))).all()
    apart = nearest(np.array([[[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [np.nan] * 3]]))
    np.testing.assert_allclose(apart[0, :2], 5.0)
    assert np.isnan(apart[0, 2])
