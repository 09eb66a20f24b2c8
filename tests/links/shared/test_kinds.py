"""Numbers of orders: which field of a set-point each of them is, and in which unit."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.control.setpoints import SETPOINTS
from qrsim.core.tree import walk
from qrsim.errors import UsageError
from qrsim.links.contracts import Order
from qrsim.links.shared.kinds import CONTROL, FIELDS, NAMES, Field, checked, record_of

# Fields of set-points with the names that their axes have in an order; others have one name.
AXES = {
    **{f"position_ned.{axis}": axis for axis in "xyz"},
    **{f"begin_ned.{axis}": f"begin_{axis}" for axis in "xyz"},
    "velocity_ned.x": "velocity_north",
    "velocity_ned.y": "velocity_east",
    "velocity_ned.z": "velocity_down",
    "acceleration_ned.x": "acceleration_north",
    "acceleration_ned.y": "acceleration_east",
    "acceleration_ned.z": "acceleration_down",
}


@pytest.mark.parametrize("kind", FIELDS)
def test_each_number_goes_into_the_field_of_its_name_and_unit(kind):
    columns = np.arange(float(len(FIELDS[kind])))[:, None]
    record = record_of(kind, columns, type(None))
    assert type(record) is SETPOINTS[kind]
    named = [(AXES.get(name, name), info.unit, leaf.item()) for name, leaf, info in walk(record)]
    assert named == [(name, unit, number) for number, (name, unit) in enumerate(FIELDS[kind])]


def test_every_kind_of_setpoint_can_be_ordered_and_keeps_its_number_in_recordings():
    assert set(FIELDS) == set(SETPOINTS)
    assert NAMES == (
        "waypoint",
        "velocity",
        "velocity_height",
        "attitude_height",
        "attitude",
        "path",
        "control",
        "track",
    )


@pytest.mark.parametrize(("kind", "place"), [("velocity_height", 2), ("attitude_height", 2)])
def test_no_height_is_below_the_ground(kind, place):
    kinds = {kind: tuple(Field(*field) for field in FIELDS[kind])}
    numbers = [0.0, 0.0, 0.0, 0.0]
    checked(Order("a", kind, tuple(numbers)), kinds, np.dtype(np.float32))
    numbers[place] = 0.5
    with pytest.raises(UsageError, match=r"'a': \w+: z is 0.5, below the ground; z is down: -0.5 is 0.5 m up"):
        checked(Order("a", kind, tuple(numbers)), kinds, np.dtype(np.float32))


def test_rounding_pushes_no_number_out_of_its_range():
    """The nearest number to 0.9 in single precision is 0.89999998 (0x3F666666), which is below the range."""
    low, high = np.float32(0.9).item(), np.float32(0.1).item()
    assert low < 0.9
    assert high > 0.1
    kinds = {CONTROL: (Field("throttle", "1", 0.9, 1.0), Field("roll", "rad", -1.0, 0.1))}
    order = Order("a", CONTROL, (low, high))
    assert checked(order, kinds, np.dtype(np.float32)) is order
    with pytest.raises(UsageError, match=r"throttle is 0\.9; allowed: 0\.9 to 1"):
        checked(order, kinds, np.dtype(np.float64))
    with pytest.raises(UsageError, match=r"throttle is 0\.89; allowed: 0\.9 to 1"):
        checked(Order("a", CONTROL, (0.89, 0.1)), kinds, np.dtype(np.float32))
