"""Recordings of ``qrsim mavlink``: flown again to the bit, with injections and vehicles that are put back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from qrsim.cli import main
from qrsim.errors import RunError
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.stack.contracts import NAN, Command
from qrsim.links.mavlink.stack.stacks import stack_of
from qrsim.links.mavlink.world import FlownWorld
from qrsim.runs import open_run
from qrsim.scenarios.scenario import load_scenario

# Above the site, which is 488 m high [m].
HEIGHT = 494.0


class Recorded:
    """The scenario mavlink_field, whose parts may all fail, recorded."""

    def __init__(self, folder: Path):
        scenario = prepared(load_scenario("mavlink_field"), ["all"])
        self.world = FlownWorld(scenario, stack_of(), seed=5, respawn=True, record=folder)
        for system in self.world.systems:
            system.stack.parameters.set("SYS_FAILURE_EN", 1.0)  # type: ignore[union-attr]

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.world.tick(0.0)

    def command(self, number: int, id: int, *params: float) -> int:
        numbers = (*map(float, params), *[NAN] * (7 - len(params)))
        return int(self.world.systems[number].stack.command(Command(id, numbers)).result)  # type: ignore[union-attr, arg-type]

    def take_off(self, number: int) -> None:
        assert self.command(number, 400, 1) == 0
        assert self.command(number, 22, *[NAN] * 6, HEIGHT) == 0


@pytest.mark.long
def test_a_flight_is_flown_again_to_the_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    field = Recorded(tmp_path / "flights")
    simulation, recording = field.world.simulation, field.world.recording
    assert recording is not None
    field.run(2.0)
    field.take_off(0)
    field.take_off(1)
    field.run(4.0)
    # Off: the receivers of vehicle 1, and the motors of vehicle 0, which falls and is put back.
    assert field.command(1, 420, 4, 1, 1) == 0
    assert field.command(0, 420, 101, 1, 0) == 0
    field.run(2.5)
    assert simulation.reasons[0].startswith("crashed")
    # A reboot in the tick of another request waits for the next tick.
    assert field.command(2, 420, 3, 2, 0) == 0
    field.world.systems[0].reboots = True
    field.run(0.02)
    assert simulation.reasons[0].startswith("crashed")
    assert field.command(0, 420, 101, 0, 0) == 0
    field.run(0.04)
    assert simulation.reasons[0] == ""
    field.run(1.0)
    field.take_off(0)
    field.run(3.0)
    # Another episode is another run folder.
    field.world.reset(6)
    field.run(0.5)
    recording.close()
    first, second = sorted(path for path in recording.folder.iterdir() if path.is_dir())
    run = open_run(first)
    orders = run["orders"]
    put_back = [sorted(set(orders["restarted_tick"][:, row].tolist())) for row in range(5)]
    assert put_back == [[-1, 427], [-1], [-1], [-1], [-1]]
    made = [(one["target"], one["kind"], one["tick"]) for one in run.injections]
    assert made[:2] == [("gnss", "off", 300), ("rotor 0", "off", 300)]
    assert ("barometer", "stuck", 425) in made
    height = -run["truth"]["position_ned.z"]
    assert height[300, 0] > 3.0
    assert height[440, 0] == pytest.approx(0.2, abs=0.1)
    assert height[-1, 0] > 1.0
    for folder, ticks in ((first, 628), (second, 25)):
        assert main(["replay", str(folder)]) == 0
        assert f"{ticks} ticks of 5 vehicles: the same to the bit" in capsys.readouterr().out
    assert not np.array_equal(run["truth"]["position_ned.x"][:25], open_run(second)["truth"]["position_ned.x"][:25])


@pytest.mark.long
def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RunError, match="cannot create the folder"):
        Recorded(tmp_path / "file" / "flights")
