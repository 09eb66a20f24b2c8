"""The table of commands: a file takes what one of the autopilots takes over the link, and refuses the rest."""

from __future__ import annotations

import json
from pathlib import Path

from tests.scenarios.plans.test_qgc import item, plan

from qrsim.errors import ScenarioError
from qrsim.links.mavlink.stack import plan as link
from qrsim.links.mavlink.stack.codes import PlanResult
from qrsim.links.mavlink.stack.contracts import Item
from qrsim.scenarios.plans.commands import COMMANDS, JUMP
from qrsim.scenarios.plans.reading import read_plan

WAYPOINT = 16
PLACE = (47.0005, 8.0, 20.0)
# VTOL, guided mode, payloads, a change of altitude, modes, parachutes, limits, and starting the mission itself.
REFUSED = {84, 85, 92, 94, 113, 176, 208, 222, 300, 3000}


def taken_by_file(path: Path, number: int, first: float = 1.0) -> bool:
    one = item(number, first, 0 if number == JUMP else 1, 0, 0, *PLACE)
    path.write_text(json.dumps(plan(item(WAYPOINT, *PLACE), one)), "utf-8")
    try:
        read_plan(path)
    except ScenarioError:
        return False
    return True


def taken_by_link(number: int, first: float = 1.0) -> bool:
    place = Item(0, 6, WAYPOINT, (0.0, 0.0, 0.0, 0.0), 470005000, 80000000, 20.0)
    one = Item(1, 6, number, (first, 1.0, 0.0, 0.0), 470005000, 80000000, 20.0)
    return any(link.check([place, one], flavour)[0] is PlanResult.ACCEPTED for flavour in ("px4", "ardupilot"))


def test_files_and_the_link_take_the_same_commands(tmp_path: Path) -> None:
    path = tmp_path / "one.plan"
    for number in (*COMMANDS, 1, 999):
        expected = number not in REFUSED and number in COMMANDS
        assert (taken_by_file(path, number), taken_by_link(number)) == (expected, expected), number
    # A fence that is turned off, and a kind of speed that there is not.
    assert (taken_by_file(path, 207, 0.0), taken_by_link(207, 0.0)) == (False, False)
    assert (taken_by_file(path, 178, 7.0), taken_by_link(178, 7.0)) == (False, False)
