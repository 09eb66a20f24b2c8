"""Requests of links and of the page: what a line of words says, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest
from tests.simulation.test_injections import scenario

import qrsim
from qrsim.errors import UsageError
from qrsim.scenarios.live_requests import Request, apply, injected_rows, numbers_of, parsed
from qrsim.scenarios.scenario import load_scenario

WINDY = {"world": {"wind": {"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 90.0}}}


@pytest.mark.parametrize(
    ("text", "request_"),
    [
        ("inject gnss off field_0 for 5", Request("gnss", "off", ("field_0",), None, 5.0)),
        (
            "inject rotor 2 weak a b health=0.5 at 7.5",
            Request("rotor 2", "weak", ("a", "b"), 7.5, None, {"health": 0.5}),
        ),
        (
            "inject gnss drift field=position_ned rate=-0.5",
            Request("gnss", "drift", None, None, None, {"field": "position_ned", "rate": -0.5}),
        ),
        (
            "inject body push field_0 acceleration_ned.x=2 acceleration_ned.z=-1 for 0.5",
            Request("body", "push", ("field_0",), None, 0.5, {"acceleration_ned.x": 2.0, "acceleration_ned.z": -1.0}),
        ),
        ("clear gnss field_0", Request("gnss", "ok", ("field_0",))),
        ("clear", Request(None, "ok")),
        ("wind 6 270", Request("world", "wind", None, None, None, {"speed_20ft": 6.0, "wind_from_deg": 270.0})),
        (
            "wind 6 270 over 3",
            Request("world", "wind", None, None, None, {"speed_20ft": 6.0, "wind_from_deg": 270.0, "over": 3.0}),
        ),
    ],
)
def test_a_line_of_words_is_a_request(text: str, request_: Request) -> None:
    assert parsed(text) == request_


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'': expected inject, clear, wind"),
        ("injekt gnss off", "'injekt': expected inject, clear, wind; did you mean 'inject'"),
        ("inject gnss", "inject: expected a target and a kind, such as 'inject gnss off'"),
        ("inject gnss off for", "for: ''; expected a number"),
        ("inject gnss off for soon", "for: 'soon'; expected a number"),
        ("inject gnss wrong bias=1 bias=2", "bias: given twice"),
        ("inject gnss wrong bias=nan", "bias: 'nan'; expected a number"),
        ("inject gnss wrong bias=1e999", "bias: '1e999'; expected a number"),
        ("wind 6", "wind: 1 numbers; expected a speed"),
        ("wind 6 west", "wind_from_deg: 'west'; expected a number"),
        ("inject " + "a " * 1000, "request: 1001 words; allowed: at most 1000"),
    ],
)
def test_lines_that_are_none(text: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        parsed(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_numbers_as_text() -> None:
    assert numbers_of("field=height, bias=2") == {"field": "height", "bias": 2.0}
    assert numbers_of("  ") == {}
    for text in ("bias", "for 3"):
        with pytest.raises(UsageError, match="expected NAME=VALUE"):
            numbers_of(text)


SIMULATION = qrsim.Simulation(load_scenario(scenario({"sensors": ["gnss", "baro"], "battery": True}, **WINDY)).world())


def test_requests_are_done_and_said() -> None:
    SIMULATION.reset()
    for text, said in (
        ("inject gnss off uav_0 for 5", "Injected: gnss off of uav_0 for 5 s"),
        ("inject baro slow every=7 at 1", "Injected: baro slow at 1 s"),
        ("wind 6 270", "Wind: 6 m/s at 20 ft from 270 degrees"),
    ):
        assert apply(SIMULATION, parsed(text), "test") == said
    assert [one.asked_by for one in SIMULATION.injected] == ["test", "test"]
    first, second = injected_rows(SIMULATION)
    # From the first reading that it can change, and for 250 ticks of 0.02 s.
    assert (first["target"], first["vehicles"], first["start"], first["end"]) == ("gnss", ["uav_0"], 0.02, 5.02)
    assert (second["kind"], second["start"], second["end"], second["numbers"]) == ("slow", 1.0, None, {"every": 7.0})
    wind: Any = SIMULATION.world.wind
    assert float(wind.speed_20ft) == pytest.approx(6.0)
    assert float(wind.wind_from_rad) == pytest.approx(4.712389, abs=1e-6)
    assert apply(SIMULATION, parsed("clear gnss uav_0"), "test") == "Cleared: gnss of uav_0"
    assert [one.target for one in SIMULATION.injected] == ["baro"]
    assert apply(SIMULATION, parsed("clear"), "test") == "Cleared: all"
    assert injected_rows(SIMULATION) == []


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (
            Request("world", "wnd"),
            "kind: 'wnd' does not suit the world; allowed: wind, gusts, jam; did you mean 'wind'?",
        ),
        (Request("world", "wind"), "speed_20ft: missing; a wind needs speed_20ft and wind_from_deg"),
        (
            Request("world", "wind", numbers={"speed_20ft": 3.0, "wind_from_deg": 0.0, "ower": 3.0}),
            "ower: there is no such number; did you mean 'over'?",
        ),
        (Request("world", "wind", ("uav_0",)), "vehicles: wind of the world is that of all"),
        (Request("world", "wind", None, 3.0), "at, duration: the world changes from the next tick on"),
        (parsed("wind -1 0"), "speed_20ft: -1.0; allowed: 0 to "),
        (
            Request("world", "wind", numbers={"speed_20ft": "3", "wind_from_deg": 1.0}),
            "speed_20ft: '3'; allowed: 0 to ",
        ),
        (Request(None, "off"), "target: missing; a sensor, 'rotor N', 'battery', 'body' or 'world'"),
        (Request("gnss", "off", numbers={"asked_by": "me"}), "asked_by: there is no such number"),
        (Request("gnss", "ok", None, None, 3.0), "clear: it takes a target and vehicles only"),
        (parsed("inject gns off"), "target: there is no 'gns'; did you mean 'gnss'?"),
        (parsed("inject mag off"), "fleets.uav of the scenario, or give the command --injectable"),
        (parsed("inject gnss off uav_9"), "vehicles: no vehicle is called 'uav_9'; did you mean"),
        (parsed("clear gns"), "target: there is no 'gns'; did you mean 'gnss'?"),
    ],
)
def test_what_is_refused_changes_nothing(request_: Request, message: str) -> None:
    before = SIMULATION.world
    with pytest.raises(UsageError) as caught:
        apply(SIMULATION, request_, "test")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert SIMULATION.world is before
