"""Weather that changes at set times and in flight: what it comes to, in the middle and at the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.small_worlds import bare_pair

import qrsim
from qrsim.errors import ScenarioError, UsageError
from qrsim.runs import open_run
from qrsim.runs.recorder import fly
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

WIND = {"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 350.0}
# The vehicles of the pair begin at 10 m and 12 m and hold; at 6.096 m the wind has its speed.
EVENTS = [
    {"at": 0.4, "wind": {"speed_20ft": 8.0, "wind_from_deg": 10.0, "over": 1.0}},
    {"at": 0.6, "gusts": {"times": 0.0, "over": 0.5}},
    {"at": 1.0, "wind": {"speed_20ft": 1.0, "wind_from_deg": 100.0, "over": 0.6}},
    {"at": 2.0, "gusts": {"times": 2.0}},
]


def content(**world: Any) -> dict[str, Any]:
    made = bare_pair(wind=WIND, turbulence={"type": "dryden"}, duration=4.0)
    found: dict[str, Any] = made.spec.model_dump(mode="json")
    found["world"] |= world
    return found


def flown(simulation: Simulation, ticks: int = 120) -> np.ndarray:
    """Return position, mean wind and gusts of every tick."""
    rows = []
    for _ in range(ticks):
        simulation.step()
        rows.append(now(simulation))
    return np.array(rows)


def now(simulation: Simulation) -> np.ndarray:
    fleet = simulation.state.fleets[0]
    wind, gust = fleet.mean_wind_ned, fleet.gust_ned
    return np.concatenate([simulation.truth.position_ned, np.stack([wind.x, wind.y, gust.x, gust.z], axis=1)], axis=1)


def loaded(precision: str = "float32", **world: Any) -> Simulation:
    found = qrsim.load(content(**world), seed=3, precision=precision)
    found.reset()
    return found


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return flown(loaded())


@pytest.fixture(scope="module")
def changed() -> np.ndarray:
    return flown(loaded(events=EVENTS))


def speeds(rows: np.ndarray) -> np.ndarray:
    """Return the speed of the wind at 20 ft that the mean wind at the first vehicle is of, by the law of its height."""
    feet = -rows[:, 0, 2] / 0.3048
    return np.hypot(rows[:, 0, 3], rows[:, 0, 4]) * np.log(20.0 / 0.15) / np.log(feet / 0.15)


def test_wind_comes_to_what_was_asked_for_evenly(changed: np.ndarray) -> None:
    """Row k is flown from tick k to k + 1, and height is that of its end: half a percent."""
    found = speeds(changed)
    np.testing.assert_allclose(found[[0, 20, 45, 49]], [2.0, 2.0, 5.0, 5.48], rtol=0.005)
    # At tick 50 it is 5.6 m/s, from where it goes to 1 m/s in 30 ticks.
    np.testing.assert_allclose(found[[50, 65, 80, 110]], [5.6, 3.3, 1.0, 1.0], rtol=0.005)
    bearing = np.degrees(np.arctan2(-changed[:, 0, 4], -changed[:, 0, 3])) % 360.0
    # Through north, and not through south.
    np.testing.assert_allclose(bearing[[20, 35, 50, 65, 80]], [350.0, 356.0, 2.0, 51.0, 100.0], atol=0.01)


def test_gusts_are_multiplied(changed: np.ndarray, plain: np.ndarray) -> None:
    """Of the same draws: as long as nothing else differs they are a multiple, and later none, or twice as large."""
    np.testing.assert_array_equal(changed[:20], plain[:20])
    assert (changed[56:100, :, 5:] == 0.0).all()
    assert np.abs(changed[101:, :, 5]).max() > 1.2 * np.abs(plain[101:, :, 5]).max()
    half = changed[42, 0, 5] / plain[42, 0, 5]
    assert half == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.long)])
def test_asked_for_in_flight_it_is_the_same_to_the_bit(plain: np.ndarray, precision: str) -> None:
    simulation = loaded(precision, injectable=["wind", "gusts"])
    rows = []
    for tick in range(120):
        if tick == 20:
            simulation.set_wind(8.0, 10.0, over=1.0)
        if tick == 30:
            simulation.set_gusts(np.float32(0.0), over=0.5)
        if tick == 50:
            simulation.set_wind(1.0, 100.0, over=0.6)
        if tick == 100:
            simulation.set_gusts(2)
        simulation.step()
        rows.append(now(simulation))
    np.testing.assert_array_equal(rows, flown(loaded(precision, events=EVENTS)))
    simulation.reset()
    if precision == "float32":
        np.testing.assert_array_equal(flown(simulation), plain)


def test_a_step_is_that_of_a_wind_without_a_course() -> None:
    found = []
    for world in ({}, {"injectable": ["wind", "gusts"]}):
        simulation = loaded(**world)
        simulation.step(ticks=20)
        simulation.set_wind(8.0, 10.0)
        found.append(flown(simulation, 20))
    np.testing.assert_array_equal(*found)


def test_a_run_has_their_events(tmp_path: Path) -> None:
    fly(load_scenario(content(events=EVENTS), quiet=True), tmp_path / "run", seed=3, precision="float32")
    run = open_run(tmp_path / "run")
    found = [(event.tick, event.kind, event.field, event.value) for event in run.events if "changed" in event.kind]
    assert found == [
        (20, "wind_changed", "world.wind.speed_20ft", 8.0),
        (20, "wind_changed", "world.wind.wind_from_deg", 10.0),
        (30, "gusts_changed", "world.gusts.times", 0.0),
        (50, "wind_changed", "world.wind.speed_20ft", 1.0),
        (50, "wind_changed", "world.wind.wind_from_deg", 100.0),
        (100, "gusts_changed", "world.gusts.times", 2.0),
    ]
    assert "wind changed at 0.40 s, over 1 s: 8 m/s at 20 ft" in [event.message for event in run.events]
    # They are of the scenario, which flies them again by itself.
    assert run.injections == []


@pytest.mark.long
def test_many_worlds_have_the_same_events(changed: np.ndarray) -> None:
    def wind(state: Any) -> Any:
        return state.fleets[0].mean_wind_ned.x

    together = qrsim.rollout(content(events=EVENTS), seeds=[3, 4], ticks=120, record=wind, record_every=1)
    found = np.asarray(together.recorded)
    found = found if found.shape[0] == 2 else np.moveaxis(found, 1, 0)
    found = found[:, -120:]
    np.testing.assert_allclose(found[0, :, 0], changed[:, 0, 3], atol=2e-3)
    np.testing.assert_allclose(found[1, [20, 45, 65, 110], 0], changed[[20, 45, 65, 110], 0, 3], rtol=0.02, atol=2e-3)


JAMMER = {"kind": "jammer", "position_ned": [0.0, 0.0, -2.0], "power_w": 0.0}


def jammed(**world: Any) -> dict[str, Any]:
    """Return one vehicle with a receiver that is near a jammer without power."""
    fleet = {"sensors": {"gnss": {"type": "gnss", "period": 0.2}}, "vehicles": [{"position_ned": [30.0, 0.0, -20.0]}]}
    fleet["controller"] = {"type": "cascade", "feed": "truth"}
    return {"name": "jam", "duration": 6.0, "fleets": {"a": fleet}, "world": {"interference": [JAMMER]} | world}


def fixes(simulation: Simulation, ticks: int) -> list[bool]:
    return [not np.isnan(simulation.step().gnss.position_ned).any() for _ in range(ticks)]


@pytest.mark.long
def test_a_jammer_is_turned_on_and_off() -> None:
    powers = [(1.0, 10.0), (3.0, 0.0)]
    events = [{"at": at, "jam": {"jammer": 0, "power_w": power}} for at, power in powers]
    scheduled = qrsim.load(jammed(events=events), seed=1)
    scheduled.reset()
    found = fixes(scheduled, 300)
    # A receiver gives up 1.2 s after the first epoch that it cannot track.
    assert all(found[:109])
    assert not any(found[109:149])
    assert all(found[220:])
    # It is as one that has this power from 1 s to 3 s.
    declared = qrsim.load(jammed(interference=[JAMMER | {"power_w": 10.0, "start": 1.0, "end": 3.0}]), seed=1)
    declared.reset()
    assert fixes(declared, 300) == found
    live = qrsim.load(jammed(injectable="all"), seed=1)
    live.reset()
    again = fixes(live, 49)
    live.set_jammer(0, 10.0)
    again += fixes(live, 100)
    # Links have no whole numbers.
    live.change_weather("jam", {"jammer": 0.0, "power_w": 0.0})
    assert live.requests[-1].numbers == {"jammer": 0, "power_w": 0.0}
    assert again + fixes(live, 151) == found
    with pytest.raises(UsageError, match=r"jammer: 1; allowed: 0 to 0, in the order of world.interference"):
        live.set_jammer(1, 1.0)


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (
            {"at": 0.41, "wind": {"speed_20ft": 8}},
            "world.events.0.at: 0.41 s is not a multiple of the time step",
        ),
        ({"at": 4.0, "gusts": {"times": 2}}, "world.events.0.at: 4 s is not within the run"),
        ({"at": 0.4}, "world.events.0: expected one of wind, gusts, jam, push, found none"),
        ({"at": 0.4, "wind": {}}, "world.events.0.wind: speed_20ft: missing; kind 'wind' needs it, or wind_from_deg"),
        ({"at": 0.4, "wind": {"speed_20ft": 51}}, "speed_20ft: 51.0; allowed: 0 to 50 m/s"),
        ({"at": 0.4, "gust": {"times": 2}}, "did you mean 'gusts'?"),
        ({"at": 0.4, "gusts": {"times": 11}}, "times: 11 is out of range; allowed: 0 to 10"),
        ({"at": 0.4, "wind": {"speed_20ft": 8, "over": -1}}, "over: -1 is out of range"),
        ({"at": 0.4, "jam": {"jammer": 0, "power_w": 1}}, "declare one in world.interference"),
    ],
)
def test_events_that_are_refused(event: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content(events=[event]), quiet=True)
    assert message in str(caught.value)


def test_numbers_beyond_their_limits() -> None:
    simulation = Simulation(load_scenario(content(injectable="all"), quiet=True).world())
    for call, message in (
        (lambda: simulation.set_gusts(10.5), r"times: 10\.5; allowed: 0 to 10$"),
        (lambda: simulation.set_gusts(-0.1), r"times: -0\.1; allowed: 0 to 10$"),
        (lambda: simulation.set_gusts(2.0, over=1.1e6), r"over: 1100000\.0; allowed: 0 to 1e\+06 s$"),
        (lambda: simulation.set_gusts(2.0, over=float("nan")), r"over: nan; allowed: 0 to 1e\+06 s$"),
        (lambda: simulation.set_jammer(0, 1.1e6), r"power_w: 1100000\.0; allowed: 0 to 1e\+06 W$"),
    ):
        with pytest.raises(UsageError, match=message):
            call()
    assert simulation.requests == []
    events = [{"at": 0.02 * i, "gusts": {"times": 0.1 * (i % 3)}} for i in range(51)]
    assert load_scenario(content(events=events[:50]), quiet=True).world().changes is not None
    with pytest.raises(ScenarioError, match=r"world\.events: expected at most 50 entries, found 51"):
        load_scenario(content(events=events), quiet=True)
    # There is always room for one more in flight.
    full = Simulation(load_scenario(content(events=events[:50]), quiet=True).world())
    full.reset()
    full.set_gusts(3.0)
    full.set_gusts(2.0)


def test_what_cannot_be_asked_for_in_flight() -> None:
    simulation = Simulation(load_scenario(content(), quiet=True).world())
    for call, message in (
        (lambda: simulation.set_wind(8.0, 0.0, over=1.0), "over: .* write 'injectable: \\[wind\\]' under world"),
        (lambda: simulation.set_gusts(2.0), "gusts: .* write 'injectable: \\[gusts\\]' under world"),
        (lambda: simulation.set_jammer(0, 2.0), "write 'injectable: \\[jam\\]' under world"),
        (lambda: simulation.set_wind(51.0, 0.0), "speed_20ft: 51.0; allowed: 0 to 50 m/s"),
        (lambda: simulation.set_wind(float("nan"), 0.0), "speed_20ft: nan; allowed: 0 to 50 m/s"),
        (lambda: simulation.set_wind(5.0, float("inf")), r"wind_from_deg: inf; allowed: -1e\+06 to 1e\+06 degrees"),
        (lambda: simulation.inject("world", "wind", speed_20ft=5.0, at=1.0), "vehicles, at, duration: the world"),
        (lambda: simulation.inject("world", "ok"), "kind: 'ok' does not suit the world; allowed: wind, gusts, jam$"),
        (lambda: simulation.change_weather("wind", {5: 1.0}), "5: there is no such number"),  # type: ignore[dict-item]
        (lambda: simulation.set_wind("5", 0.0), "speed_20ft: '5'; allowed"),  # type: ignore[arg-type]
    ):
        with pytest.raises(UsageError, match=message):
            call()
    assert simulation.requests == []
    for parts, message in (
        ({"wind": {"type": "calm"}, "turbulence": {"type": "still"}}, "only that of type log_shear"),
        (
            {"gust": {"type": "discrete", "start_time": 1, "length": 9, "along": 3, "front": "travelling"}},
            "a gust moves with it",
        ),
    ):
        still = load_scenario(content() | {"world": content()["world"] | parts}, quiet=True)
        with pytest.raises(UsageError, match=message):
            Simulation(still.world()).set_wind(5.0, 0.0)
