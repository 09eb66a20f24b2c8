"""``qrsim run --policy baseline``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from qrsim import cli
from qrsim.runs import open_run


@pytest.mark.long
def test_the_cats_of_a_baseline_chase_the_mouse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Eight seconds of a chase: they come nearer; left alone they hover while the mouse runs away."""
    monkeypatch.chdir(tmp_path)
    options = ["--policy", "baseline", "--duration", "8", "--out", "chase", "--no-figure", "--json"]
    assert cli.main(["run", "cats_and_mouse/1A", *options]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["events"] == []
    truth = open_run(tmp_path / "chase")["truth"]
    place = np.stack([truth["position_ned.x"], truth["position_ned.y"]], axis=-1)
    # At rest a cat would be some 40 m away from where the mouse is by now.
    assert np.linalg.norm(place[-1, :3] - place[-1, 3], axis=-1).max() < 30.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["hover", "--policy", "baseline"], "--policy baseline: scenario hover has no task"),
        (["cats_and_mouse/1A", "--policy", "baseline", "--policy-ticks", "5"], "is called once per step of its task"),
    ],
)
def test_what_has_no_baseline_says_so(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", *arguments]) == 2
    assert message in capsys.readouterr().err
