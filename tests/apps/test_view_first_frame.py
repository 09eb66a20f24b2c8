"""From where a page begins: all vehicles are in the picture, also in a row that leads away from the camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from qrsim import cli
from qrsim.runs.colours import VEHICLES
from qrsim.view.browser import INSTALL, find_browser

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}"),
]


def test_ten_in_a_row_are_all_seen(tmp_path: Path) -> None:
    """Of 160 m, seen from its southern end; the dot of a name has its vehicle's colour as it is."""
    run, path = str(tmp_path / "run"), tmp_path / "row.png"
    assert cli.main(["run", "keep_spot_10", "--duration", "0.2", "--out", run, "--no-figure"]) == 0
    assert cli.main(["view", run, "--screenshot", str(path), "--size", "1280x800"]) == 0
    with Image.open(path) as picture:
        # Without the legend.
        shown = np.asarray(picture.convert("RGB"))[:, 300:]
    for number, colour in enumerate(VEHICLES):
        rows, columns = np.nonzero(np.all(shown == colour, axis=2))
        assert len(rows) > 20, number
        # Neither at the upper edge nor beside the picture.
        assert 80 < np.median(rows) < 720, number
        assert 50 < np.median(columns) < 900, number
