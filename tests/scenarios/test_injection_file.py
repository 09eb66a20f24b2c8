"""Files of injections: what becomes of them, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from qrsim.errors import UsageError
from qrsim.scenarios.injection_file import read_injections
from qrsim.scenarios.scenario import Scenario, load_scenario


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    content: dict[str, Any] = {"name": "two", "duration": 60.0, "fleets": {}}
    for name, vehicle in (("quad", {"type": "multirotor", "model": "x500"}), ("plain", {"type": "pelican"})):
        place = [0.0, 0.0 if name == "quad" else 30.0, -20.0]
        content["fleets"][name] = {
            "vehicle": vehicle,
            "sensors": {"gnss": {"type": "ideal_gnss"}, f"baro_{name}": {"type": "barometer"}},
            "controller": {"type": "cascade", "feed": "truth"},
            "vehicles": [{"position_ned": place}],
            "battery": {"type": "lithium_cells" if name == "quad" else "given"},
        }
    return load_scenario(content, quiet=True)


def injected(scenario: Scenario, text: str, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the faults of each fleet, of what is given."""
    (folder / "faults.yaml").write_text(text)
    found, _ = read_injections(scenario, folder / "faults.yaml")
    return {
        name: [fault.model_dump(exclude_unset=True, exclude_none=True) for fault in fleet.faults]
        for name, fleet in found.spec.fleets.items()
    }


def test_an_entry_is_a_fault_of_the_fleets_that_have_its_target(scenario: Scenario, tmp_path: Path) -> None:
    text = """
    - {target: gnss, kind: off, at: 20, end: 30}
    - {target: baro_plain, kind: drift, field: height, rate: 0.5, at: 10, asked_by: python}
    - {target: rotor 1, kind: weak, health: 0.6, at: 5}
    - {target: rotor_3, kind: 'off', at: 8, vehicles: [quad_0]}
    - {target: rotor 2, kind: stuck, speed: 0.4, at: 9, end: 10}
    - {target: battery, kind: drop, charge: 0.2, at: 9}
    - {target: battery, kind: weak, health: 0.5, at: 9, end: 12}
    """
    off = {"sensor": "gnss", "kind": "off", "start": 20.0, "end": 30.0}
    assert injected(scenario, text, tmp_path) == {
        "quad": [
            off,
            {"type": "rotor", "rotor": 1, "at": 5.0, "health": 0.6},
            {"type": "rotor", "rotor": 3, "at": 8.0, "health": 0.0, "vehicles": ["quad_0"]},
            {"type": "rotor", "rotor": 2, "at": 9.0, "end": 10.0, "speed": 0.4},
            {"type": "battery", "at": 9.0, "charge": 0.2},
            {"type": "battery", "at": 9.0, "health": 0.5, "end": 12.0},
        ],
        "plain": [off, {"sensor": "baro_plain", "kind": "drift", "field": "height", "rate": 0.5, "start": 10.0}],
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- {target: gnsss, kind: off, at: 2}", "entry 1: there is no target 'gnsss'; did you mean 'gnss'?"),
        ("- {target: gnss, kind: off}", "entry 1: at is missing"),
        ("- {target: rotor 4, kind: off, at: 2}", "entry 1: there is no target 'rotor 4'"),
        ("- {target: rotor 1, kind: weak, at: 2}", "entry 1: health: missing; kind 'weak' needs it, 0 to 1"),
        ("- {target: rotor 1, kind: off, health: 0.6, at: 2}", "entry 1: health: kind 'off' does not take it"),
        (
            "- {target: rotor 1, kind: drift, at: 2}",
            "entry 1: kind: 'drift' does not suit a rotor; allowed: off, weak,",
        ),
        ("- {target: gnss, kind: off, at: 2, vehicles: [nobody]}", "entry 1: no vehicle is called 'nobody'"),
        ("- {target: gnss, kind: off, at: 2, vehicles: nobody}", "entry 1: vehicles: expected a list of names"),
        (
            "- {target: gnss, kind: drift, at: 2, field: position_ned.x}",
            "entry 1: rate: missing; kind 'drift' needs it",
        ),
        ("- {target: baro_quad, kind: delayed, by: 30, at: 2}", "entry 1: by: 30 s; allowed: at most 1 s, 50 readings"),
        ("- {target: gnss, kind: off, at: 61}", "entry 1: at: 61 s is not within the run"),
        ("- {target: battery, kind: off, at: 2}", "entry 1: kind: 'off' does not suit a battery; allowed: drop, weak"),
        ("- {target: battery, kind: drop, at: 2}", "entry 1: charge: missing; kind 'drop' needs it, 0 to 1"),
        ("- {target: battery, kind: drop, charge: 1, at: 2, vehicles: [plain_0]}", "there is no target 'battery'"),
        ("- {target: world, kind: wind, at: 2, speed_20ft: 5}", "entry 1: wind: only that of type log_shear"),
        ("- {target: world, kind: rain, at: 2}", "entry 1: kind: 'rain' does not suit the world; allowed: wind, gusts"),
        ("- {target: gnss, kind: 1, at: 2}", "entry 1: kind: 1; allowed: a text"),
        ("- {target: gnss, kind: off, at: .nan}", "entry 1: at: nan; allowed: a time [s]"),
        ("- {target: gnss, kind: off, at: soon}", "entry 1: at: 'soon'; allowed: a time [s]"),
        ("- {target: gnss, kind: off, at: 2, tick: 1.5}", "entry 1: tick: 1.5; allowed: a whole number from 0"),
        ("- {target: gnss, kind: ok, at: 61}", "entry 1: at: 61 s is not within the run"),
        ("- {target: gnss, kind: off, at: 2, tick: 99, end: 2}", "entry 1: end: 2 s is not after the start, 2 s"),
        ("- {target: gnss, kind: off, at: 2.01, tick: 99}", "entry 1: at: 2.01 s is not a multiple of the time step"),
        ("- {target: gnss, kind: drift, at: 2, tick: 99}", "entry 1: rate: missing"),
        (
            "- {target: gnss, kind: ok, at: 2}\n- {target: gnsss, kind: off, at: 3}",
            "entry 2: there is no target 'gnsss'",
        ),
        ("- {target: rotor 3, kind: weak, health: 2, at: 2, tick: 9}", "entry 1: health: 2; allowed: 0 to 1"),
        ("- {target: gnss, kind: off, at: 2, vehicles: []}", "entry 1: vehicles: expected a list of names"),
        ("- {target: gnss, kind: off, at: 2, duration: 3}", "entry 1: duration: there is no such number"),
        ("- {target: gnss, kind: ok, at: 2, end: 3}", "entry 1: end: kind 'ok' ends a fault at once"),
        ("- {target: gnss, kind: ok, at: 2, bias: 3}", "entry 1: bias: kind 'ok' takes no numbers"),
        ("- {target: world, kind: wind, at: 2, speed_20ft: 5, end: 3}", "entry 1: end: the world changes for all"),
        ("- {target: world, kind: wind, at: 2, vehicles: [quad_0]}", "entry 1: vehicles: the world changes for all"),
        (
            '- {target: gnss, kind: off, at: 2, asked_by: "a\\nb"}',
            "entry 1: asked_by: 'a\\nb'; allowed: a name of at most",
        ),
        ("- gnss", "entry 1: expected target, kind, at and others, not str"),
        ("target: gnss", "expected a list of injections, found dict"),
        ("", "expected a list of injections, found nothing"),
        ("- {" * 300, "faults.yaml"),
    ],
)
def test_what_is_refused(scenario: Scenario, tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        injected(scenario, text, tmp_path)
    assert message in str(caught.value)


def test_recorded_requests_may_be_later_than_the_scenario_ends(scenario: Scenario, tmp_path: Path) -> None:
    (tmp_path / "faults.yaml").write_text("- {target: gnss, kind: off, tick: 3000, at: 60.02}")
    assert [one.tick for one in read_injections(scenario, tmp_path / "faults.yaml")[1]] == [3000]


def test_a_file_has_numbers_by_field_and_none(scenario: Scenario, tmp_path: Path) -> None:
    (tmp_path / "faults.yaml").write_text(
        "- {target: gnss, kind: wrong, at: 2, bias: {position_ned.x: 3}, scale: null}\n"
        "- {target: rotor 1, kind: 'off', at: 3, end: null}\n"
    )
    first, second = read_injections(scenario, tmp_path / "faults.yaml")[1]
    assert (first.tick, first.start_tick, first.numbers) == (99, 100, {"bias": {"position_ned.x": 3}})
    assert (second.tick, second.end_tick, second.numbers) == (150, 2**31 - 1, {})


def test_a_file_that_is_not_there_names_the_nearest(scenario: Scenario, tmp_path: Path) -> None:
    (tmp_path / "faults.yaml").write_text("[]")
    with pytest.raises(UsageError, match=r"No such file or directory; did you mean 'faults.yaml'\?"):
        read_injections(scenario, tmp_path / "fault.yaml")
