"""Receivers of a scenario that use the published list of satellites."""

from __future__ import annotations

from qrsim.core.arrays import NumpyArray
from qrsim.errors import warn_user
from qrsim.models.gnss.receivers import HAND_LIST
from qrsim.scenarios.schema import ScenarioSpec


def hand_lists(scenario: ScenarioSpec) -> list[str]:
    """Return the scenario paths of GNSS receivers that use "hand_list", a published list of satellites."""
    return [
        f"fleets.{name}.sensors.{sensor_name}.satellites"
        for name, fleet in scenario.fleets.items()
        for sensor_name, sensor in fleet.sensors.items()
        if vars(sensor).get("satellites") == "hand_list"
    ]


def warn_of_hand_lists(scenario: ScenarioSpec, satellite_ids: NumpyArray) -> None:
    """Warn of GNSS receivers that use "hand_list" when the orbits lack satellites of that list."""
    there = {int(number) & 0xFF for number in satellite_ids}
    absent = [f"{prn}" for prn in HAND_LIST if prn not in there]
    if absent:
        for path in hand_lists(scenario):
            warn_user(
                f"{path}: world.sky.orbits lacks the satellites {', '.join(absent)} of the hand list; receivers choose "
                f"among {len(HAND_LIST) - len(absent)} instead of {len(HAND_LIST)}"
            )
