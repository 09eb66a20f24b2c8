"""A plan flies the same path from a file as by upload, whichever commands it has."""

from __future__ import annotations

import json
import math
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from puppet import SITE, Puppet, item

from qrsim.control.paths import plan as planned
from qrsim.links.mavlink.stack.codes import MissionState, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN, Item
from qrsim.scenarios.build import ground_if_any
from qrsim.scenarios.missions import limits_of, ways_of
from qrsim.scenarios.plans.commands import COMMANDS, SKIPPED
from qrsim.scenarios.scenario import load_scenario

W, UP = 16, 22
HOLDS = (3.0, 0.0, NAN, NAN)
Row = tuple[Any, ...]


def after_start(*rows: Row, take_off: bool = True) -> list[Row]:
    """Return rows of (command, north, east, up, parameters, frame) after a take-off to 10 m and a waypoint."""
    return [(UP, 0, 0, 10.0), (W, 20, 0, 10.0), *rows] if take_off else list(rows)


def do(command: int, *params: float) -> Row:
    return command, 0, 0, 0.0, (*params, *[0.0] * (4 - len(params))), 2


# By their commands, numbers of MAV_CMD; "p" and "a": the flavours that take them.
PLANS: dict[str, tuple[str, list[Row]]] = {
    "16 down and up": ("pa", after_start((W, 60, 5, 20.0), (W, 70, 5, 5.0), (W, 70, 60, 12.0))),
    "16 with holds": ("pa", after_start((W, 20, 40, 20.0, HOLDS), (W, 50, 40, 10.0))),
    "16 sharp corners": ("pa", after_start((W, 60, 0, 10.0), (W, 20, 20, 10.0), (W, 60, 50, 10.0))),
    "17": ("pa", after_start((17, 40, 30, 16.0))),
    "18": (
        "pa",
        after_start((18, 40, 30, 10.0, (1.0, 0, 8.0, NAN)), (18, 70, 0, 12.0, (1.5, 0, -8.0, NAN)), (W, 0, 30, 10.0)),
    ),
    "19": ("pa", after_start((19, 30, 30, 15.0, HOLDS), (W, 60, 30, 10.0))),
    "21": ("pa", after_start((21, 50, 20, 0.0))),
    "22 elsewhere": ("p", after_start((UP, 10, 10, 15.0), (W, 40, 10, 10.0), take_off=False)),
    "31": ("pa", after_start((31, 40, 0, 25.0), (W, 40, 30, 8.0))),
    "82": ("a", after_start((W, 40, 0, 10.0), (82, 40, 40, 5.0), (82, 80, 60, 20.0), (W, 20, 60, 10.0))),
    "93, 112": ("pa", after_start(do(93, 2.0), (W, 20, 30, 10.0), do(112, 2.0), (W, 40, 30, 15.0))),
    "114, 115, 178": (
        "a",
        after_start(do(114, 15.0), do(178, 1, 3.0, -1), do(115, 90.0), (W, 60, 0, 10.0), (W, 60, 30, 15.0)),
    ),
    "177": ("pa", after_start((W, 20, 20, 15.0), (W, 0, 20, 10.0), do(177, 3, 2.0), (W, 0, 60, 10.0))),
    "178 up and down": ("pa", after_start(do(178, 2, 1.0), do(178, 3, 0.8), (W, 60, 0, 20.0), (W, 60, 30, 10.0))),
    "179": ("pa", after_start((179, 20, 8, 0.0), (W, 50, 10, 10.0))),
    "4501": ("p", after_start((4501, 30, 0, 0.0), (W, 60, 0, 10.0))),
    "frames 0, 10": ("pa", after_start((W, 50, 0, 500.0, HOLDS, 0), (W, 50, 40, 20.0, HOLDS, 10))),
}
for name, taken in (("skipped by both", "pa"), ("skipped by ArduPilot", "a"), ("skipped by PX4", "p")):
    numbers = [each for each in sorted(SKIPPED) if COMMANDS[each].by == taken]
    PLANS[name] = (taken, after_start((W, 50, 0, 10.0), *(do(each, 1.0) for each in numbers), (W, 50, 40, 10.0)))
# A return is at the height of the last item in a file, and by RTL_RETURN_ALT over a link.
NOT_HERE = {20}


def items_of(rows: list[Row], flavour: str) -> list[Item]:
    """Items for a link; ArduPilot's begin with home."""
    items = [item(0, W, up=0.0)] if flavour == "ardupilot" else []
    for command, north, east, up, *more in rows:
        params, frame = (*more, *((0.0, 0.0, NAN, NAN), 6)[len(more) :])
        if command == 177 and flavour == "px4":
            params = (params[0] - 1.0, *params[1:])
        items.append(item(len(items), command, float(north), float(east), up, params=params, frame=frame))
    return items


def path_of_file(rows: list[Row], folder: Path) -> np.ndarray:
    """The planned path (..., 3) of the plan in a file, NED [m], with its corners."""
    content = []
    for each in items_of(rows, "ardupilot")[1:]:
        numbers = [*each.params, each.x * 1e-7, each.y * 1e-7, each.z]
        params = [None if math.isnan(number) else number for number in numbers]
        content.append(
            {"type": "SimpleItem", "command": each.command, "frame": each.frame, "params": params,
             "doJumpId": each.seq, "autoContinue": True}
        )  # fmt: skip
    home = [math.degrees(SITE.latitude_rad), math.degrees(SITE.longitude_rad), 488.0]
    mission = {"version": 2, "plannedHomePosition": home, "items": content}
    file = folder / "field.plan"
    file.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}), "utf-8")
    fleet = {
        "controller": {"type": "cascade", "feed": "truth"}, "guidance": {"type": "mission"},
        "vehicles": [{"plan": str(file)}],
    }  # fmt: skip
    site = {"latitude_deg": home[0], "longitude_deg": home[1], "height_amsl": 488.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        spec = load_scenario({"name": "x", "duration": 1.0, "site": site, "fleets": {"a": fleet}}).spec
    (vehicle,) = spec.fleets["a"].vehicles
    legs = [leg for _, leg in ways_of(spec.fleets["a"], vehicle, ground_if_any(spec))]
    points = [np.array([vehicle.position_ned])]
    for part in planned(vehicle.position_ned, legs, limits_of(spec.fleets["a"].guidance)):
        end = np.array(part.leg.position_ned)
        if part.leg.kind == "circle":
            angles = np.linspace(-part.leg.angle, 0.0, 200)
            arm = end[:2] - part.leg.centre_ned
            turned = np.stack(
                [arm[0] * np.cos(angles) - arm[1] * np.sin(angles), arm[0] * np.sin(angles) + arm[1] * np.cos(angles)],
                1,
            )
            points.append(np.column_stack([part.leg.centre_ned + turned, np.full(200, end[2])]))
            continue
        points.append((end - part.cut_after * part.direction)[None])
        if part.cut_after:
            # The direction goes over along a cubic; its integral is the way to the side.
            time = np.linspace(0.0, 1.0, 20)[:, None]
            side = time**3 - 0.5 * time**4
            bend = part.direction * time + (part.onward - part.direction) * side
            points.append(points[-1] + 2.0 * part.cut_after * bend)
    return np.concatenate(points)


def path_of_link(rows: list[Row], flavour: str) -> np.ndarray:
    """The places (..., 3) of the point that a vehicle follows when the plan is uploaded, NED [m]."""
    puppet, found = Puppet(flavour), []

    def note(now: Puppet) -> None:
        if now.order is not None and now.order.kind == "path":
            found.append(now.order.numbers[:3])

    items = items_of(rows, flavour)
    assert puppet.stack.accept(PlanKind.MISSION, items) == (PlanResult.ACCEPTED, -1)
    assert puppet.do(300) == 0
    seconds = 40.0 if rows[-1][0] == 17 else 240.0
    over = puppet.run(seconds, lambda now: now.stack.mission().state is MissionState.COMPLETE, note)
    assert over or rows[-1][0] == 17
    return np.array(found)


def farthest(places: np.ndarray, line: np.ndarray) -> float:
    """The largest distance of places (n, 3) from a line through others (m, 3) [m]."""
    way = np.diff(line, axis=0)
    share = np.einsum("nmi,mi->nm", places[:, None] - line[None, :-1], way) / np.maximum((way**2).sum(1), 1e-12)
    nearest = line[:-1] + np.clip(share, 0.0, 1.0)[..., None] * way
    return float(np.linalg.norm(places[:, None] - nearest, axis=2).min(axis=1).max())


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_flies_one_path_from_a_file_and_by_upload(name: str, tmp_path: Path) -> None:
    flavours, rows = PLANS[name]
    by_file = path_of_file(rows, tmp_path)
    # A mission is over two metres before its last place, or on the ground.
    end = by_file[-1]
    for flavour in flavours:
        by_link = path_of_link(rows, {"p": "px4", "a": "ardupilot"}[flavour])
        begun = by_link[by_link[:, 2] < -1.0]
        assert farthest(begun[::10], by_file) < 0.5
        way = np.concatenate([np.linspace(a, b, 2 + int(math.dist(a, b))) for a, b in pairwise(by_file)])
        way = way[(way[:, 2] < -1.0) & (np.linalg.norm(way - end, axis=1) > 2.1)]
        assert farthest(way, by_link[::10]) < 0.5


def test_every_command_is_compared() -> None:
    compared = {row[0] for _, rows in PLANS.values() for row in rows}
    refused = {number for number, each in COMMANDS.items() if each.kind == "refused"}
    assert compared | refused | NOT_HERE == set(COMMANDS)
