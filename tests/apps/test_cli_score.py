"""``qrsim score``: table, JSON and picture, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from qrsim import cli
from qrsim.runs.colours import MISSING, VEHICLES

OWN = """
import numpy as np

def cut(seen):
    return np.tile([0.0, 0.0, -1.0, 0.0, 1.0], (len(seen), 1))
"""


@pytest.fixture(autouse=True)
def _there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(OWN, "utf-8")


@pytest.mark.long
def test_a_table_and_a_picture(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--policy", "own.py:cut", "--seeds", "3", "--set", "duration=4", "--out", "scores.png"]
    assert cli.main(["score", "keep_spot", *options]) == 0
    said = capsys.readouterr().out
    assert "keep_spot: 3 episodes from seed 0" in said
    assert "less own.py:cut" in said
    rows = [line.split("│")[1].strip() for line in said.splitlines() if line.startswith("│")]
    assert [row for row in rows if row] == ["own.py:cut", "baseline", "hover"]
    assert Path("scores.png").stat().st_size > 10_000


@pytest.mark.long
def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["score", "keep_spot", "--seeds", "2", "--first-seed", "5", "--set", "duration=4", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["task"], found["seeds"], found["first_seed"], found["figure"]) == ("keep_spot", 2, 5, None)
    baseline, hover = found["policies"]
    assert (baseline["policy"], hover["policy"]) == ("baseline", "hover")
    assert baseline["difference"] is None
    assert hover["difference"]["mean"] == pytest.approx(hover["mean"] - baseline["mean"])
    assert hover["flown_to_the_end"] == 1.0
    # Who holds its place loses less than who drifts.
    assert hover["mean"] < baseline["mean"] < 0.0
    assert len(hover["returns"]) == 2
    # Nobody is looked for.
    assert "persons_found" not in hover


def searched(area_m: float, *places: list[float]) -> list[str]:
    """Return the words for a search of 4 s by two who start at given places, which is one and the same program."""
    half = 0.5 * area_m
    items = [
        f"world.area={{type: box, x_min: {-half}, x_max: {half}, y_min: {-half}, y_max: {half}, z_min: -80, z_max: 0}}",
        "fleets.helicopters.placement={type: given}",
        f"fleets.helicopters.vehicles={[{'position_ned': place} for place in places]}",
        # Of another number of steps it would be another program.
        "duration=4",
    ]
    return ["score", "search_and_rescue/2C", *(f"--set={item}" for item in items)]


@pytest.mark.long
def test_a_search_tells_who_was_found(capsys: pytest.CaptureFixture[str]) -> None:
    """In a field of 12 m two hover 3 m above the ground who find within 5 m, so within 4 m of the ground below."""
    words = [*searched(12.0, [-2.0, 0.0, -3.0], [2.0, 0.0, -3.0]), "--policy", "hover", "--seeds", "4"]
    assert cli.main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"task", "seeds", "first_seed", "policies", "figure", "dataset"}
    hover, baseline = found["policies"]
    keys = {"policy", "mean", "low", "high", "flown_to_the_end", "difference", "returns", "persons_found"}
    assert set(hover) == set(baseline) == keys
    persons = hover["persons_found"]
    assert set(persons) == {"mean", "low", "high", "episodes"}
    # A return is the number found, less a quarter for each of the four steps without a find: -1 without any.
    episodes = [max(0, math.ceil(value - 1e-6)) for value in hover["returns"]]
    assert persons["episodes"] == episodes
    assert 4 < sum(episodes) < 40
    assert persons["mean"] == pytest.approx(sum(episodes) / 4.0)
    assert min(episodes) <= persons["low"] < persons["mean"] < persons["high"] <= max(episodes)
    assert cli.main(words) == 0
    assert "persons found" in capsys.readouterr().out


@pytest.mark.long
def test_two_agents_with_an_oracle(capsys: pytest.CaptureFixture[str]) -> None:
    """In JSON first who was named; in the picture both agents, and the persons whom nobody has found."""
    words = searched(420.0, [0.0, -20.0, -25.0], [0.0, 20.0, -25.0])
    assert cli.main([*words, "--policy", "oracle", "--seeds", "2", "--out", "two.png", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["task"], found["figure"]) == ("search_and_rescue_2C", "two.png")
    assert [row["policy"] for row in found["policies"]] == ["oracle", "baseline", "hover"]
    oracle, baseline, hover = found["policies"]
    assert (oracle["difference"], oracle["flown_to_the_end"], len(oracle["returns"])) == (None, 1.0, 2)
    # Four steps without a find cost a quarter each.
    assert hover["returns"] == pytest.approx([-1.0, -1.0], abs=1e-6)
    assert hover["persons_found"] == {"mean": 0.0, "low": 0.0, "high": 0.0, "episodes": [0, 0]}
    for row in (baseline, hover):
        assert row["difference"]["mean"] == pytest.approx(row["mean"] - oracle["mean"])
    with Image.open("two.png") as picture:
        shown = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    # A disc for each agent in the plan and one for its height, triangles of persons.
    for colour in (VEHICLES[0], VEHICLES[1], MISSING):
        assert np.all(shown == np.asarray(colour, np.uint8), axis=1).sum() > 40, colour
    # Nobody flies as a third one.
    assert np.all(shown == VEHICLES[2], axis=1).sum() == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["keep_spto"], "no scenario is called 'keep_spto'; did you mean 'keep_spot'?"),
        (["hover"], "scenario hover: it has no task"),
        (["keep_spot", "--seeds", "0"], "--seeds 0: expected 1 to 10000"),
        (["keep_spot", "--first-seed", "-1"], "--first-seed -1: expected 0 to 2**62 - 1"),
        (["keep_spot", "--policy", "basline"], "did you mean 'baseline'?"),
        (["keep_spot", "--policy", "hover", "--policy", "hover"], "--policy hover: given twice"),
        (["keep_spot", "--policy", "own.py:cup"], "'cup'"),
        (["keep_spot", "--policy", "oracle", "--json"], "policy oracle: this task has none; a search has"),
        (["keep_spot", "--seeds", "1", "--set", "duration=1", "--out", "scores.txt"], "cannot draw '.txt'"),
    ],
)
def test_what_cannot_be_scored_is_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["score", *arguments]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said
