"""The figure: drawn for every kind of run, and what it shows."""

from __future__ import annotations

import struct
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from flight import HEIGHT, STEP, write_flight
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from qrsim.core.noise import Key
from qrsim.errors import RunError, UsageError
from qrsim.runs import open_run
from qrsim.runs.figure import draw_run, save_figure
from qrsim.runs.picture import binned, path_rows
from qrsim.runs.plan import held_places
from qrsim.runs.recorder import fly
from qrsim.runs.summary import gnss_error
from qrsim.runs.surroundings import surroundings_of
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.tasks.play import Play

# Where there is a receiver and wind; what is not there has no panel.
PLAN, HEIGHTS, WIND, NORTH, EAST, UP = range(6)
GNSS = NORTH, EAST, UP


def drawn(folder: Path, **options: Any) -> Figure:
    """The figure of a made-up flight; a warning of matplotlib or NumPy is a failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return draw_run(open_run(write_flight(folder / "run", **options)))


def lines(figure: Figure, panel: int, style: str = "-") -> list[Any]:
    """Lines of more than one point."""
    return [line for line in figure.axes[panel].lines if line.get_linestyle() == style and len(line.get_xdata()) > 1]


def crosses(figure: Figure, panel: int) -> list[Any]:
    return [line for line in figure.axes[panel].lines if line.get_marker() == "X"]


def texts(figure: Figure, panel: int) -> set[str]:
    return {text.get_text() for text in figure.axes[panel].texts}


def png_size(path: Path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    return struct.unpack(">II", data[16:24])


KINDS: dict[str, dict[str, Any]] = {
    "one vehicle": {"vehicles": 1},
    "ten vehicles": {"vehicles": 10},
    "thirty vehicles": {"vehicles": 30},
    "a hundred vehicles": {"vehicles": 100},
    "still air": {"wind": 0.0},
    "no sensors": {"sensors": ()},
    "nothing, many": {"sensors": (), "vehicles": 11, "wind": 0.0},
    "no barometer": {"sensors": ("gnss",)},
    "a crash": {"stops": {1: 25}},
    "all of many crashed": {"vehicles": 11, "stops": dict.fromkeys(range(11), 25)},
    "crashed at the start": {"vehicles": 1, "stops": {0: 0}},
    "two ticks": {"ticks": 2},
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_run_can_be_drawn(kind, tmp_path):
    figure = drawn(tmp_path, **KINDS[kind])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    windy, received = KINDS[kind].get("wind") != 0.0, "gnss" in KINDS[kind].get("sensors", ("gnss",))
    assert len(figure.axes) == 2 + windy + 3 * received
    north = 2 + windy if received else 99
    for panel, axes in enumerate(figure.axes):
        assert axes.get_title() or panel in (north + 1, north + 2)
        assert "[" in axes.get_xlabel() or panel in (north, north + 1)
        assert "[" in axes.get_ylabel()
        low, high = axes.get_ylim()
        assert np.isfinite([low, high]).all()
        assert high > low
        box = axes.title.get_window_extent()
        assert 0 <= box.x0 <= box.x1 <= width
        assert 0 <= box.y0 <= box.y1 <= height
    for left, right in ((PLAN, HEIGHTS), (NORTH, WIND)) if windy and received else ((PLAN, HEIGHTS),):
        first, second = (figure.axes[panel].title.get_window_extent() for panel in (left, right))
        assert first.x1 < second.x0


def test_the_plan_has_east_to_the_right_and_north_up(tmp_path):
    figure = drawn(tmp_path, vehicles=2)
    true = [line for line in lines(figure, PLAN) if line.get_linewidth() > 1]
    run = open_run(tmp_path / "run")
    for i, line in enumerate(true):
        np.testing.assert_array_equal(line.get_xdata(), run["truth"]["position_ned.y"][:, i])
        np.testing.assert_array_equal(line.get_ydata(), run["truth"]["position_ned.x"][:, i])
        assert line.get_label() == f"v{i}"
    assert len(true) == 2
    figure.canvas.draw()
    axes = figure.axes[PLAN]
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    box = axes.get_window_extent()
    assert (east - west) / box.width == pytest.approx((north - south) / box.height, rel=1e-6)
    for name, low, high in (("y", west, east), ("x", south, north)):
        values = run["truth"][f"position_ned.{name}"]
        assert low < values.min() <= values.max() < high


def test_height_is_up(tmp_path):
    figure = drawn(tmp_path, vehicles=1)
    true, measured = sorted(lines(figure, HEIGHTS), key=lambda line: -line.get_linewidth())
    np.testing.assert_array_equal(true.get_ydata(), HEIGHT)
    np.testing.assert_array_equal(measured.get_ydata(), HEIGHT + 0.5)
    [wanted] = lines(figure, HEIGHTS, "--")
    np.testing.assert_array_equal(wanted.get_ydata(), HEIGHT)


def test_the_gnss_panels_show_the_error_along_each_axis_with_its_sign(tmp_path):
    figure = drawn(tmp_path, vehicles=2)
    times, error = gnss_error(open_run(tmp_path / "run"))
    # The receiver is 1 m too far north, 2 m too far east and 3 m too high: GNSS_ERROR, whose z is down.
    for panel, expected in zip(GNSS, (1.0, 2.0, 3.0), strict=True):
        found = [line for line in lines(figure, panel) if len(line.get_xdata()) > 2]
        assert len(found) == 2
        for line in found:
            np.testing.assert_array_equal(line.get_xdata(), times)
            np.testing.assert_allclose(np.broadcast_to(line.get_ydata(), len(error)), expected, rtol=1e-9)
    assert [figure.axes[panel].get_ylabel() for panel in GNSS] == ["north [m]", "east [m]", "up [m]"]


def test_many_vehicles_have_median_and_range(tmp_path):
    figure = drawn(tmp_path, vehicles=30)
    for panel, expected in zip(GNSS, (1.0, 2.0, 3.0), strict=True):
        [line] = [line for line in lines(figure, panel) if len(line.get_xdata()) > 2]
        np.testing.assert_allclose(line.get_ydata(), expected)
    [with_gusts], [mean] = lines(figure, WIND), lines(figure, WIND, ":")
    np.testing.assert_allclose(with_gusts.get_ydata(), 13.0)
    np.testing.assert_allclose(mean.get_ydata(), 5.0)
    assert not figure.legends
    assert {str(i) for i in range(30)} <= texts(figure, PLAN)


def test_few_vehicles_are_named(tmp_path):
    figure = drawn(tmp_path, vehicles=5)
    [legend] = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [f"v{i}" for i in range(5)]
    colours = {
        line.get_color() if isinstance(line.get_color(), str) else tuple(line.get_color())
        for line in legend.get_lines()
    }
    assert len(colours) == 5


def test_a_crash_is_marked_where_and_when_it_was(tmp_path):
    figure = drawn(tmp_path, stops={1: 25})
    run = open_run(tmp_path / "run")
    [place] = crosses(figure, PLAN)
    assert place.get_xdata() == run["truth"]["position_ned.y"][25, 1]
    assert place.get_ydata() == run["truth"]["position_ned.x"][25, 1]
    [moment] = crosses(figure, HEIGHTS)
    assert moment.get_xdata() == pytest.approx([25 * STEP])
    assert "1 stopped (X)" in figure.get_suptitle()
    # Its height ends there.
    thick = [line for line in lines(figure, HEIGHTS) if line.get_linewidth() > 1]
    ends = [np.isfinite(line.get_ydata()).sum() for line in thick]
    assert ends == [60, 26]


def test_no_crash_no_cross(tmp_path):
    figure = drawn(tmp_path)
    assert crosses(figure, PLAN) == crosses(figure, HEIGHTS) == []
    assert figure.get_suptitle() == "made_up, seed 5: 2 vehicles, 1.18 s"


def test_the_wind_arrow_points_along_the_air(tmp_path):
    figure = drawn(tmp_path)
    figure.canvas.draw()
    [arrow] = [text for text in figure.axes[PLAN].texts if text.get_text() == ""]
    tip, tail = arrow.xycoords.transform(arrow.xy), arrow.anncoords.transform(arrow.xyann)
    # 3 m/s to the north and 4 to the east, whatever the shape of the axes; and the arrow is below them, over nothing.
    assert np.arctan2(tip[0] - tail[0], tip[1] - tail[1]) == pytest.approx(np.arctan2(4, 3))
    box = figure.axes[PLAN].get_window_extent()
    assert box.x0 < tail[0] < tip[0] < box.x1
    assert 0.0 < tail[1] < tip[1] < box.y0
    assert "mean wind 5.0 m/s" in texts(figure, PLAN)


def test_what_is_not_there_has_no_panel_and_no_word(tmp_path):
    figure = drawn(tmp_path, wind=0.0, sensors=())
    assert len(figure.axes) == 2
    assert texts(figure, PLAN) == texts(figure, HEIGHTS) == set()
    for panel in (PLAN, HEIGHTS):
        assert "thin" not in figure.axes[panel].get_title()


@pytest.mark.parametrize(
    ("end", "said"),
    [
        ("interrupted", "interrupted at 1.18 s"),
        ("failed", "failed at 1.18 s"),
        ("running", "still running or killed, drawn up to 1.18 s"),
    ],
)
def test_the_title_says_how_the_run_ended(end, said, tmp_path):
    assert drawn(tmp_path, end=end).get_suptitle().endswith(said)


@pytest.mark.parametrize("written", [("truth",), ("commands", "wind")])
def test_a_run_killed_in_the_middle_of_a_flush_is_drawn_up_to_what_all_streams_have(written, tmp_path):
    figure = drawn(tmp_path, killed_after=written)
    assert figure.get_suptitle().endswith("drawn up to 0.58 s")
    for panel in (HEIGHTS, WIND):
        assert {len(line.get_xdata()) for line in lines(figure, panel)} == {30}


def test_nothing_recorded_is_an_error_in_words(tmp_path):
    run = open_run(write_flight(tmp_path / "run", ticks=0, end="running"))
    with pytest.raises(RunError, match=r"run: nothing to draw, because no tick was recorded \(state: running\)"):
        save_figure(run, tmp_path / "figure.png")
    assert not (tmp_path / "figure.png").exists()


# ---------------------------------------------------------------- surroundings, long and large runs

BOX = "{type: box, x_min: -10.0, x_max: 20.0, y_min: -5.0, y_max: 45.0, z_min: -50.0, z_max: 0.0}"


def outlines(axes: Any) -> list[Any]:
    return [item.get_xy() for item in axes.get_children() if isinstance(item, Polygon) and item.get_label() == "area"]


def test_an_area_that_the_flight_fills_is_drawn_whole(tmp_path):
    figure = drawn(tmp_path, scenario_yaml=f"world: {{area: {BOX}}}\n")
    [corners] = outlines(figure.axes[PLAN])
    assert {tuple(corner) for corner in corners} == {(-5.0, -10.0), (-5.0, 20.0), (45.0, 20.0), (45.0, -10.0)}
    (west, east), (south, north) = figure.axes[PLAN].get_xlim(), figure.axes[PLAN].get_ylim()
    assert west < -5.0 < 45.0 < east
    assert south < -10.0 < 20.0 < north


@pytest.mark.long
def test_of_a_large_area_the_flight_is_drawn_and_the_size_is_said(tmp_path):
    corners = "[[-900.0, -900.0], [900.0, -900.0], [900.0, 1100.0]]"
    area = f"{{type: polygon, corners_ned: {corners}, z_min: -50.0, z_max: 0.0}}"
    obstacle = "{type: cylinder, x: 3.0, y: 4.0, radius: 2.0, z_min: -9.0, z_max: 0.0}"
    figure = drawn(tmp_path, scenario_yaml=f"world: {{area: {area}, obstacles: [{obstacle}]}}\n")
    plan = figure.axes[PLAN]
    west, east = plan.get_xlim()
    assert -100 < west < east < 130
    assert plan.get_title().endswith("part of the area of 2000 x 1800 m")
    [mast] = [item for item in plan.get_children() if isinstance(item, Circle)]
    assert (mast.center, mast.radius) == ((4.0, 3.0), 2.0)


def test_a_long_line_is_drawn_as_mean_and_range_and_loses_no_extreme(tmp_path):
    time = np.arange(50_000) * 0.02
    values = np.sin(time)[:, None]
    values[12_345] = 9.0
    values[40_000:40_400] = np.nan
    bins = binned(time, values)
    assert len(bins.time) == 400
    assert np.nanmax(bins.high) == 9.0
    # 125 ticks a bin: the peak is in bin 98; bins 320 to 322 have no value at all.
    assert np.flatnonzero(bins.high[:, 0] == 9.0).tolist() == [98]
    assert np.isnan(bins.mean[320:323]).all()
    assert bins.mean[0, 0] == pytest.approx(np.mean(np.sin(time[:125])))
    assert bins.low[0, 0] == 0.0


def test_a_thinned_path_keeps_its_corners():
    # A square of 10 m flown around 50 times, with a spike and a gap.
    along = np.arange(100_000) / 500.0
    side, part = along.astype(int) % 4, along % 1.0
    north = np.choose(side, [part, 1.0 + 0 * part, 1.0 - part, 0 * part])
    east = np.choose(side, [0 * part, part, 1.0 + 0 * part, 1.0 - part])
    points = 10.0 * np.stack([north, east], axis=1)
    points[777] = 50.0, -50.0
    points[5000:5100] = np.nan
    rows = path_rows(points, 4000)
    assert len(rows) <= 4004
    assert {0, 777, 99_999} <= set(rows.tolist())
    far = points[rows]
    # Each of the 200 corners is there to 3 cm: 100 ticks of 2 cm a bin, in which it is an extreme.
    for corner in range(500, 100_000, 500):
        if not 5000 <= corner < 5100:
            assert np.nanmin(np.linalg.norm(far - points[corner], axis=1)) < 0.03


def test_a_thousand_vehicles_are_one_collection_of_paths(tmp_path):
    figure = drawn(tmp_path, vehicles=200, ticks=20)
    [paths] = [item for item in figure.axes[PLAN].collections if isinstance(item, LineCollection)]
    assert len(paths.get_segments()) == 200
    assert len(figure.axes[HEIGHTS].lines) == 2


@pytest.mark.long
@pytest.mark.parametrize(
    ("scenario", "task"), [("plume_mapping/3C", "plume_mapping"), ("search_and_rescue/2A", "search")]
)
def test_persons_sources_and_places_are_those_of_the_flight(scenario, task, tmp_path):
    flown = load_scenario(scenario, ["duration=2.0"])
    fly(flown, tmp_path / "run", seed=3, precision="float32")
    around = surroundings_of(open_run(tmp_path / "run"))
    simulation = Simulation(flown.world(), seed=3)
    simulation.reset()
    assert (around.task, around.unknown) == (task, "")
    contents = simulation.state.contents
    if task == "search":
        there = np.asarray(contents.persons.there)
        np.testing.assert_allclose(around.persons[:, 0], np.asarray(contents.persons.north)[there], rtol=1e-6)
        assert np.isinf(around.found).all()
        assert "task search: 0 of" in draw_run(open_run(tmp_path / "run")).get_suptitle()
        return
    strong = np.asarray(contents.plume.strength) > 0
    np.testing.assert_allclose(around.sources[:, 0], np.asarray(contents.plume.position_ned.x)[strong], rtol=1e-6)
    play = Play(flown.task(), flown.world(), flown.steps)
    episode, _ = jax.jit(play.reset)(play.keys(Key.root(3, 0)))
    places = episode.memory.locations_ned
    np.testing.assert_allclose(around.locations, np.stack([places.x, places.y, places.z], axis=1), rtol=1e-5)
    assert around.plume is not None
    assert around.plume.values.max() > 0


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("vehicles", [1, 30])
def test_png_has_a_sensible_size(vehicles, tmp_path):
    run = open_run(write_flight(tmp_path / "run", vehicles=vehicles))
    save_figure(run, tmp_path / "figure.png")
    width, height = png_size(tmp_path / "figure.png")
    assert 1200 <= width <= 1600
    assert 800 <= height <= 1200
    # An empty canvas of this size has about 5 kB.
    assert 20_000 < (tmp_path / "figure.png").stat().st_size < 2_000_000
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(("ending", "start"), [("pdf", b"%PDF-"), ("SVG", b"<?xml")])
def test_other_formats(ending, start, tmp_path):
    save_figure(open_run(write_flight(tmp_path / "run")), tmp_path / f"figure.{ending}")
    assert (tmp_path / f"figure.{ending}").read_bytes().startswith(start)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("figure.pgn", r"figure\.pgn: cannot draw '\.pgn'; did you mean 'png'\?"),
        ("figure.xyz", r"figure\.xyz: cannot draw '\.xyz'; known: png, pdf, svg"),
        ("figure", r"figure: the name of a picture needs an ending; known: png, pdf, svg"),
    ],
)
def test_unknown_endings(name, message, tmp_path):
    with pytest.raises(UsageError, match=message):
        save_figure(open_run(write_flight(tmp_path / "run")), tmp_path / name)


def test_a_figure_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    run = open_run(write_flight(tmp_path / "run"))
    (tmp_path / "figure.png").write_bytes(b"old")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(RunError, match=r"cannot write .*figure\.png: No space left on device"):
        save_figure(run, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes() == b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figure.png", "run"]


@pytest.mark.long
def test_drawing_needs_no_display_and_no_pyplot():
    program = "import sys, qrsim.runs.figure; print('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


JAMMING = """world:
  area: {type: box, x_min: -40, x_max: 60, y_min: -40, y_max: 60, z_min: -50, z_max: 0}
  interference:
    - {kind: jammer, position_ned: [10, 20, -2], power_w: 1.0e-4, band: wide, start: 0.2, end: 0.8}
    - {kind: disc, position_ned: [-20, 5, 0], radius: 30, start: 0.0, end: null}
    - {kind: spoofer, position_ned: [0, 0, 0], radius: null, start: 0.4, end: null, vehicles: null}
    - {kind: outage, systems: R, satellites: null, start: 0.6, end: null}
"""


def test_what_interferes_is_drawn_where_and_said_when(tmp_path):
    """From 45 dB-Hz, 10 mW end tracking within 715 m (docs/howto/jam_and_spoof.md), 0.1 mW within a tenth of that."""
    figure = drawn(tmp_path, scenario_yaml=JAMMING)
    plan = figure.axes[PLAN]
    signs = {line.get_label(): line.get_xydata()[0].tolist() for line in plan.lines if line.get_marker() in "DXP"}
    jammer = next(label for label in signs if label.startswith("jammer 100 uW, 0.2 to 0.8 s: lost within 7"))
    assert signs[jammer] == [20.0, 10.0]
    assert signs["no satellites: lost within 30 m"] == [5.0, -20.0]
    # A spoofer that is heard everywhere has no place.
    assert len(signs) == 2
    circles = {circle.get_center(): circle.get_radius() for circle in plan.get_children() if isinstance(circle, Circle)}
    assert circles[5.0, -20.0] == 30.0
    assert circles[20.0, 10.0] == pytest.approx(71.5, rel=0.02)
    assert len(circles) == 2
    spans = list(figure.axes[EAST].patches)
    assert [round(patch.get_x(), 3) for patch in spans] == [0.2, 0.0, 0.4, 0.6]
    assert spans[0].get_width() == pytest.approx(0.6)
    assert texts(figure, NORTH) >= {"jammer 100 uW", "no satellites", "spoofer", "outage of R"}


def test_no_line_is_drawn_between_fixes_before_and_after_a_loss(tmp_path):
    def lose(values: dict[str, Any]) -> None:
        for axis in "xyz":
            values["measurements"][f"gnss.position_ned.{axis}"][20:40] = np.nan

    figure = drawn(tmp_path, change=lose)
    for line in lines(figure, NORTH)[1:]:
        east = np.asarray(line.get_ydata())[np.asarray(line.get_xdata()) == 20 * STEP]
        assert np.isnan(east).all()
        assert len(east)


def test_crosses_are_where_a_set_point_stays_and_nowhere_on_its_way():
    places = [[0.0, 0.0, -5.0]] * 3 + [[float(i), 2.0, -5.0] for i in range(5)] + [[9.0, 9.0, -5.0]] * 2
    np.testing.assert_array_equal(held_places(np.array(places)), [[0.0, 0.0], [9.0, 9.0]])
    assert held_places(np.array(places)[3:8]).shape == (0, 2)
