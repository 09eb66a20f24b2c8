"""Highlights and plots of a small run in which two of three vehicles stop: who, when, and nothing after a stop."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from qrsim.models.scene.area import BoxArea
from qrsim.runs import Column, RunInfo, RunWriter, open_run
from qrsim.runs.layout import Event
from qrsim.view import highlights
from qrsim.view.gnss_events import Loss, losses, search_words
from qrsim.view.plots import Plots
from qrsim.view.recording import Recording

STEP, TICKS, NAMES = 0.1, 100, ("a", "b", "c")
AREA = SimpleNamespace(area=BoxArea(x_min=-90.0, x_max=10.0, y_min=-90.0, y_max=90.0, z_min=-90.0, z_max=0.0))
VECTORS = {
    "truth": ("position_ned", "velocity_body"),
    "commands": ("estimate.position_ned", "estimate_std.position_ned"),
    "wind": ("mean_ned", "gust_ned"),
}
LEFT = ("out_of_area", "position_ned.x", 10.25, "a stopped at 3.00 s, out_of_area: position_ned.x = 10.25 m")
# c is 8 m from a at first; until a stops, b is nearest to it 8.84 m to the south and 14.8 m to the east.
OF_A = "a and c, 8.00 m at 0.00 s; a and b, 17.24 m at 2.60 s"
AXIS = "sigma on the worst axis"
HIT = ("collision", "distance", 3.75, "b stopped at 5.00 s, collision: distance = 3.75 m to c")


def values_of() -> dict[str, dict[str, Any]]:
    """Return the values of the run by stream and column."""
    found: dict[str, dict[str, Any]] = {
        stream: {f"{name}.{axis}": np.zeros((TICKS, 3)) for name in names for axis in "xyz"}
        for stream, names in VECTORS.items()
    }
    truth, commands, wind = found["truth"], found["commands"], found["wind"]
    ticks = np.arange(TICKS)
    # North at 3.4 m/s until it is held at its last place inside, 9.86 m north.
    truth["position_ned.x"][:, 0] = 0.34 * np.minimum(ticks, 29)
    # 20 m east, 2 m/s towards c until 4 s, then back.
    truth["position_ned.y"][:, 1] = 12.0 + 0.2 * np.abs(np.minimum(ticks, 49) - 40)
    truth["position_ned.y"][:, 2] = 8.0
    # After the stops c is 1 m from a, which counts no longer.
    truth["position_ned.x"][80:, 2], truth["position_ned.y"][80:, 2] = 9.86, 1.0
    truth["velocity_body.x"][:30, 0], truth["velocity_body.x"][:50, 1] = 3.4, 2.0
    truth["battery.charge"] = 1.0 - 0.001 * np.repeat(ticks[:, None], 3, axis=1)
    truth["battery.charge"][60:, 0] = 0.25
    wind["mean_ned.x"][:], wind["gust_ned.y"][20, 2], wind["mean_ned.x"][40:, 0] = 3.0, 4.0, 99.0
    for axis in "xyz":
        commands[f"estimate_std.position_ned.{axis}"][:] = 1.0
        commands[f"estimate.position_ned.{axis}"][:] = truth[f"position_ned.{axis}"]
    # Of a 2 sigma from 1 s to 2 s, then 1.5; of b 3 sigma from 4 s on; of a stopped vehicle nothing counts.
    commands["estimate.position_ned.z"][10:20, 0], commands["estimate.position_ned.z"][20:, 0] = 2.0, 1.5
    commands["estimate.position_ned.z"][40:, 1], commands["estimate.position_ned.z"][70:, 0] = 3.0, 9.0
    return found


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The run, in an area that ends 10 m north."""
    path: Path = tmp_path_factory.mktemp("highlights") / "run"
    info = RunInfo.collect(scenario="x", seed=1, precision="float64", time_step=STEP, vehicles=NAMES)
    values, ticks = values_of(), np.arange(TICKS)
    columns = {stream: [Column(name, "m") for name in own] for stream, own in values.items()}
    with RunWriter.create(path, info=info, scenario_yaml="name: x\n", columns=columns) as writer:
        for stream, own in values.items():
            writer.append(stream, ticks, ticks * STEP, own)
        writer.append_event(3.0, 30, "a", *LEFT)
        writer.append_event(3.5, 35, "c", "failsafe", "fix", 3.0, "c: failsafe: fix lost, land, at 3.50 s")
        writer.append_event(4.0, 40, "c", "failsafe", "position", 4.0, "c: failsafe: position lost, descend, at 4.00 s")
        writer.append_event(5.0, 50, "b", *HIT)
        writer.append_event(5.5, 55, "b", "fault_ends", "gnss", None, "b: gnss off, ends at 5.50 s")
        writer.append_event(6.0, 60, "c", "failsafe_ends", "action", 3.0, "c: failsafe: land, at 6.00 s")
        writer.append_event(7.0, 70, "c", "failsafe_ends", "action", 0.0, "c: failsafe ends at 7.00 s")
        writer.append_event(8.0, 80, "c", "failsafe", "battery", 0.0, "c: failsafe: battery low, no action, at 8.00 s")
    with pytest.warns(UserWarning, match="cannot be built"):
        found = Recording(open_run(path))
    found.world = AREA  # type: ignore[assignment]
    return found


@pytest.fixture(scope="module")
def plots(recording: Recording) -> Plots:
    return Plots(recording)


def test_who_and_when_in_flight_only(plots: Plots):
    # b is 4.00 m from c at 4 s; the collision at 5 s was at 3.75 m, which only its event knows.
    assert [(section, at if at is None else round(at, 6), text) for at, text, section in plots.highlights()] == [
        ("stops", 3.0, "stopped: 2 of 3: a 3.00 s left the area to the north; b 5.00 s came too close to c, 3.75 m"),
        ("stops", 2.9, f"speed before it stopped: a, 3.4 m/s; estimate 1.50 {AXIS}: inside its 95 % band"),
        ("stops", 4.9, f"speed before it stopped: b, 2.0 m/s; estimate 3.00 {AXIS}: outside its 95 % band"),
        ("fence", 3.0, "outside the fence: a by 0.25 m to the north at 3.00 s"),
        ("separation", 5.0, f"closest pairs: b and c, 3.75 m at 5.00 s; {OF_A}"),
        ("speed and wind", 0.0, "fastest: a, 3.4 m/s at 0.00 s"),
        ("speed and wind", 2.0, "strongest wind: c, 5.0 m/s"),
        ("estimate", 4.0, "largest error of the estimate: b, 3.00 m"),
        ("estimate", 1.0, f"estimate first outside its 95 % band (1.96 {AXIS}): a 1.00 s, b 4.00 s"),
        # Its failsafe is all that the log has of it.
        ("GNSS", 3.5, "GNSS lost: c 3.50 s; fix lost, land 3.50 s; position lost, descend 4.00 s"),
        ("battery", 9.9, "lowest battery in flight: c, 90.1 %; at their stops: a 97.1 % at 3.00 s, b 95.1 % at 5.00 s"),
    ]


def test_a_loss_of_gnss_is_told_until_it_is_back(recording: Recording):
    """Scheduled, with the reactions to it; of the receiver's own events; not of other sensors, nor after a stop."""
    of_gnss = [f"gnss.{name}" for name in ("position_ned.x", "satellites")]
    streams = {"measurements": SimpleNamespace(columns=lambda: [*of_gnss, "mocap.position_ned.x"]), "events": None}

    class Log(dict[str, Any]):
        vehicles = NAMES
        events: ClassVar[list[Event]] = [
            Event(1.0, 10, "a", "fault_begins", "mocap", None, "a: mocap off, begins at 1.00 s"),
            Event(2.0, 20, "b", "fault_begins", "gnss", None, "b: gnss off, begins at 2.00 s"),
            Event(2.1, 21, "b", "failsafe", "fix", 3.0, "b: failsafe: fix lost, land, at 2.10 s"),
            Event(2.5, 25, "a", "failsafe", "battery", 3.0, "a: failsafe: battery low, land, at 2.50 s"),
            Event(3.0, 30, "b", "fault_ends", "gnss", None, "b: gnss off, ends at 3.00 s"),
            Event(4.0, 40, "c", "fault_begins", "gnss", None, "c: gnss wrong, begins at 4.00 s"),
            Event(4.5, 45, "c", "fix_lost", "gnss.satellites", 3.0, "c: gnss fix lost at 4.50 s, 3 satellites"),
            Event(6.0, 60, "b", "fix_lost", "gnss.satellites", 2.0, "b: gnss fix lost at 6.00 s, 2 satellites"),
            Event(9.0, 90, "a", "fix_lost", "gnss.satellites", 2.0, "a: gnss fix lost at 9.00 s, 2 satellites"),
        ]

    found = losses(Log(streams), np.array([8.0, np.inf, np.inf]))  # type: ignore[arg-type]
    assert [(loss.vehicle, loss.time, loss.then) for loss in found] == [
        (1, 2.0, [("fix lost, land", 2.1), ("GNSS back", 3.0)]),
        (2, 4.5, []),
    ]
    # The reaction to a lost fix, and its end, are found by "gnss".
    assert [own.time for own, words in zip(recording.events, search_words(recording.events), strict=True) if words] == [
        3.5,
        4.0,
        6.0,
        7.0,
    ]


def test_gnss_is_lost_where_no_receiver_is_left_and_the_loss_with_a_reaction_is_told():
    columns = [f"{own}.{name}" for own in ("gnss", "rtk") for name in ("position_ned.x", "satellites")]

    def of(vehicle: str, *changes: tuple[float, str, str]) -> list[Event]:
        return [Event(at, 0, vehicle, kind, name, 2.0, f"{vehicle}: {name}") for at, kind, name in changes]

    class Log(dict[str, Any]):
        vehicles = NAMES
        events: ClassVar[list[Event]] = [
            *of("a", (1.0, "fix_lost", "rtk.satellites"), (2.0, "fix_found", "rtk.satellites")),
            *of("b", (1.0, "fix_lost", "gnss.satellites"), (2.0, "fix_lost", "rtk.satellites")),
            *of("b", (3.0, "fix_found", "gnss.satellites"), (4.0, "fix_found", "rtk.satellites")),
            *of("c", (1.0, "fix_lost", "gnss.satellites"), (1.0, "fix_lost", "rtk.satellites")),
            *of("c", (1.5, "fix_found", "gnss.satellites"), (4.0, "fix_lost", "gnss.satellites")),
            Event(4.1, 0, "c", "failsafe", "fix", 3.0, "c: failsafe: fix lost, land, at 4.10 s"),
        ]

    streams = {"measurements": SimpleNamespace(columns=lambda: columns), "events": None}
    found = losses(Log(streams), np.full(3, np.inf))  # type: ignore[arg-type]
    assert [(loss.vehicle, loss.time, loss.then) for loss in found] == [
        (1, 2.0, [("GNSS back", 3.0)]),
        (2, 4.0, [("fix lost, land", 4.1)]),
    ]


def test_three_vehicles_that_lost_gnss_have_lines(plots: Plots, monkeypatch: pytest.MonkeyPatch):
    every = [Loss(vehicle, float(vehicle)) for vehicle in (0, 1, 2, 0, 1)]
    monkeypatch.setattr(highlights, "losses", lambda run, ends: every)
    assert list(highlights._lost_gnss(plots._series[0]))[2:] == [
        (2.0, "GNSS lost: c 2.00 s"),
        (0.0, "GNSS lost: 2 more vehicles"),
    ]


@pytest.mark.parametrize(
    ("stops", "told"),
    [
        ([], (8.0, "closest pairs: a and c, 1.00 m at 8.00 s; b and c, 4.00 m at 4.00 s; a and b, 15.53 m at 4.00 s")),
        ([("a", 3.0, "crashed", None)], (4.0, f"closest pairs: b and c, 4.00 m at 4.00 s; {OF_A}")),
        # Vehicles collide with those that lie where they stopped.
        (
            [("a", 3.0, "crashed", None), ("c", 9.0, "collision", 0.48)],
            (
                9.0,
                "closest pairs: c and a, 0.48 m at 9.00 s (a had stopped); b and c, 4.00 m at 4.00 s; "
                "a and b, 17.24 m at 2.60 s",
            ),
        ),
        # Both stop at once.
        (
            [("b", 4.1, "collision", 0.3), ("c", 4.1, "collision", 0.3)],
            (
                4.1,
                "closest pairs: b and c, 0.30 m at 4.10 s; a and c, 8.00 m at 0.00 s; a and b, 15.53 m at 4.00 s",
            ),
        ),
    ],
)
def test_closest_counts_while_both_fly(
    recording: Recording, stops: list[Any], told: tuple[float, str], monkeypatch: pytest.MonkeyPatch
):
    field = {"collision": "distance", "crashed": "impact_speed"}
    events = [(Event(at, 0, who, kind, field[kind], value, ""), NAMES.index(who)) for who, at, kind, value in stops]
    monkeypatch.setattr(recording, "stops", events)
    [series] = Plots(recording)._series
    assert list(highlights._closest(series)) == [(pytest.approx(told[0]), told[1])]


def test_curves_end_at_the_stop_with_what_its_event_says(plots: Plots):
    def line(name: str, vehicle: int) -> Any:
        found = plots._line([name, vehicle], np.linspace(0.0, 9.9, 11))
        return None if found is None else {key: pytest.approx(value) for key, value in found[0].items()}

    fence = line("derived.fence_distance", 0)
    assert (fence["low"], fence["lowAt"]) == (-0.25, 3.0)
    assert line("derived.wind_speed", 0)["high"] == 3.0
    assert line("truth.battery.charge", 0)["low"] == 0.971
    assert (line("derived.nearest_vehicle", 1)["low"], line("derived.nearest_vehicle", 2)["low"]) == (3.75, 4.0)
    # Of the other vehicles, one quantity for each.
    assert (line("derived.distance_to.c", 1)["low"], line("derived.distance_to.c", 1)["lowAt"]) == (3.75, 5.0)
    assert line("derived.distance_to.b", 2)["low"] == 4.0
    # At 2.6 s a is 8.84 m north, and b 14.8 m east.
    assert line("derived.distance_to.a", 1)["low"] == pytest.approx(17.239, abs=1e-3)
    assert np.isnan(plots._series[0].values("derived.distance_to.a")[1][:, 0]).all()
    assert line("derived.distance_to.z", 0) is None
    # After its stop there is no value.
    values = plots._series[0].values("derived.fence_distance")[1][:, 0]
    assert np.isnan(values[31:]).all()
    assert np.isfinite(values[:31]).all()


def test_separation_is_found_and_pages_without_a_server_compute_it(plots: Plots):
    about: Any = plots.about()
    words = {name: doc for name, _, doc in about["quantities"] if "separation" in doc}
    assert list(words) == ["derived.nearest_vehicle", *(f"derived.distance_to.{name}" for name in NAMES)]
    assert words["derived.distance_to.b"] == "separation: distance to b of the same run, while both fly"
    assert "derived.distance_to.a" not in plots.quantities
    stored = dict(zip(plots.quantities, next(plots.of_vehicles()), strict=True))
    # Ten values a second up to 9.9 s: the one at 3 s has the depth outside.
    assert np.nanmin(stored["derived.fence_distance"]) == pytest.approx(-0.25)
    assert np.nanmax(stored["derived.wind_speed"]) == 3.0
    assert np.isnan(stored["truth.battery.charge"][31:]).all()


def test_many_are_counted(plots: Plots):
    [series] = plots._series
    firsts = [(1.0, 0), (2.0, 1), (3.0, 2), (4.0, 0), (5.0, 1), (6.0, 2), (7.0, 0)]
    assert highlights._with_times(series, firsts) == "a 1.00 s, b 2.00 s, c 3.00 s, a 4.00 s, b 5.00 s, and 2 more"


def test_events_and_states_say_it_in_the_same_words(recording: Recording):
    told = {event.time: event.message for event in recording.events}
    assert told[3.0] == "a stopped: left the area to the north by 0.25 m, at 3.00 s"
    assert told[5.0] == "b stopped: came too close to c, 3.75 m, at 5.00 s"
    assert told[6.0] == "c: failsafe continues: land, at 6.00 s"
    assert told[7.0] == "c: failsafe ends at 7.00 s"
    # b had stopped half a second before its fault ended.
    assert 5.5 not in told
    assert recording.frame(5.0).reasons == {
        0: "left the area to the north",
        1: "came too close to c, 3.75 m",
    }


def test_a_failsafe_is_shown_until_it_ended_and_a_charge_until_the_stop(recording: Recording):
    modes = [(3.4, None), (3.5, "failsafe: fix lost, land"), (4.0, "failsafe: position lost, descend")]
    modes += [(6.0, "failsafe: land"), (6.9, "failsafe: land"), (7.0, None), (8.0, None)]
    assert [(time, recording._details.at(time).modes.get(2)) for time, _ in modes] == modes
    np.testing.assert_allclose(recording._details.at(2.9).charge, [0.971, 0.971, 0.971], atol=1e-6)
    # In the log its battery drains on.
    np.testing.assert_allclose(recording._details.at(9.0).charge, [0.971, 0.951, 0.91], atol=1e-6)
