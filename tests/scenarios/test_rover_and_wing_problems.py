"""What a rover or a fixed wing cannot be given, each in a line that says what is allowed."""

from __future__ import annotations

from typing import Any

import pytest

import qrsim
from qrsim.errors import ScenarioError

WING = {"vehicle": {"type": "fixed_wing"}, "controller": {"type": "fixed_wing", "feed": "truth"}}
ROVER = {"vehicle": {"type": "rover"}, "controller": {"type": "rover", "feed": "truth"}}
HEIGHT = {WING["vehicle"]["type"]: -60.0, ROVER["vehicle"]["type"]: 0.0}


def load(fleet: dict[str, Any], **changes: Any) -> Any:
    vehicles = [{"position_ned": [0.0, 0.0, HEIGHT[fleet["vehicle"]["type"]]]}]
    return qrsim.load({"name": "x", "duration": 5.0, "fleets": {"a": {"vehicles": vehicles, **fleet, **changes}}})


def start(**own: Any) -> dict[str, Any]:
    return {"vehicles": [{"position_ned": [0.0, 0.0, -60.0], **own}]}


def vehicle(kind: str, **numbers: Any) -> dict[str, Any]:
    return {"vehicle": {"type": kind, **numbers}}


@pytest.mark.parametrize(
    ("fleet", "changes", "expected"),
    [
        (ROVER, {"guidance": {"type": "fixed_wing"}}, "guidance: 'fixed_wing' does not fit the controller 'rover'"),
        (
            WING,
            {"guidance": {"type": "rover"}},
            "guidance: 'rover' does not fit the controller 'fixed_wing'; allowed: ",
        ),
        # The Aerosonde's span is 2.8956 m.
        (WING, start(position_ned=[0.0, 0.0, 0.0]), "position_ned: z = 0 m, but a 'fixed_wing' starts in flight; "),
        (WING, start(position_ned=[0.0, 0.0, -1.4]), "allowed: z at most -1.448 m, half a span above the ground"),
        (WING, start(velocity_body=[0.0, 0.0, 30.0]), "velocity_body: starts at an airspeed of 0 m/s ahead, which is"),
        (WING, start(velocity_body=[-30.0, 0.0, 0.0]), "an airspeed of -30 m/s ahead, which is below its stall"),
        (
            WING,
            start(velocity_body=[200.0, 0.0, 0.0]),
            "u = 200 m/s; allowed: -80 to 80 (limits.velocity of the fleet)",
        ),
        (
            WING,
            vehicle("fixed_wing", longitudinal={"lift_alpha": 0.0}),
            "lift_alpha: 0.0 is out of range; allowed: above 0",
        ),
        (WING, vehicle("fixed_wing", gravity=0.0), "vehicle.gravity: 0.0 is out of range; allowed: above 0"),
        (ROVER, vehicle("rover", gravity=0.0), "vehicle.gravity: 0.0 is out of range; allowed: above 0"),
        (
            ROVER,
            {"vehicle": {"type": "differential_rover", "gravity": 0.0}},
            "vehicle.gravity: 0.0 is out of range; allowed: above",
        ),
    ],
)
def test_it_is_refused_in_one_line(fleet: dict[str, Any], changes: dict[str, Any], expected: str) -> None:
    if "vehicle" in changes:
        changes = {**changes, "vehicles": [{"position_ned": [0.0, 0.0, HEIGHT[fleet["vehicle"]["type"]]]}]}
    with pytest.raises(ScenarioError) as caught:
        load(fleet, **changes)
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert expected in lines[1]


@pytest.mark.parametrize("fleet", [WING, ROVER])
def test_its_own_guidance_and_a_plain_start_are_taken(fleet: dict[str, Any]) -> None:
    load(fleet, guidance={"type": fleet["vehicle"]["type"]})
    load(WING, **start(position_ned=[0.0, 0.0, -1.5], velocity_body=[20.0, 1.0, 1.0]))
