"""Colours of a live flight by a quantity: what is kept, and how the range grows."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.view.frame import Frame
from qrsim.view.live_paint import LivePaints


def frame(time: float, heights: list[float]) -> Frame:
    """Return a frame of vehicles that stand at these heights [m], in still air, with estimates 1 m too far north."""
    place = np.zeros((len(heights), 3))
    place[:, 2] = -np.array(heights)
    still, north = np.zeros_like(place), np.array([1.0, 0.0, 0.0])
    return Frame(time, place, still, place + north, place + np.nan, still, still, np.ones(len(heights), bool))


def test_the_range_grows_and_values_are_those_of_the_time():
    paints = LivePaints(2)
    paint = paints.of("height")
    paint = paints.note(frame(0.0, [20.0, 28.0]), paint)
    assert paint is not None
    # In steps of a quarter of a decade of the width: 2.5 m of 8 m is 0.25.
    assert (paint.low, paint.high) == (20.0, 28.0)
    # Within the range nothing is coloured again.
    assert paints.note(frame(1.0, [21.0, 27.0]), paint) is None
    wider = paints.note(frame(2.0, [22.0, 61.0]), paint)
    assert wider is not None
    # A width of 41 m has steps of 2.5 m.
    assert (wider.low, wider.high) == (20.0, 62.5)
    np.testing.assert_array_equal(wider.values(np.array([-1.0, 0.5, 1.0, 9.0]))[:, 0], [np.nan, 20.0, 21.0, 22.0])
    # The lowest colour of viridis.
    colours = wider.colours(np.array([0.0, 2.0]))
    assert colours[0, 0].tolist() == [68, 1, 84]


@pytest.mark.parametrize(("name", "value"), [("speed", np.nan), ("wind speed", 0.0), ("estimate error", 1.0)])
def test_quantities(name: str, value: float):
    paints = LivePaints(1)
    paint = paints.of(name)
    paint = paints.note(frame(0.0, [5.0]), paint) or paint
    assert paint.values(np.zeros(1))[0, 0] == pytest.approx(value, nan_ok=True)
    assert paint.high > paint.low


def test_another_colour_keeps_nothing():
    paints = LivePaints(1)
    own = paints.of("height")
    assert paints.note(frame(0.0, [5.0]), None) is None
    other = LivePaints(1).of("height")
    assert paints.note(frame(0.0, [5.0]), other) is None
    assert np.isnan(own.values(np.zeros(1))).all()
    # A time before the last one begins another flight.
    own = paints.note(frame(3.0, [5.0]), own) or own
    paints.note(frame(1.0, [5.1]), own)
    assert np.isnan(own.values(np.zeros(1))).all()
    assert own.values(np.array([1.0]))[0, 0] == pytest.approx(5.1)
