"""Multirotors in scenarios: sets, arrangements, six numbers, what is derived, and what cannot fly."""

from __future__ import annotations

import json
from typing import Any

import pytest

import qrsim
from qrsim.cli import main
from qrsim.errors import ScenarioError
from qrsim.scenarios.derived import derived_of
from qrsim.scenarios.scenario import load_scenario

OWN = {
    "mass": 1.2,
    "arm": 0.225,
    "rotors": 4,
    "hover_throttle": 0.5,
    "thrust_to_weight": 2.2,
    "attitude_bandwidth": 8.0,
}


def content(vehicle: dict[str, Any], **fleet: Any) -> dict[str, Any]:
    whole = {
        "vehicle": {"type": "multirotor", **vehicle},
        "controller": {"type": "cascade", "feed": "truth"},
        "vehicles": [{"position_ned": [0.0, 0.0, -10.0]}],
        **fleet,
    }
    return {"name": "own", "duration": 1.0, "fleets": {"a": whole}}


def problems(vehicle: dict[str, Any]) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content(vehicle))
    return caught.value.problems


def test_a_set_and_what_differs_from_it() -> None:
    spec = load_scenario(content({"model": "hexa4", "mass": 5.0})).spec.fleets["a"].vehicle
    assert (spec.mass, spec.speed_max, len(spec.rotors)) == (5.0, 700.0, 6)


def test_six_numbers_and_what_is_known_better() -> None:
    scenario = load_scenario(content({"own": OWN, "drag_x": 0.05, "stabiliser": {"yaw_gain": 2.0}}))
    spec = scenario.spec.fleets["a"].vehicle
    assert spec.speed_max == pytest.approx(636.5623, rel=1e-6)
    assert (spec.drag_x, spec.stabiliser.yaw_gain, spec.stabiliser.rate_gain) == (0.05, 2.0, 24.0)
    # What a run folder keeps needs no rule of thumb any more.
    again = load_scenario(json.loads(scenario.spec.model_dump_json()))
    assert again.spec == scenario.spec
    alone = qrsim.make_scenario(
        [[0.0, 0.0, -10.0]],
        vehicle=qrsim.own_multirotor(**OWN, drag_x=0.05),
        controller={"type": "cascade", "feed": "truth"},
    )
    assert alone.spec.fleets["vehicles"].vehicle.rotors == spec.rotors


@pytest.mark.parametrize(("bandwidth", "gains"), [(4.0, (0.571429, 1.111111)), (9.0, (1.2, 2.2))])
def test_a_slow_vehicle_gets_a_slower_cascade(bandwidth: float, gains: tuple[float, float]) -> None:
    found = load_scenario(content({"own": {**OWN, "attitude_bandwidth": bandwidth}})).spec.fleets["a"].controller
    assert (found.position_gain, found.velocity_gain) == pytest.approx(gains, rel=1e-5)
    given = content({"own": OWN}, controller={"type": "cascade", "feed": "truth", "position_gain": 0.3})
    assert load_scenario(given).spec.fleets["a"].controller.position_gain == 0.3


def test_an_arrangement_takes_the_place_of_the_rotors() -> None:
    spec = load_scenario(content({"geometry": "octo_x", "arm": 0.4, "rotor_height": 0.1})).spec.fleets["a"].vehicle
    assert len(spec.rotors) == 8
    assert spec.rotors[0].position[2] == -0.1


@pytest.mark.parametrize(
    ("vehicle", "problem"),
    [
        ({"model": "x50"}, "model: no multirotor is called 'x50'; did you mean 'x500'?"),
        ({"model": "x500", "own": OWN}, "own: gives both 'own' and 'model'; give one"),
        ({"own": {"mass": 1.0}}, "own: arm and rotors and hover_throttle and "),
        ({"own": {**OWN, "mas": 1.0}}, "own.mas: no such number; did you mean 'mass'?"),
        ({"own": 3}, "own: expected mass, arm, rotors, hover_throttle, thrust_to_weight, attitude_band"),
        ({"own": {**OWN, "mass": "heavy"}}, "own.mass: 'heavy'; allowed: 0.01 to 100 kg"),
        ({"own": {**OWN, "hover_throttle": 0.9}}, "own.hover_throttle: 0.9; with thrust_to_weight 2.2 a vehicle "),
        ({"arm": 0.3}, "arm: without geometry; give one of quad_x, quad_plus, hexa_x, hexa_plus, "),
        ({"geometry": "quad_x"}, "arm: expected a length [m], found None"),
        ({"geometry": "quad_x", "arm": -0.3}, "arm: -0.3 m; allowed: above 0"),
        ({"geometry": "quad_y", "arm": 0.3}, "geometry: no arrangement is called 'quad_y'; did you mean 'quad_x'?"),
        ({"geometry": "quad_x", "arm": 0.3, "rotors": []}, "geometry: gives both 'geometry' and 'rotors'; give one"),
        ({"rotors": []}, "rotors: no rotors; allowed: 4 to 16"),
    ],
)
def test_what_is_written_wrongly(vehicle: dict[str, Any], problem: str) -> None:
    assert problems(vehicle)[0].startswith(f"fleets.a.vehicle.{problem}")


def test_show_says_what_follows(tmp_path: Any, capsys: Any) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(json.dumps(content({"own": OWN})), encoding="utf-8")
    assert main(["show", str(path), "--derived", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["a"]
    assert told == derived_of(load_scenario(str(path)))["a"]
    assert told["hover_throttle"] == pytest.approx(0.5)
    assert {"mass_kg", "inertia_x_kg_m2", "rotor_radius_m", "k_t_n_s2", "k_q_n_m_s2", "speed_max_rad_s"} <= set(told)
    assert {"thrust_to_weight", "spin_up_s", "roll_time_constant_s", "wind_held_m_s"} <= set(told)
    assert main(["show", str(path)]) == 0
    assert "#   hover_throttle: 0.5\n" in capsys.readouterr().out
    assert main(["show", "hover_ideal", "--derived"]) == 0
    # 32.85 N over 1.68 kg at the published battery.
    assert "  thrust_to_weight: 1.993\n" in capsys.readouterr().out
