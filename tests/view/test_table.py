"""The table of all vehicles: its numbers and words, without a browser."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from qrsim.errors import RunError
from qrsim.view.details import Details
from qrsim.view.frame import Cast, Frame
from qrsim.view.table import COLUMNS, answer, table_of

NAN3 = np.full((3, 3), np.nan)
# The first flies at 5 m/s and is believed to be 2 m away; the second has stopped; of the third nothing is known.
KNOWN = Details(
    velocity_ned=np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0], [np.nan] * 3]),
    thrust=np.zeros(3),
    believed_ned=np.array([[10.0, 22.0, -30.0], [0.0, 0.0, 0.0], [np.nan] * 3]),
    std_ned=np.array([[1.0, 2.0, 2.0], [1.0, 1.0, 1.0], [np.nan] * 3]),
    charge=np.array([0.5, 0.25, np.nan]),
    waypoint=np.array([1.0, 0.0, np.nan]),
    modes={},
)
PLACES = np.array([[10.0, 20.0, -30.0], [0.0, 0.0, 0.0], [1.0, 1.0, -1.0]])
FRAME = Frame(
    5.0, PLACES, NAN3, NAN3, NAN3, NAN3, NAN3, np.array([True, False, True]), {1: "hit <b>"}, details=lambda: KNOWN
)


def rows(frame: Frame, **changes: Any) -> tuple[dict[str, list[float]], list[str]]:
    """Return the columns by name, and the text of each vehicle's state."""
    given: dict[str, Any] = {"waypoints": (4, 4, 0), "stops": {1: 4.256}} | changes
    values, texts = table_of(frame, **given)
    found = dict(zip(COLUMNS, values.tolist(), strict=True))
    return found, [texts[int(number)] for number in found["text"]]


def test_numbers_and_states():
    found, states = rows(FRAME)
    assert (found["north"][0], found["east"][0], found["height"][0]) == (10.0, 20.0, 30.0)
    assert (found["speed"][0], found["charge"][:2], found["error"][0], found["std"][0]) == (5.0, [0.5, 0.25], 2.0, 3.0)
    # 2 m to the east, of which 2 m is one standard deviation; the errors of the second are 0.
    assert found["sigmas"][:2] == [1.0, 0.0]
    assert states == ["waypoint 2 of 4", "stopped at 4.26 s: hit <b>", ""]
    assert found["stopped"][1] == 4.256
    unknown = [found[name][2] for name in ("speed", "charge", "error", "std", "sigmas", "stopped")]
    assert all(map(math.isnan, unknown))


def test_a_live_page_knows_about_when():
    assert rows(FRAME, exact=False)[1][1] == "stopped at about 4.3 s: hit <b>"
    assert rows(FRAME, stops={})[1][1] == "stopped: hit <b>"
    # A vehicle that is not valid any more, of which no event tells why.
    silent = replace(FRAME, reasons={})
    assert rows(silent)[1][1] == "stopped at 4.26 s"


def test_a_failsafe_is_named_in_place_of_the_waypoint():
    details = replace(KNOWN, modes={0: "failsafe: land"})
    assert rows(replace(FRAME, details=lambda: details))[1][0] == "failsafe: land"


def test_a_damaged_stream_leaves_positions():
    def damaged() -> Details:
        raise RunError("commands: damaged")

    found, states = rows(replace(FRAME, details=damaged))
    assert found["north"] == [10.0, 0.0, 1.0]
    assert np.isnan(found["speed"]).all()
    assert states == ["", "stopped at 4.26 s: hit <b>", ""]


def test_texts_are_sent_once():
    def head(**wish: Any) -> tuple[Any, np.ndarray]:
        data = answer(wish, FRAME, (4, 4, 0), {}, True)
        size = int.from_bytes(data[:4], "little")
        return json.loads(data[4 : 4 + size]), np.frombuffer(data[4 + size :], "<f4").reshape(10, 3)

    first, values = head(number=7)
    assert (first["number"], first["time"], len(first["texts"])) == (7, 5.0, 3)
    np.testing.assert_array_equal(values[0], [10.0, 0.0, 1.0])
    again, _ = head(number=8, known=first["key"])
    assert (again["number"], "texts" in again) == (8, False)
    assert answer({"number": 9}, None, (), {}, True)[4:].strip() == b'{"number": 9}'


@pytest.mark.parametrize(("counts", "wanted"), [((), (2, 0)), ((5, 6), (5, 6))])
def test_waypoints_are_those_of_the_routes(counts: tuple[int, ...], wanted: tuple[int, ...]):
    routes = (np.zeros((3, 3)), np.zeros((0, 3)))
    cast = Cast(("a", "b"), np.zeros(2, int), np.zeros((2, 3)), routes=routes, counts=counts)
    assert cast.waypoints == wanted
