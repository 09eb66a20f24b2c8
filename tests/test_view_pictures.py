"""The pictures of the 3-D page in docs/: one for each family, small enough to be kept with the code."""

from __future__ import annotations

import pytest
from evidence import pictures

from qrsim.scenarios.reading import built_in_names


def test_every_shot_is_of_a_known_scenario_and_is_there():
    page = (pictures.IMAGES.parent / "view.md").read_text("utf-8")
    for family, shot in pictures.SHOTS.items():
        assert isinstance(shot.scenario, int) or shot.scenario in built_in_names()
        assert 20_000 < (pictures.IMAGES / f"view_{family}.png").stat().st_size < 300_000
        assert f"](images/view_{family}.png)" in page


def test_families_with_a_task_of_their_own_are_shown():
    folders = {name.partition("/")[0] for name in built_in_names() if "/" in name}
    assert folders <= set(pictures.SHOTS)


def test_a_wrong_name_is_refused(capsys: pytest.CaptureFixture[str]):
    assert pictures.main(["swrm"]) == 2
    assert "no family of scenarios 'swrm'; did you mean 'swarm'?" in capsys.readouterr().err
