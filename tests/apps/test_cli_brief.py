"""``qrsim brief``: planted failures are found, each with its criterion, leg and time; a stopped brief goes on.

All flights are one compiled program: plans, fences, packs, masts and winds differ in their numbers only.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from tests.studies.brief.plans import HOME, write_plan
from tests.studies.brief.test_flights import write_projection

from qrsim import cli

WIDE = [(-60.0, -60.0), (-60.0, 60.0), (80.0, 60.0), (80.0, -60.0)]
SCHEMA = json.loads((Path(__file__).parents[2] / "docs/reference/brief.schema.json").read_text())
# The grid of the hill reaches as far.
NEAR = [(-50.0, -40.0), (-50.0, 40.0), (60.0, 40.0), (60.0, -40.0)]
AWAY, ON_THE_LEG = {"x": -40.0, "y": -40.0}, {"x": 12.0, "y": 0.5}


def write(folder: Path, fence: list[tuple[float, float]] = WIDE, mast: dict[str, float] = AWAY, **changes: Any) -> Path:
    """Write an operation: 12 m up, 25 m north, and back, past a mast."""
    folder.mkdir()
    write_plan(folder / "a.plan", fence=fence)
    battery = changes.pop("battery", {"capacity": 1.0})
    operation = {
        "operation": "field",
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": "a.plan", "vehicle": "x500", "battery": battery}],
        "wind": {"speed": 4, "from": 250, "std": 0.5},
        "world": {"obstacles": [{"type": "cylinder", "radius": 0.5, "z_min": -30.0, **mast}]},
        "criteria": {"p_loss": 0.05},
        **changes,
    }
    (folder / "field.yaml").write_text(yaml.safe_dump(operation))
    return folder / "field.yaml"


def brief(file: Path, *words: str) -> tuple[int, dict[str, Any]]:
    """Brief an operation in this process; return the exit code and the numbers."""
    out = file.parent / "out"
    options = ("--workers", "1", "--minutes", "10", "--no-record", *words)
    stage = () if "--stage" in words else ("--stage", "nominal")
    code = cli.main(["brief", str(file), *stage, "--out", str(out), *options])
    found = json.loads((out / "brief.json").read_text())
    jsonschema.validate(found, SCHEMA)
    assert (out / "brief.pdf").read_bytes().startswith(b"%PDF")
    return code, found


def rows(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in found["criteria"]}


@pytest.mark.long
def test_a_good_operation_is_a_go_and_a_stopped_brief_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "good")
    # Out of time after its first batch, it is marginal.
    code, part = brief(file, "--minutes", "0.0001")
    assert (code, part["runs"], part["complete"], part["verdict"]) == (3, 16, False, "marginal")
    assert "the brief was stopped before it was complete" in capsys.readouterr().out
    code, found = brief(file)
    assert (code, found["verdict"], found["why"]) == (0, "go", "every criterion is met")
    assert (found["runs"], found["complete"]) == (72, True)
    assert {row["verdict"] for row in found["criteria"]} == {"go"}
    assert [row["name"] for row in found["criteria"]] == [
        "loss", "finished", "reserve", "fence", "ground", "obstacle", "gnss"
    ]  # fmt: skip
    assert rows(found)["obstacle"]["worst"]["vehicle"] == "a"
    # The page has the pictures in it, and fetches nothing.
    page = (file.parent / "out" / "brief.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "wind 4 m/s from 250 deg at 10 m, with an error of 0.5 m/s and 15 deg" in page
    assert "x500; planned: a " in page
    assert "<script" not in page
    assert "http" not in page
    assert len(page) < 2_000_000
    # Another operation does not go into its folder.
    write_plan(file.parent / "a.plan", fence=WIDE)
    file.write_text(file.read_text().replace("speed: 4", "speed: 5"))
    assert cli.main(["brief", str(file), "--out", str(file.parent / "out")]) == 2
    assert "wind.speed: 5.0 here, 4.0 there" in capsys.readouterr().err


@pytest.mark.nightly
def test_a_stopped_brief_has_the_numbers_of_one_flown_at_once(tmp_path: Path) -> None:
    """To the bit; and a complete one flies nothing when it is asked for again."""
    file, other = write(tmp_path / "good"), write(tmp_path / "at_once")
    brief(file, "--minutes", "0.0001")
    brief(file)
    numbers = (file.parent / "out" / "brief.json").read_bytes()
    brief(file)
    assert (file.parent / "out" / "brief.json").read_bytes() == numbers
    brief(other)
    assert (other.parent / "out" / "brief.json").read_text().replace("at_once", "good") == numbers.decode()


@pytest.mark.nightly
def test_a_window_spreads_the_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = brief(write(tmp_path / "window", window="30 min"))
    assert (code, found["runs"], found["complete"]) == (0, 72, True)
    out = tmp_path / "window" / "out"
    stores = [json.loads(path.read_text())["attributes"] for path in sorted(out.glob("nominal_*.zarr/zarr.json"))]
    starts = [json.loads(store["study"])["set"]["start_time"] for store in stores]
    # 32 and 40 runs, each from 4 starts.
    assert starts == [f"2026-05-01T10:{minute}:00Z" for minute in (["00", 10, 20, 30] * 2)]
    assert [json.loads(store["study"])["first_seed"] for store in stores] == [0, 8, 16, 24, 32, 42, 52, 62]
    # A run is flown again from its own start.
    assert all("'start_time=\"2026-05-01T10:" in each["command"] for each in found["worst"])


@pytest.mark.nightly
def test_a_fence_beside_the_leg_is_a_no_go(tmp_path: Path) -> None:
    near = [(-60.0, -60.0), (-60.0, 1.2), (80.0, 1.2), (80.0, -60.0)]
    code, found = brief(write(tmp_path / "fence", fence=near))
    assert (code, found["verdict"]) == (1, "no-go")
    row = rows(found)["fence"]
    assert row["verdict"] == "no-go"
    assert row["worst"]["leg"] in (1, 2, 3)
    assert row["worst"]["at_s"] > 0.0


@pytest.mark.long
def test_a_mast_on_the_leg_is_a_no_go(tmp_path: Path) -> None:
    code, found = brief(write(tmp_path / "mast", mast=ON_THE_LEG))
    assert (code, found["verdict"]) == (1, "no-go")
    assert " runs lost (" in found["why"]
    assert "collided" in found["why"]
    assert rows(found)["loss"]["value"] > 0.9
    row = rows(found)["obstacle"]
    assert (row["verdict"], row["worst"]["leg"]) == ("no-go", 2)


@pytest.mark.nightly
def test_a_small_pack_is_a_no_go(tmp_path: Path) -> None:
    """The low battery's return takes over; no run finishes."""
    code, found = brief(write(tmp_path / "pack", battery={"capacity": 0.12}))
    assert (code, rows(found)["finished"]["verdict"]) == (1, "no-go")
    assert found["shares"]["failsafes"]["share"] > 0.9


@pytest.mark.nightly
def test_a_wind_beyond_what_it_holds_is_a_no_go(tmp_path: Path) -> None:
    code, found = brief(write(tmp_path / "wind", wind={"speed": 35, "from": 250}, criteria={"wind_limit": 12}))
    assert (code, found["verdict"]) == (1, "no-go")
    assert rows(found)["wind"]["verdict"] == "no-go"
    assert rows(found)["loss"]["value"] > 0.5
    assert found["worst"][0]["command"].startswith("qrsim run ")


def write_hill(file: Path, north: float, height: float) -> None:
    """Write terrain of 90 m with a hill on the leg north of home, 4 m wide (one standard deviation)."""
    cell, half = 0.00002, 50
    head = f"ncols 101\nnrows 101\nxllcenter {HOME[1] - half * cell}\nyllcenter {HOME[0] - half * cell}\n"
    norths = cell * 111_250.0 * np.arange(half, -half - 1, -1)
    easts = cell * 111_320.0 * np.cos(np.radians(HOME[0])) * np.arange(-half, half + 1)
    heights = 90.0 + height * np.exp(-((norths[:, None] - north) ** 2 + easts**2) / (2.0 * 4.0**2))
    rows = (" ".join(f"{each:.2f}" for each in row) for row in heights)
    file.write_text(f"{head}cellsize {cell}\n" + "\n".join(rows) + "\n")
    write_projection(file)


@pytest.mark.nightly
def test_a_hill_on_a_leg_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "hill", fence=NEAR, site={"terrain": ["hill.asc"]})
    # 3 m above the leg at 12 m.
    write_hill(file.parent / "hill.asc", 14.0, 15.0)
    code, found = brief(file)
    assert (code, found["verdict"], found["runs"]) == (1, "no-go", 32)
    row = rows(found)["loss"]
    assert row["why"].startswith("32 of 32 runs lost (100 %): 32 crashed; ")
    assert "of them on leg 2; the earliest: vehicle a, leg 2, " in row["why"]
    # The vehicle is up at 12 m after about 8 s.
    assert (row["worst"]["leg"], row["worst"]["vehicle"]) == (2, "a")
    assert 5.0 < row["worst"]["at_s"] < 20.0
    assert rows(found)["ground"]["verdict"] == "no-go"


@pytest.mark.nightly
def test_faults_end_as_the_reactions_ask(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "faults", battery={"capacity": 5.0})
    code, found = brief(file, "--stage", "faults")
    # Without nominal runs nothing is a go.
    assert (code, found["verdict"], found["complete"]) == (3, "marginal", True)
    assert len(found["faults"]) == 12
    by_fault = {name: [each for each in found["faults"] if each["fault"] == name] for name in ("motor", "link", "gnss")}
    by_fault["low_battery"] = [each for each in found["faults"] if each["fault"] == "low_battery"]
    assert [each["crashed"] for each in by_fault["motor"]] == [1.0] * 3
    assert all(each["median_s"] < 10.0 for each in by_fault["motor"])
    assert [each["home"] for each in by_fault["link"]] == [1.0] * 3
    assert [each["home"] for each in by_fault["low_battery"]] == [1.0] * 3
    assert rows(found)["fault motor"]["decides"] is False
    # A stage by itself adds to what the folder has, and neither changes the other.
    code, both = brief(file, "--stage", "nominal")
    assert (code, both["faults"], both["runs"]) == (0, found["faults"], 72)
    assert {"loss", "finished", "fault link"} <= {row["name"] for row in both["criteria"]}
    assert brief(file, "--stage", "faults") == (0, both)


@pytest.mark.nightly
def test_the_wind_that_an_operation_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "wind", battery={"capacity": 5.0}, criteria={"wind_limit": 20, "reserve": 0.5})
    code, found = brief(file, "--stage", "wind", "--minutes", "20")
    assert (code, found["verdict"], found["complete"]) == (3, "marginal", True)
    assert rows(found)["wind"]["verdict"] == "go"
    boundary = found["wind_boundary"]
    assert [each["from_deg"] for each in boundary["directions"]] == [45.0 * i for i in range(8)] + [250.0]
    # 20 speeds and 64 seeds in each direction would be 11 520 runs.
    assert boundary["runs"] < 11_520 / 3
    for each in boundary["directions"]:
        assert each["low"] <= each["speed"] <= each["high"] <= each["low"] + 2.0
        # The cascade leans up to 0.5 rad, which holds an X500 against more than the 12 m/s that its maker allows.
        assert 10.0 < each["speed"] < 30.0
    page = (file.parent / "out" / "brief.html").read_text()
    assert "<h2>Wind</h2>" in page
    # What is there is not flown again, and the numbers are the same.
    numbers = (file.parent / "out" / "brief.json").read_bytes()
    brief(file, "--stage", "wind")
    assert (file.parent / "out" / "brief.json").read_bytes() == numbers
