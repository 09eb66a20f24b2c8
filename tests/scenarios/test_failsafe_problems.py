"""What is refused of failsafes and of faults of radios, in one line each; and what may be written."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from qrsim.control.failsafes import WORDS
from qrsim.errors import ScenarioError
from qrsim.scenarios.scenario import load_scenario
from qrsim.scenarios.schema import json_schema

RADIO = {"preset": "sik_915", "path_loss": {"waves": 2}}


def content(failsafes: Any = None, waves: Any = None, **fleet: Any) -> dict[str, Any]:
    uav = {
        "vehicle": {"type": "multirotor", "model": "x500"},
        "controller": {"type": "cascade", "feed": "truth"},
        "sensors": {"gnss": {"type": "ideal_gnss"}},
        "battery": {"type": "lithium_cells"},
        "failsafes": {} if failsafes is None else failsafes,
        "vehicles": [{"position_ned": [0.0, 10.0 * i, -20.0]} for i in range(2)],
    }
    return {"name": "failsafes", "world": {"radio": waves}, "fleets": {"uav": uav | fleet}}


def problems(content: dict[str, Any]) -> str:
    with pytest.raises(ScenarioError) as error:
        load_scenario(content)
    return str(error.value)


REFUSED: list[tuple[Any, Any, dict[str, Any], str]] = [
    ({"COM_LOW_BAT_ACT": "retrun_or_land"}, None, {}, "did you mean 'return_or_land'?"),
    ({"COM_LOW_BAT_ACT": 1}, None, {}, "fleets.uav.failsafes.COM_LOW_BAT_ACT"),
    ({"COM_LOW_BATT_ACT": 2}, None, {}, "did you mean 'COM_LOW_BAT_ACT'?"),
    ({"BAT_LOW_THR": 0.6}, None, {}, "fleets.uav.failsafes.BAT_LOW_THR"),
    ({"BAT_CRIT_THR": 0.2}, None, {}, "failsafes.BAT_CRIT_THR: 0.2 is above BAT_LOW_THR, 0.15; allowed: at most that"),
    ({"BAT_EMERGEN_THR": 0.1}, None, {}, "failsafes.BAT_EMERGEN_THR: 0.1 is above BAT_CRIT_THR, 0.07"),
    (
        {"BAT_LOW_THR": [0.15, 0.3], "BAT_CRIT_THR": [0.2, 0.1]},
        None,
        {},
        "BAT_CRIT_THR: 0.2 is above BAT_LOW_THR, 0.15",
    ),
    (
        {"BAT_LOW_THR": [0.15, 0.3, 0.2]},
        None,
        {},
        "failsafes.BAT_LOW_THR: 3 numbers in a list; allowed: 2, one for each vehicle, or a number",
    ),
    ({}, None, {"vehicles": [{"position_ned": [0, 0, -20], "rally_ned": [[9, 0, -20]] * 21}]}, "at most 20"),
    ({"RTL_RETURN_ALT": []}, None, {}, "failsafes.RTL_RETURN_ALT: 0 numbers in a list"),
    (
        {"COM_LOW_BAT_ACT": "land"},
        None,
        {"battery": {"type": "given"}},
        "failsafes.COM_LOW_BAT_ACT: a battery of type 'given' has no charge that could be low",
    ),
    (
        {},
        None,
        {"battery": {"type": "given"}, "sensors": {}},
        "failsafes: nothing can fail: the fleet has no battery that drains, no GNSS receiver and no NAV_DLL_ACT",
    ),
    ({"COM_GNSSLOSS_ACT": 1}, None, {"sensors": {}}, "failsafes.COM_GNSSLOSS_ACT: the fleet has no GNSS receiver"),
    ({"NAV_DLL_ACT": "hold"}, None, {}, "NAV_DLL_ACT: there is no link that could be lost; give world.radio"),
    ({"NAV_DLL_ACT": "hold"}, RADIO, {}, "failsafes.link_to: missing; NAV_DLL_ACT needs the fleet to listen to: uav"),
    ({"NAV_DLL_ACT": 1, "link_to": "uaw"}, RADIO, {}, "link_to: there is no fleet 'uaw'; did you mean 'uav'?"),
    ({"NAV_DLL_ACT": 1, "link_to": "uav"}, RADIO, {"radio": "none"}, "NAV_DLL_ACT: fleets.uav.radio is none"),
    ({"link_to": "uav"}, RADIO, {}, "link_to: nothing is done when that link is lost; give NAV_DLL_ACT too"),
    (
        {},
        None,
        {"vehicle": {"type": "pelican"}, "battery": {"type": "lithium_polymer"}},
        "failsafes: they land, but touching the ground ends the flight of this fleet; give it ground: parked",
    ),
    (
        {},
        None,
        {
            "vehicle": {"type": "pelican"},
            "controller": {"type": "waypoint", "feed": "truth"},
            "battery": {"type": "lithium_polymer"},
            "ground": "parked",
        },
        "failsafes: the controller 'waypoint' does not fly paths, as failsafes do; allowed: cascade",
    ),
    (
        {},
        None,
        {"guidance": {"type": "velocity"}},
        "failsafes: failsafes cannot take over from the guidance 'velocity'; allowed: ",
    ),
]


@pytest.mark.parametrize(("failsafes", "radio", "fleet", "message"), REFUSED)
def test_what_cannot_be_is_refused(failsafes: Any, radio: Any, fleet: dict[str, Any], message: str) -> None:
    assert message in problems(content(failsafes, radio, **fleet))


def test_an_area_that_ends_above_the_ground_is_refused() -> None:
    box = {"type": "box", "x_min": -100.0, "x_max": 100.0, "y_min": -100.0, "y_max": 100.0, "z_min": -60.0}
    given = content()
    given["world"] |= {"area": box | {"z_max": -4.0}, "ground": {"type": "flat", "height": 1.0}}
    assert "failsafes: they land, but the area ends 3 m above the ground; give world.area z_max: -1" in problems(given)
    given["world"]["ground"]["height"] = 4.0
    load_scenario(given)


FAULTS: list[tuple[Any, dict[str, Any], str]] = [
    (RADIO, {"kind": "weak"}, "share is missing; kind 'weak' needs it"),
    (RADIO, {"kind": "off", "share": 0.5}, "share is for kind 'weak' only"),
    (RADIO, {"kind": "weak", "share": 1.5}, "share"),
    (RADIO, {"kind": "of"}, "did you mean 'off'?"),
    (RADIO, {"kind": "off", "end": 3.0}, "end: 3 s is not after the start, 5 s"),
    (RADIO, {"kind": "off", "at": 5.001}, "at: 5.001 s is not a multiple of the time step 0.02 s"),
    (RADIO, {"kind": "off", "vehicles": ["uav_7"]}, "no vehicle of the fleet is called 'uav_7'"),
    (None, {"kind": "off"}, "fleets.uav.faults.0.type: there is no world.radio that could fail"),
]


@pytest.mark.parametrize(("radio", "fault", "message"), FAULTS)
def test_a_fault_of_a_radio_that_cannot_be_is_refused(radio: Any, fault: dict[str, Any], message: str) -> None:
    assert message in problems(content(None, radio, faults=[{"type": "radio", "at": 5.0} | fault]))


def test_a_radio_that_is_not_there_cannot_be_injectable() -> None:
    assert "injectable.radio: there is no world.radio that could fail" in problems(content(injectable={"radio": True}))
    # Of all, what there is.
    fleet = load_scenario(content(injectable="all")).world().fleets[0]
    assert fleet.radio_slot is None
    assert load_scenario(content(None, RADIO, injectable="all")).world().fleets[0].radio_slot is not None


def test_words_are_as_good_as_px4s_numbers() -> None:
    for name, words in WORDS.items():
        more = {"link_to": "uav"} if name == "NAV_DLL_ACT" else {}
        for word, number in words.items():
            if word != "none":
                one, other = (
                    load_scenario(content({name: value} | more, RADIO)).world().fleets[0].failsafes
                    for value in (word, number)
                )
                assert getattr(one, name) == getattr(other, name) == word


def test_numbers_may_be_of_each_vehicle_and_drawn_by_each_episode() -> None:
    given = content({"BAT_CRIT_THR": [0.07, 0.1]})
    given["ranges"] = [{"path": "fleets.uav.failsafes.RTL_RETURN_ALT", "low": 20.0, "high": 40.0}]
    world = load_scenario(given).world()
    np.testing.assert_allclose(world.fleets[0].failsafes.BAT_CRIT_THR, [0.07, 0.1])
    assert world.ranges[0].paths[0] == ("fleets", 0, "failsafes", "RTL_RETURN_ALT")
    wrong = content({"COM_LOW_BAT_ACT": 2})
    wrong["ranges"] = [{"path": "fleets.uav.failsafes.COM_LOW_BAT_ACT", "low": 0.0, "high": 3.0}]
    assert "is not a number that can differ from episode to episode" in problems(wrong)


def test_rally_points_without_failsafes_are_refused() -> None:
    given = content(vehicles=[{"position_ned": [0, 0, -20], "rally_ned": [[9, 0, -20]]}])
    del given["fleets"]["uav"]["failsafes"]
    assert "fleets.uav.vehicles.0.rally_ned: only failsafes return there; give failsafes: {}" in problems(given)


def test_a_fleet_without_failsafes_has_none() -> None:
    world = load_scenario(content() | {"fleets": {"uav": content()["fleets"]["uav"] | {"failsafes": None}}}).world()
    assert world.fleets[0].failsafes is None


def test_editors_accept_words_and_numbers() -> None:
    fields = json_schema()["$defs"]["failsafes"]["properties"]
    assert fields["COM_LOW_BAT_ACT"]["enum"] == ["warn", "land", "return_or_land", 0, 2, 3]
    assert fields["NAV_DLL_ACT"]["enum"] == ["none", "hold", "return", "land", 0, 1, 2, 3]
    assert (fields["RTL_RETURN_ALT"]["default"], fields["RTL_RETURN_ALT"]["unit"]) == (60.0, "m")
