"""Write docs/images/view_FAMILY.png, a family's 3-D page each: ``python -m evidence.pictures [FAMILY ...]``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from qrsim.errors import QrsimError, UsageError, did_you_mean

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
SECONDS, CHUNK, SEED = 12.0, 10, 1
SWARM, SWARM_SIZE = "swarm", 1000


def families() -> dict[str, Any]:
    """Return the first scenario of each family of built-in ones, and a swarm."""
    from evidence.view import patrol
    from qrsim.scenarios.reading import built_in_names

    found: dict[str, Any] = {}
    for name in sorted(built_in_names()):
        found.setdefault(name.partition("/")[0], name)
    return {**found, SWARM: patrol(SWARM_SIZE)}


def write(family: str, source: Any, output: Path = IMAGES) -> Path:
    """Fly a scenario for some seconds and write its picture; return where it is.

    Raises:
        RunError: there is no browser.
    """
    from qrsim.scenarios.scenario import load_scenario
    from qrsim.simulation import Simulation
    from qrsim.view.frame import cast_of, frame_of
    from qrsim.view.picture import photograph
    from qrsim.view.scene import Scene
    from qrsim.view.server import start_server

    scenario = load_scenario(source)
    simulation = Simulation(scenario.world(), seed=SEED, name=scenario.name, site=scenario.site)
    simulation.reset()
    server = start_server(0)
    try:
        scene = Scene(server, cast_of(simulation.world, simulation.truth.position_ned), simulation.world)
        scene.draw(frame_of(simulation.state, 0.0))
        while simulation.time < SECONDS:
            simulation.advance(ticks=CHUNK)
            scene.draw(frame_of(simulation.state, simulation.time))
        scene.draw(frame_of(simulation.state, simulation.time), everything=True)
        picture = photograph(server, f"{scenario.name}, {scene.cast.size} vehicle(s), {simulation.time:.0f} s")
    finally:
        server.stop()
    path = output / f"view_{family}.png"
    path.write_bytes(picture)
    return path


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
    known = families()
    return write_named(names, "scenarios", known, lambda name: write(name, known[name]))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
