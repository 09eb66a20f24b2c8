"""The sky over a vehicle: which satellites are drawn, where, and what is said where nothing is known of them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flight import write_flight

from qrsim.errors import UsageError
from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.runs import open_run
from qrsim.runs.sky_plot import draw_sky


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return open_run(write_flight(tmp_path_factory.mktemp("sky") / "run", vehicles=2))


class Seen:
    """A run whose receiver has two slots: G-A1 in the east that is lost half way, and one that is free."""

    def __init__(self, run: Any):
        self.info, self.vehicles = run.info, run.vehicles
        (first, *_) = NominalConstellations("G").satellite_ids
        half = np.arange(10) < 5
        rows = {
            "satellite": (np.full(10, float(first)), np.full(10, -1.0)),
            "satellite_state": (half * 1.0, np.zeros(10)),
            "cn0": (45.0 * half, np.zeros(10)),
            "azimuth": (np.full(10, np.pi / 2), np.zeros(10)),
            "elevation": (np.full(10, np.pi / 6), np.zeros(10)),
        }
        columns = {
            f"gnss.{name}.{k}": np.stack([row, row], axis=1)
            for name, pair in rows.items()
            for k, row in enumerate(pair)
        }
        self.stream = SimpleNamespace(
            time=0.2 * np.arange(10),
            columns=lambda: list(columns),
            arrays=lambda names: {name: columns[name] for name in names},
        )

    def __getitem__(self, name: str) -> Any:
        return self.stream


def test_satellites_are_drawn_where_they_are(run: Any) -> None:
    (axes,) = draw_sky(Seen(run)).axes  # type: ignore[arg-type]
    assert [text.get_text() for text in axes.texts] == ["G-A1"]
    lost, tracked = (np.asarray(part.get_offsets()) for part in axes.collections)
    # In the east, 30 deg high.
    np.testing.assert_allclose(tracked, np.tile([np.pi / 2, 60.0], (5, 1)))
    assert len(lost) == 5


def test_what_cannot_be_drawn_is_said(run: Any) -> None:
    with pytest.raises(UsageError, match="give a sensor of type gnss per_satellite: true"):
        draw_sky(run)
    with pytest.raises(UsageError, match="no vehicle is called 'nobody'"):
        draw_sky(run, ["nobody"])
    with pytest.raises(UsageError, match="of one vehicle"):
        draw_sky(run, list(run.vehicles))
    with pytest.raises(UsageError, match="no tick was logged in that span"):
        draw_sky(Seen(run), [], 5.0, 6.0)  # type: ignore[arg-type]
