"""Commands of fleets whose vehicles take different records."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.core.tree import quantity, record
from qrsim.errors import UsageError
from qrsim.interface.actions import ActionChecker


@record
class Wheels:
    """What a rover is asked for; each (n,)."""

    speed: Any = quantity(unit="m/s", doc="speed forward", minimum=-2.0, maximum=3.0)
    turn: Any = quantity(unit="rad/s", doc="turn to the right")


def fleet(name: str, size: int, kind: type) -> Any:
    vehicle = SimpleNamespace(command_type=kind, actions=(kind,))
    names = tuple(f"{name}_{i}" for i in range(size))
    return SimpleNamespace(name=name, size=size, vehicle=vehicle, vehicle_names=names, controller=None)


def checker(*fleets: Any) -> ActionChecker:
    return ActionChecker(SimpleNamespace(fleets=fleets), np.dtype(np.float32))  # type: ignore[arg-type]


UAVS, ROVERS = fleet("uavs", 2, qrsim.Command), fleet("rovers", 1, Wheels)


def test_an_array_has_the_width_of_the_record_of_its_fleet() -> None:
    commands = {"uavs": [[0.1, 0.0, 0.6, 0.0, 11.0]] * 2, "rovers": [[1.0, 40.0]]}
    first, second = checker(UAVS, ROVERS).actions(commands)
    assert (type(first), type(second)) == (qrsim.Command, Wheels)
    np.testing.assert_array_equal(first.throttle, np.float32([0.6, 0.6]))
    np.testing.assert_array_equal(second.turn, np.float32([40.0]))
    with pytest.raises(UsageError, match=r"expected shape \(1, 2\) \(vehicles; speed, turn\), found shape \(1, 5\)"):
        checker(ROVERS).actions(np.zeros((1, 5)))


def test_limits_are_those_of_the_record() -> None:
    with pytest.raises(UsageError, match=r"speed of vehicle 0 \('rovers_0'\) is 3\.5; allowed: -2 to 3"):
        checker(ROVERS).actions([[3.5, 0.0]])
    with pytest.raises(UsageError, match=r"turn of vehicle 0 .* is inf"):
        checker(ROVERS).actions([[1.0, np.inf]])


def test_one_command_for_fleets_that_take_different_ones_is_refused() -> None:
    with pytest.raises(UsageError, match=r"a Command is not for the vehicles of fleet 'rovers', which take Wheels;"):
        checker(UAVS, ROVERS).actions(np.zeros((3, 5)))
    with pytest.raises(UsageError, match=r"a Wheels is not for the vehicles of fleet 'uavs', which take Command"):
        checker(UAVS, ROVERS).actions(Wheels(np.zeros(3), np.zeros(3)))
