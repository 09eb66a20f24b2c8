"""Colour of vehicles and paths by a quantity, from a log of known numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.runs.layout import INDEX, Column
from qrsim.runs.stream_arrays import Batch
from qrsim.view.paint import Paints, colour_map

TIMES = np.arange(101) * 0.1
# Two vehicles: one flies north at 3 m/s, 4 m/s up and down; the other stands.
SPEED = {"velocity_body.x": 3.0, "velocity_body.y": 0.0, "velocity_body.z": 4.0}


class Log:
    """A run with streams of columns (T, 2)."""

    vehicles = ("a", "b")

    def __init__(self, **streams: dict[str, Any]):
        self._streams = streams
        self.streams = (*streams, "events")

    def __contains__(self, name: str) -> bool:
        return name in self._streams

    def describe(self, stream: str) -> list[Column]:
        """Return the columns, which are all in metres."""
        return [*INDEX, *(Column(name, "m", "", "float32") for name in self._streams[stream])]

    def __getitem__(self, stream: str) -> Any:
        columns = self._streams[stream]
        batches = lambda names: [Batch(TIMES, np.arange(len(TIMES)), {n: columns[n] for n in names})]  # noqa: E731
        found = SimpleNamespace(time=TIMES, batches=batches, columns=lambda: tuple(columns))
        return type("Stream", (SimpleNamespace,), {"__contains__": lambda _, name: name in columns})(**vars(found))


def constant(first: float, second: float) -> np.ndarray:
    return np.tile(np.array([first, second], np.float32), (len(TIMES), 1))


@pytest.fixture
def paints() -> Paints:
    truth = {name: constant(value, 0.0) for name, value in SPEED.items()}
    truth |= {f"position_ned.{axis}": constant(0.0, -7.0) for axis in "xyz"}
    ramp = np.stack([TIMES, np.full(len(TIMES), np.nan)], axis=1).astype(np.float32)
    fix = {f"gnss.position_ned.{axis}": constant(2.0, np.nan) for axis in "xyz"}
    return Paints(Log(truth=truth | {"charge": ramp}, measurements=fix))  # type: ignore[arg-type]


def test_quantities_are_columns_and_what_is_computed_from_them(paints: Paints) -> None:
    assert paints.names[:3] == ["speed", "height", "GNSS error"]
    assert "truth.charge" in paints.names
    assert "wind speed" not in paints.names
    np.testing.assert_allclose(paints.of("speed").values(np.array([1.0]))[0], [5.0, 0.0])
    np.testing.assert_allclose(paints.of("height").values(np.array([1.0]))[0], [0.0, 7.0])
    error = paints.of("GNSS error").values(np.array([1.0]))[0]
    assert error[0] == pytest.approx(12.0**0.5)
    assert np.isnan(error[1])


def test_the_range_is_that_of_the_whole_run(paints: Paints) -> None:
    charge = paints.of("truth.charge")
    # Of 0 to 10 in steps of 0.1, the percentiles 1 and 99.
    assert (charge.low, charge.high) == pytest.approx((0.1, 9.9))
    assert charge.told()["title"] == "truth.charge [m]"
    assert charge.told()["ends"] == ["\u2264 0.1", "\u2265 9.9"]
    first, last = charge.colours(np.array([0.0, 10.0]))[:, 0]
    # Viridis begins and ends so (matplotlib).
    assert first.tolist() == [68, 1, 84]
    assert last.tolist() == [253, 231, 37]
    # Nothing is known of the second vehicle.
    assert charge.colours(np.array([5.0]))[0, 1].tolist() == [115, 115, 118]


def test_a_wrong_name_is_refused_with_the_right_one(paints: Paints) -> None:
    with pytest.raises(UsageError, match=r"no such quantity; did you mean 'truth.charge'"):
        paints.of("truth.charg")


def test_the_colour_map_is_perceptually_uniform() -> None:
    """Lightness L* (CIE 1976) rises by steps that differ little."""
    share = colour_map() / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    lightness = 116.0 * np.cbrt(luminance) - 16.0
    steps = np.diff(lightness[1:])
    assert steps.min() > 1.5
    assert steps.max() < 3.5
