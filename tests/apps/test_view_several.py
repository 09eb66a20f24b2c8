"""Several runs over each other: what fits is shown, and one line tells what does not."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.apps.conftest import Flight

from qrsim.errors import UsageError
from qrsim.runs import open_run
from qrsim.view import film
from qrsim.view.differences import pairs_of
from qrsim.view.layers import Stage
from qrsim.view.plots import Plots
from qrsim.view.several import Several, open_several

# Of a degree of latitude at the default site, of WGS-84's meridian [m].
DEGREE_M = 111_262.0


@pytest.fixture(scope="module")
def other(fly: Callable[..., Flight]) -> Path:
    """Another seed of the default scenario, shorter."""
    return fly("--seed", "4", "--duration", "9").folder


@pytest.fixture(scope="module")
def both(flown: Flight, other: Path) -> Several:
    found, lines = open_several([flown.folder, other], open_run)
    assert lines == []
    assert isinstance(found, Several)
    return found


@pytest.fixture
def copy(other: Path, tmp_path: Path) -> Path:
    """A copy of the other run, to be changed."""
    return Path(shutil.copytree(other, tmp_path / "copy"))


def scenario(folder: Path, **changes: Any) -> None:
    """Change entries of a recorded scenario."""
    path = folder / "scenario.yaml"
    content = yaml.safe_load(path.read_text("utf-8"))
    for name, value in changes.items():
        content[name] = {**content[name], **value} if isinstance(value, dict) else value
    path.write_text(yaml.safe_dump(content), "utf-8")


def test_all_vehicles_are_in_one_frame(both: Several, flown: Flight, other: Path):
    assert both.cast.names[0::5] == ("A pelicans_0", "B pelicans_0")
    assert both.end == 10.0
    first, second = (open_run(folder)["truth"] for folder in (flown.folder, other))
    frame = both.frame(2.0)
    assert frame.time == pytest.approx(2.0)
    np.testing.assert_array_equal(frame.position_ned[:5, 0], first["position_ned.x"][100].astype(np.float32))
    np.testing.assert_array_equal(frame.position_ned[5:, 0], second["position_ned.x"][100].astype(np.float32))
    # Each run has its own estimates; wind is that of the first run alone.
    fix = open_run(other)["measurements"]["gnss.position_ned.x"][100].astype(np.float32)
    np.testing.assert_array_equal(frame.ghost_ned[5:, 0], fix)
    np.testing.assert_array_equal(frame.estimate_ned[5:, 0], fix)
    assert np.isnan(frame.wind_ned[5:]).all()
    assert frame.details is not None
    believed = open_run(other)["commands"]["estimate.position_ned.x"][100].astype(np.float32)
    np.testing.assert_array_equal(frame.details().believed_ned[5:, 0], believed)
    # The shorter one stays where it ended.
    last = second["position_ned.x"][-1].astype(np.float32)
    np.testing.assert_array_equal(both.frame(9.5).position_ned[5:, 0], last)
    assert [event.time for event in both.events if event.kind == "run_ends"] == [9.0]
    assert np.shape(both.positions(np.array([0.0, 5.0]))) == (2, 10, 3)


def test_colours_and_lines_are_of_the_runs(both: Several):
    stage = Stage(None, both.cast, 1.0)  # type: ignore[arg-type]
    assert stage.hues.tolist() == [0] * 5 + [1] * 5
    assert pairs_of(stage) == [(i, i + 5) for i in range(5)]


def test_distances_between_runs_can_be_plotted(both: Several, flown: Flight, other: Path):
    plots = Plots(both)
    time, values = plots._series[1].values("derived.run_distance")
    first, second = (open_run(folder)["truth"] for folder in (flown.folder, other))
    apart = [second[f"position_ned.{axis}"][150] - first[f"position_ned.{axis}"][150] for axis in "xyz"]
    assert time[150] == pytest.approx(3.0)
    np.testing.assert_allclose(values[150], np.linalg.norm(apart, axis=0), rtol=1e-4)
    about: Any = plots.about()
    assert about["runOf"] == [0] * 5 + [1] * 5
    # The first run has no such distance.
    assert "derived.run_distance" not in plots._series[0].quantities


def test_runs_are_aligned_at_an_event(flown: Flight, other: Path):
    kind = "waypoint_reached"
    first, second = (
        next(event.time for event in open_run(run).events if event.kind == kind) for run in (flown.folder, other)
    )
    assert first < second
    found, lines = open_several([flown.folder, other], open_run, kind)
    assert isinstance(found, Several)
    assert [member.shift for member in found.members] == [0.0, pytest.approx(first - second)]
    # The second run has flown for so long when the first begins.
    begun = found.members[1].recording.frame(second - first).position_ned
    np.testing.assert_array_equal(found.frame(0.0).position_ned[5:], begun)
    assert lines[0].endswith("are before the start of the first run and are not shown; name it first to see them")
    with pytest.raises(UsageError, match=r"--align waypoint_reachd: no such event in .*; did you mean 'waypoint_rea"):
        open_several([flown.folder, flown.folder], open_run, "waypoint_reachd")
    with pytest.raises(UsageError, match="--align take-off: no vehicle takes off in "):
        open_several([flown.folder, other], open_run, "take-off")
    with pytest.raises(UsageError, match="--align stop: no vehicle stops in "):
        open_several([flown.folder, other], open_run, "stop")


def test_what_does_not_fit_is_told(flown: Flight, copy: Path):
    run = copy / "run.json"
    run.write_text(
        run.read_text("utf-8").replace('"outdoor_patrol"', '"<b>other</b>"', 1).replace('"0.2.0"', '"0.1.0"')
    )
    scenario(copy, site={"latitude_deg": 51.7129})
    found, lines = open_several([flown.folder, copy], open_run)
    version = open_run(flown.folder).info.versions["qrsim"]
    assert lines == [
        f"B ({copy}): scenario '<b>other</b>'; area and wind are those of 'outdoor_patrol'",
        f"B ({copy}): recorded by qrsim 0.1.0, the first run by {version}",
        f"B ({copy}): its origin is 111.3 m from that of the first run; it is drawn there",
    ]
    # A thousandth of a degree to the north.
    moved = found.frame(0.0).position_ned[5:] - found.frame(0.0).position_ned[:5]
    np.testing.assert_allclose(moved[:, 0], 1e-3 * DEGREE_M, atol=0.2)


def test_a_far_site_and_a_damaged_run(flown: Flight, copy: Path, tmp_path: Path):
    scenario(copy, site={"latitude_deg": 50.0})
    far, lines = open_several([flown.folder, copy], open_run)
    assert "190 km" in lines[0]
    assert "their origins lie on each other" in lines[0]
    np.testing.assert_allclose(far.frame(0.0).position_ned[5:], far.frame(0.0).position_ned[:5], atol=0.01)
    shutil.rmtree(copy / "truth")
    found, lines = open_several([flown.folder, copy], open_run)
    assert found.cast.names[0] == "pelicans_0"
    assert lines[0].startswith("not shown: ")
    assert "is missing" in lines[0]


def test_a_damaged_stream_of_estimates_leaves_the_vehicles(copy: Path):
    for part in sorted((copy / "commands").glob("part-*.parquet")):
        part.write_bytes(b"damaged")
    found, lines = open_several([copy], open_run)
    assert lines == []
    details = found.frame(2.0).details
    assert details is not None
    with pytest.warns(UserWarning, match=r"estimates are not shown: .*commands.part-.* cannot be read"):
        shown = details()
    assert np.isnan(shown.believed_ned).all()
    assert np.isfinite(shown.velocity_ned).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["view"], "RUN"),
        (["view", "{run}", "--align", "stop"], "--align stop: only for several runs"),
        (["view", *["{run}"] * 7], "7 runs: expected at most 6"),
        (["view", "{run}", "nowhere"], "no run at nowhere: there is no such folder"),
    ],
)
def test_refused(words: list[str], said: str, flown: Flight, refused: Any):
    refused([word.format(run=flown.folder) for word in words], said)


def test_a_page_of_several_has_all(both: Several, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(film, "FASTEST_HZ", 0.5)
    page = film.film(both)
    assert page.count('id="qrsim-plots-') == 10
    assert '"runs": ["run A (run, seed 3)", "run B (run, seed 4)"]' in page
