"""What a task is about, in a recorded run, in its figure and on the page: goals, sources, places asked for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.view.test_scene import PLACES, cast

import qrsim
from qrsim.runs.figure import draw_run
from qrsim.runs.recorder import fly
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks.places import Places
from qrsim.view.layers import Stage
from qrsim.view.recording import Recording
from qrsim.view.scene import Scene
from qrsim.view.server import start_server
from qrsim.view.task import Goals, Locations, Sources, task_layers


class Looking:
    """Stands for a page that is told of a flight."""

    def __init__(self) -> None:
        self.places: Any = None
        self.notes: list[str] = []

    def begin(self, simulation: Any, title: str, places: Any = None) -> None:
        self.places = places

    def note(self, text: str) -> None:
        self.notes.append(text)

    def offer(self, history: Any) -> None:
        pass

    def change(self, simulation: Any) -> None:
        pass

    def wait(self, ticks: int) -> int:
        return ticks


def recorded(folder: Path, name: str, seconds: float) -> tuple[Any, Places]:
    page = Looking()
    scenario = load_scenario(name, [f"duration={seconds}"])
    fly(scenario, folder / "run", seed=3, precision="float32", view=page)
    return qrsim.open_run(folder / "run"), page.places


def test_a_page_says_that_programs_are_compiled_until_the_first_tick(tmp_path: Path) -> None:
    page = Looking()
    fly(load_scenario("hover_ideal", ["duration=0.1"]), tmp_path / "run", seed=3, precision="float32", view=page)
    assert page.notes == ["The vehicles stand still until their programs are compiled.", ""]


def marks(run: Any) -> dict[str, np.ndarray]:
    """Return what the plan of a run's figure shows at places: label -> north and east."""
    axes = draw_run(run).axes[0]
    return {str(line.get_label()): np.stack([line.get_ydata(), line.get_xdata()], axis=-1) for line in axes.lines}


def test_the_goal_of_a_waypoint_is_drawn_before_anybody_is_there(tmp_path: Path) -> None:
    """The scenario's waypoint, 50 m to the south and west at the height of the start."""
    run, live = recorded(tmp_path, "goto_waypoint", 0.4)
    recording = Recording(run)
    for places in (live, recording.cast.places):
        assert places is not None
        np.testing.assert_allclose(places.goals, [[-50.0, -50.0, -10.0]])
        assert not len(places.sources)
    # It is seen from the first view on, 50 m and more away.
    assert recording.cast.extent > 70.0
    np.testing.assert_allclose(marks(run)["goal of the task"], [[-50.0, -50.0]])


@pytest.mark.long
def test_the_goal_of_who_keeps_a_place_is_where_each_began(tmp_path: Path) -> None:
    run, live = recorded(tmp_path, "keep_spot_10", 0.2)
    # North of the ten, from its scenario.
    north = np.arange(-80.0, 101.0, 20.0)
    np.testing.assert_allclose(live.goals, [[each, 0.0, -10.0] for each in north], atol=1e-4)
    np.testing.assert_allclose(marks(run)["goal of the task"][:, 0], north, atol=1e-4)


@pytest.mark.long
def test_a_page_and_a_recording_have_the_same_sources_and_locations(tmp_path: Path) -> None:
    run, live = recorded(tmp_path, "plume_mapping/3B", 1.0)
    after = Recording(run).cast.places
    assert after is not None
    assert live.sources.shape == (1, 3)
    assert live.locations.shape == (100, 3)
    np.testing.assert_allclose(after.sources, live.sources)
    np.testing.assert_allclose(after.locations, live.locations)
    np.testing.assert_allclose(marks(run)["asked for by the task"], live.locations[:, :2])


def test_without_a_task_there_are_none(tmp_path: Path) -> None:
    run, live = recorded(tmp_path, "hover_ideal", 0.2)
    assert live is None
    assert Recording(run).cast.places is None


@pytest.fixture
def stage() -> Iterator[Any]:
    server = start_server(0)
    yield Stage(server.scene, cast(PLACES), 2.0)
    server.stop()


def test_there_is_a_layer_for_each_kind_of_place(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    added: dict[str, Any] = {}
    words: dict[str, Any] = {}
    fake = SimpleNamespace(
        add_frame=lambda path, **options: SimpleNamespace(visible=True),
        add_batched_meshes_simple=lambda path, corners, faces, **options: added.update({path: (corners, options)}),
        add_label=lambda path, text, position: words.update({path: (text, position)}),
    )
    monkeypatch.setattr(stage, "scene", fake)
    places = Places(np.array([[1.0, 2.0, -3.0]]), np.array([[4.0, 5.0, 0.0], [6.0, 7.0, 0.0]]), PLACES)
    layers = task_layers(stage, places)
    assert [type(layer) for layer in layers] == [Goals, Sources, Locations]
    goals, sources, locations = (added[f"/world/{name}/marks"] for name in ("goals", "sources", "locations"))
    np.testing.assert_array_equal(goals[1]["batched_positions"], [[1.0, 2.0, -3.0]])
    np.testing.assert_array_equal(locations[1]["batched_positions"], PLACES)
    # Of 1, times 1.4, 1 and 0.15 spans of 2 m.
    assert [part[1]["batched_scales"][0, 0] for part in (goals, sources, locations)] == pytest.approx([2.8, 2.0, 0.3])
    for corners, _ in (goals, sources, locations):
        np.testing.assert_allclose(np.ptp(corners, axis=0), 1.0)
    # Over the goal.
    assert words == {"/world/goals/words0": ("goal", (1.0, 2.0, -6.0))}
    words.clear()
    task_layers(stage, Places(np.zeros((4, 3))))
    assert not words
    assert task_layers(stage, None) == task_layers(stage, Places()) == []


def test_a_scene_can_hide_them_and_its_legend_names_them(stage: Stage) -> None:
    server = start_server(0)
    people = cast(PLACES)
    seen = Scene(server, type(people)(people.names, people.fleets, people.start_ned, places=Places(PLACES + 1.0)), None)
    assert "goals" in seen.layers
    assert "sources" not in seen.layers
    assert "cross: goal of the task" in [row["text"] for row in seen.overlay._data["legend"]]
    seen.show("goals", False)
    assert not seen.layers["goals"].root.visible
    server.stop()
