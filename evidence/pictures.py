"""Write docs/images/view_FAMILY.png, a family's 3-D page each: ``python -m evidence.pictures [FAMILY ...]``.

Whose task has a baseline is flown by it.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from qrsim.errors import QrsimError, UsageError, did_you_mean

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
CHUNK = 10


@dataclass(frozen=True)
class Shot:
    """What is photographed.

    Attributes:
        scenario: name of a built-in one, or number of vehicles of a larger default one.
        seconds: how long it has flown.
        seed: of the flight.
        chosen: name of the vehicle that is looked at; None: all are.
        distance: from there [m]; None: that of a page.
        size: of the drawn vehicles [m]; None: that of a page.
        direction: from there to the camera, NED.
    """

    scenario: str | int
    seconds: float
    seed: int = 1
    chosen: str | None = None
    distance: float | None = None
    size: float | None = None
    direction: tuple[float, float, float] | None = None


SHOTS = {
    "outdoor_patrol": Shot("outdoor_patrol", 10.0, distance=105.0),
    "keep_spot": Shot("keep_spot", 20.0, chosen="pelicans_0", distance=10.0),
    "cats_and_mouse": Shot("cats_and_mouse/1B", 30.0, chosen="mouse", distance=70.0, direction=(-0.5, -0.45, -0.75)),
    "plume_mapping": Shot("plume_mapping/3C", 90.0, seed=2),
    "search_and_rescue": Shot("search_and_rescue/2D", 61.0, chosen="helicopters_1", distance=34.0, size=3.0),
    "swarm": Shot(1000, 30.0, distance=1300.0, direction=(-0.8, -0.1, -0.55)),
}


def write(family: str, output: Path = IMAGES) -> Path:
    """Fly for some seconds, and write the picture; return where it is.

    Raises:
        RunError: there is no browser.
    """
    from PIL import Image

    from qrsim.view.frame import cast_of, frame_of
    from qrsim.view.overlay import SOUTH
    from qrsim.view.picture import photograph
    from qrsim.view.scene import Scene
    from qrsim.view.server import start_server

    shot = SHOTS[family]
    simulation, advance = _flight(shot)
    server = start_server(0)
    try:
        scene = Scene(server, cast_of(simulation.world, simulation.truth.position_ned), simulation.world)
        scene.draw(frame_of(simulation.state, 0.0, simulation.world))
        while simulation.time < shot.seconds:
            advance()
            scene.draw(frame_of(simulation.state, simulation.time, simulation.world))
        middle = scene.cast.centre
        if shot.chosen is not None:
            vehicle = simulation.vehicle_names.index(shot.chosen)
            scene.choose(vehicle)
            scene.overlay.choose(vehicle)
            middle = simulation.truth.position_ned[vehicle]
        if shot.distance is not None:
            scene.look(middle, shot.distance, shot.direction or SOUTH)
        if shot.size is not None:
            scene.resize(shot.size)
        scene.draw(frame_of(simulation.state, simulation.time, simulation.world), everything=True)
        count = f"{scene.cast.size} vehicle{'s' if scene.cast.size > 1 else ''}"
        picture = photograph(server, f"{simulation.name}, {count}, {simulation.time:.0f} s")
    finally:
        server.stop()
    path = output / f"view_{family}.png"
    # With 256 colours a file has a third of the size; with fewer, few vehicles would lose theirs.
    Image.open(io.BytesIO(picture)).quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def _flight(shot: Shot) -> tuple[Any, Callable[[], Any]]:
    """Return a simulation at its start, and what advances it."""
    from evidence.view import patrol
    from qrsim.apps.run.baseline import baseline_policy
    from qrsim.scenarios.scenario import load_scenario
    from qrsim.simulation.pilot import Pilot
    from qrsim.simulation.simulation import Simulation

    scenario = load_scenario(patrol(shot.scenario) if isinstance(shot.scenario, int) else shot.scenario)
    simulation = Simulation(scenario.world(), seed=shot.seed, name=scenario.name, site=scenario.site)
    simulation.reset()
    try:
        policy, ticks = baseline_policy(scenario, shot.seed, "float32")
    except UsageError:
        # Without a task, or with one that has no baseline, they fly by themselves.
        return simulation, lambda: simulation.advance(ticks=CHUNK)
    pilot = Pilot(simulation, policy, None, ticks)
    return simulation, lambda: pilot.record(CHUNK)


def write_named(names: Sequence[str], kind: str, known: Collection[str], draw: Callable[[str], Path]) -> int:
    """Write the named pictures, all that are known where none is named; return the exit code."""
    try:
        for name in names:
            if name not in known:
                raise UsageError(f"no family of {kind} '{name}'{did_you_mean(name, known)}")
        for name in names or known:
            print(draw(name))
    except QrsimError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def main(names: Sequence[str]) -> int:
    """Write the named pictures of the page; return the exit code."""
    return write_named(names, "scenarios", SHOTS, write)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
