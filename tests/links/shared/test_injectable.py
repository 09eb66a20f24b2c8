"""Parts that clients may let fail: the option ``--injectable`` of every command."""

from __future__ import annotations

import pytest

from qrsim.errors import UsageError
from qrsim.links.shared.injectable import of_those, with_injectable
from qrsim.scenarios.scenario import load_scenario


@pytest.mark.parametrize(
    ("scenario", "name", "said"),
    [
        ("outdoor_patrol", "radio", "--injectable radio: no fleet has a radio; the scenario needs world.radio"),
        ("outdoor_patrol", "battery", "--injectable battery: no fleet has a battery that drains, such as"),
        ("outdoor_patrol", "rotors", "--injectable rotors: only a 'multirotor' has rotors that can fail"),
        ("outdoor_patrol", "rotor", "--injectable rotor: there is no such sensor; did you mean 'rotors'?"),
        ("outdoor_patrol", "gps", "--injectable gps: there is no such sensor; did you mean 'gnss'?"),
    ],
)
def test_a_part_that_no_fleet_has_is_refused(scenario: str, name: str, said: str) -> None:
    with pytest.raises(UsageError) as refused:
        with_injectable(load_scenario(scenario), ["gnss", name])
    assert str(refused.value).startswith(said)


def test_fleets_get_the_parts_that_they_have() -> None:
    mixed = load_scenario("mixed_team")
    may = {name: fleet.injectable for name, fleet in with_injectable(mixed, ["rotors"]).spec.fleets.items()}
    assert {name: spec.rotors for name, spec in may.items() if spec is not None and spec.rotors} == {
        "quads": [0, 1, 2, 3],
        "hexas": [0, 1, 2, 3],
    }
    may = {name: fleet.injectable for name, fleet in with_injectable(mixed, ["body"]).spec.fleets.items()}
    assert {name for name, spec in may.items() if spec is not None and spec.body} >= {"quads", "hexas"}
    # Tasks of a server: those names that a scenario has.
    assert of_those(load_scenario("outdoor_patrol"), ["all", "gnss", "radio", "rotors", "range"]) == ["all", "gnss"]
    assert of_those(load_scenario("mavlink_field"), ["battery", "rotors", "radio"]) == ["battery", "rotors"]
