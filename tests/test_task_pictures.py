"""The pictures of the tasks: one for each family, of an episode that is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from docs.writers import task_pictures as pictures

from qrsim import envs


def test_every_family_with_a_baseline_has_a_picture() -> None:
    families = {name.partition("/")[0] for name in (*envs.SINGLE, *envs.SEVERAL) if "/" in name}
    assert set(pictures.FAMILIES) == families
    for family in families:
        assert (pictures.IMAGES / f"task_{family}.png").stat().st_size > 10_000


def test_an_unknown_family_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert pictures.main(["cat_and_mouse"]) == 2
    assert "no family of tasks 'cat_and_mouse'; did you mean 'cats_and_mouse'?" in capsys.readouterr().err


def test_the_picture_that_is_shown_speaks_for_a_person_who_is_in_it() -> None:
    """Of three pictures one shows nobody, one a person faintly, one clearly; the window is the person's own."""
    corners = np.array([[20.0, 0.0], [20.0, 30.0], [0.0, 30.0], [0.0, 0.0]])

    def seen(ratio: float, away: float) -> dict[str, Any]:
        windows = np.full((1, 20, 30), -3.0)
        windows[0, 5, 12] = ratio  # 5 down from 20 north: 14.5; 12 across: 12.5
        return {"corners": corners[None] + away, "grid": np.array([[20, 30]]), "ratio": windows}

    flown: Any = type("Flown", (), {"seen": [seen(9.0, 100.0), seen(1.0, 0.0), seen(5.0, 0.0)]})
    step, vehicle, inside = pictures._shown(flown, np.array([[14.5, 12.5], [90.0, 90.0]]))
    assert (step, vehicle, inside.tolist()) == (2, 0, [True, False])


def test_a_family_is_written_where_it_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "IMAGES", tmp_path)
    monkeypatch.setitem(pictures.FAMILIES, "plume_mapping", lambda: pictures.new_figure(2.0, 2.0))
    assert pictures.main(["plume_mapping"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["task_plume_mapping.png"]
