"""The air in a plane: its arrows, and that it is the air in which the vehicles flew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.runs import open_run
from qrsim.runs.recorder import fly
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.view.air import ALONG, GUST, WHOLE, Air, air_at
from qrsim.view.film import film, times_of
from qrsim.view.frame import Frame, cast_of, frame_of
from qrsim.view.page import Page
from qrsim.view.recording import Recording
from qrsim.view.scene import Scene
from qrsim.view.server import start_server
from qrsim.view.shapes import linear

SEED = 5
WIND = {"type": "log_shear", "speed_20ft": 6.0, "wind_from_deg": 250.0}


def scenario(*places: tuple[float, float, float], **world: Any) -> Scenario:
    """Return vehicles that hold their places in a wind, in a field unless said otherwise."""
    return load_scenario(
        {
            "name": "held",
            "duration": 4.0,
            "world": {"wind": WIND, "turbulence": {"type": "dryden_field"}, **world},
            "fleets": {
                "held": {
                    "controller": {"type": "cascade", "feed": "truth"},
                    "vehicles": [{"position_ned": list(place)} for place in places],
                }
            },
        },
        quiet=True,
    )


HELD = scenario((0.0, 0.0, -15.0), (70.0, 0.0, -15.0), (0.0, 20.0, -12.0))


def scene_of(world: Any, places: np.ndarray) -> Scene:
    return Scene(start_server(0), cast_of(world, places), world)


def test_arrows_are_along_the_air_and_as_long_as_it_is_fast() -> None:
    world = HELD.world()
    places = np.array([[0.0, 0.0, -15.0], [70.0, 0.0, -15.0], [0.0, 20.0, -12.0]])
    scene = scene_of(world, places)
    try:
        layer = scene.air
        assert isinstance(layer, Air)
        assert not layer.root.visible, "it is asked for"
        # 1.2 times 70 m, in 14 steps.
        assert (layer.cell, layer.height, layer.shows) == (pytest.approx(6.0), 15.0, GUST)
        mean, gust = np.tile([3.0, 0.0, 0.0], (ALONG**2, 1)), np.tile([0.0, 2.0, 0.0], (ALONG**2, 1))
        above = np.full(ALONG**2, 15.0)
        above[:ALONG] = -1.0
        asked: list[Any] = []

        def ask(*given: Any) -> Any:
            asked.append(given)
            return mean, gust, above

        layer._ask = ask  # type: ignore[assignment]
        nothing = np.zeros_like(places)
        still = Frame(0.5, places, nothing, places, places, nothing, nothing, np.ones(3, bool))
        scene.show("air in a plane", True)
        scene.draw(still)
        assert not asked, "of a world that is not known nothing is drawn"
        beside: Any = type("Beside", (), {"world": world, "drawn": (), "field": None})()
        scene.draw(replace(still, beside=beside), everything=True)
        assert int(asked[0][3]) == 25
        found = layer._handle
        # In steps of 6 m around (35, 10), the middle of the vehicles, at the height of most.
        assert found.batched_positions.mean(axis=0) == pytest.approx([36.0, 12.0, -15.0])
        assert np.ptp(found.batched_positions, axis=0) == pytest.approx([84.0, 84.0, 0.0])
        # 2 m/s reach the next arrow; none are below ground. To the east is a quarter of a turn about down.
        assert found.batched_scales[ALONG:] == pytest.approx(6.0)
        assert not found.batched_scales[:ALONG].any()
        assert found.batched_wxyzs[0] == pytest.approx([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], abs=0.005)
        scene.show_air(40.0, WHOLE)
        assert asked[-1][4][:, 2] == pytest.approx(-40.0)
        assert found.batched_scales[-1] == pytest.approx(np.hypot(3.0, 2.0) * 6.0 / 8.0, abs=0.016)
        turn = np.arctan2(2.0, 3.0)
        assert found.batched_wxyzs[-1] == pytest.approx([np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)], abs=0.005)
        assert (found.batched_colors != linear((188, 115, 43))).any(axis=1).all()
        assert layer.label == "air in a plane: gust and mean wind at 40 m"
    finally:
        scene._server.stop()


def test_the_panel_sets_height_and_content_and_hands_them_on() -> None:
    places = np.array([[0.0, 0.0, -15.0], [70.0, 0.0, -15.0], [0.0, 20.0, -12.0]])
    server = start_server(0)
    try:
        pages = [Page(server, cast_of(world, places), world, "held, seed 1", None) for world in [HELD.world()] * 2]
        height, shows = pages[0]._air or pytest.fail("no controls")
        assert (height.value, height.max, shows.options) == (15.0, 60.0, (GUST, WHOLE))
        height.value, shows.value = 30.0, WHOLE
        pages[1].adopt(pages[0])
        for page in pages:
            layer = page.scene.air
            assert layer is not None
            assert (layer.height, layer.shows) == (30.0, WHOLE)
    finally:
        server.stop()


@pytest.mark.parametrize("turbulence", ["still", "dryden"])
def test_air_without_places_of_its_own_has_no_plane(turbulence: str) -> None:
    world = scenario((0.0, 0.0, -15.0), turbulence={"type": turbulence}).world()
    scene = scene_of(world, np.array([[0.0, 0.0, -15.0]]))
    try:
        assert scene.air is None
        scene.show_air(20.0, GUST)
    finally:
        scene._server.stop()


@pytest.mark.long
@pytest.mark.parametrize(
    ("more", "updrafts"),
    [({}, []), ({"residual": "filter"}, []), ({}, [{"type": "thermals", "w_star": 9.0, "z_i": 800.0, "count": 60}])],
)
def test_a_replay_has_the_air_of_the_flight(tmp_path: Path, more: dict[str, Any], updrafts: list[Any]) -> None:
    """Where the vehicles were, it is what they met; a residual is each vehicle's own and is left out."""
    field = {"type": "dryden_field", "sweep": 0.3, **more}
    held = scenario((0.0, 0.0, -15.0), (30.0, 5.0, -25.0), turbulence=field, updrafts=updrafts)
    fly(held, tmp_path / "run", seed=SEED, precision="float32")
    recording = Recording(open_run(tmp_path / "run"))
    before, now = recording.frame(2.98), recording.frame(3.0)
    assert before.beside is not None
    # The gust of a step is that of the place from which the step begins.
    found = jax.jit(air_at)(
        before.beside.world, before.beside.drawn, before.beside.field, np.int32(149), before.position_ned
    )
    most = 0.3 if more else 1e-3
    np.testing.assert_allclose(found[0], now.wind_ned, atol=1e-3)
    np.testing.assert_allclose(found[1], now.gust_ned, atol=most)
    assert np.abs(now.gust_ned).max() > 0.2
    # The same in the live page.
    simulation = Simulation(held.world(), seed=SEED)
    simulation.reset()
    simulation.advance(ticks=149)
    live = frame_of(simulation.state, simulation.time, simulation.world)
    assert live.beside is not None
    again = jax.jit(air_at)(live.beside.world, live.beside.drawn, live.beside.field, np.int32(149), before.position_ned)
    np.testing.assert_allclose(again[1], found[1], atol=1e-4)


@pytest.mark.long
def test_a_page_without_a_server_has_it_at_so_many_times_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Air, "most_in_film", 8)
    drawn = []
    draw = Air.draw
    monkeypatch.setattr(Air, "draw", lambda self, frame: (drawn.append(frame.time), draw(self, frame))[1])
    fly(HELD, tmp_path / "run", seed=SEED, precision="float32")
    recording = Recording(open_run(tmp_path / "run"))
    page = film(recording)
    assert len(times_of(recording)) == 81
    # And the first frame.
    assert 8 <= len(drawn) <= 10
    assert '"title": "air in a plane: gust at 15 m"' in page
    assert '"path": "/world/air", "shown": false' in page
