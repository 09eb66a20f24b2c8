"""Terrain files as a scenario names them: one, several or a folder, relative to the scenario's own folder."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.models.scene.terrain_maps import hgt

from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.scenarios.making import make_scenario
from qrsim.scenarios.reading import dump_yaml
from qrsim.scenarios.scenario import load_scenario

AREA = {"type": "box", "x_min": -300, "x_max": 300, "y_min": -300, "y_max": 300, "z_min": -100}


def test_files_are_relative_to_the_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "tiles").mkdir()
    hgt(tmp_path / "tiles" / "N51W001.hgt")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    found = []
    for number, file in enumerate(("tiles/N51W001.hgt", ["tiles/N51W001.hgt"], "tiles")):
        content = {
            "name": "hills",
            "world": {"area": AREA, "ground": {"type": "dem", "file": file}},
            "fleets": {
                "a": {"vehicles": [{"position_ned": [0, 0, -30]}], "controller": {"type": "waypoint", "feed": "truth"}}
            },
        }
        path = tmp_path / f"{number}.yaml"
        path.write_text(dump_yaml(content))
        scenario = load_scenario(str(path))
        ground: Any = scenario.world().ground
        found.append(np.asarray(ground.grid))
        # The hill's top is 200 m north and 220 m east; at the site it is 17 m lower.
        assert -25.0 < float(ground.down(Vec3(*np.array([[200.0], [220.0], [0.0]], np.float32)))[0]) < -10.0
        again = load_scenario({**content, "world": scenario.spec.model_dump(mode="json")["world"]})
        np.testing.assert_array_equal(np.asarray(again.world().ground.grid), found[0])
    # Of a run that is saved, the file is still the one of its folder.
    shutil.rmtree(tmp_path / "tiles")
    with pytest.raises(ScenarioError, match=r"world\.ground: .*N51W001\.hgt: cannot be read: No such file"):
        load_scenario(str(tmp_path / "1.yaml"))


@pytest.mark.parametrize(
    ("ground", "words"),
    [
        ({"file": 3}, "world.ground.file: 3 is not a text (a file, a list of tiles, or a folder of tiles)"),
        ({"file": []}, "world.ground.file: expected at least 1, found none"),
        ({"file": ["a.tif", 3]}, "world.ground.file.1: 3 is not a text"),
        ({"file": ""}, "world.ground.file: '' is empty"),
        ({"file": "a.tif", "every": 0}, "world.ground.every: 0 is out of range; allowed: 1 to 1000"),
        ({"file": "a.tif", "every": 1.5}, "world.ground.every: 1.5 is not a whole number"),
        ({"file": "a.tif", "missing": "fil"}, "'fil' is not allowed; allowed: error, fill; did you mean 'fill'?"),
        ({"file": "a.tif", "crs": 32630}, "world.ground.crs: 32630 is not a text"),
        ({"file": "a.png"}, "a.png: expected one of .tif, .tiff, .img, .hgt, .asc, .vrt, .npz, or a folder of tiles"),
    ],
)
def test_what_is_no_file(ground: dict[str, Any], words: str):
    with pytest.raises(ScenarioError, match=re.escape(words)):
        make_scenario([[0.0, 0.0, -30.0]], area=AREA, ground={"type": "dem", **ground})
