"""The place of examples/real_place: terrain, plan, keep-outs, buildings and forecast together, in one flight."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from examples.real_place import make_files

import qrsim
from qrsim import cli
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.contracts import down_at

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("place")
    for name in ("site.yaml", "operation.yaml"):
        shutil.copy(Path(make_files.__file__).parent / name, folder)
    make_files.main(folder)
    return folder


def test_it_flies_over_the_terrain_between_the_keep_outs(place: Path) -> None:
    scenario = qrsim.load_scenario(place / "site.yaml")
    # 1480 m above mean sea level, and the geoid there by EGM96, 50.2 m.
    assert scenario.spec.site.height == pytest.approx(1530.2, abs=0.1)
    area = scenario.spec.world.area
    assert [zone.name for zone in area.stay_out] == ["Chapel", "Cable car", "Alp Sura"]
    # The map of the example is on the ellipsoid, 1530 m lower: 0.02 % shorter.
    np.testing.assert_allclose(area.stay_out[0].polygon_ned, make_files.STAY_OUT["Chapel"], atol=0.06)
    simulation = qrsim.Simulation(scenario.world())
    simulation.reset()
    flown = simulation.record(round(scenario.spec.duration / scenario.spec.time_step))
    vehicle = flown.state.fleets[0].vehicle.position_ned
    time, north, east, down = flown.time, *(np.asarray(axis)[:, 0] for axis in (vehicle.x, vehicle.y, vehicle.z))
    assert simulation.valid.all()
    # It lands at home.
    np.testing.assert_allclose([north[-1], east[-1], down[-1]], [0.0, 0.0, 0.0], atol=3.0)
    ground = np.asarray(down_at(scenario.world().ground, Vec3(*(np.float32(axis) for axis in (north, east, down)))))
    heights = make_files.height(north, east) - make_files.height(0.0, 0.0)
    np.testing.assert_allclose(-ground, heights, atol=1.0)
    # The survey is 60 m above home; the legs over the knoll are 40 m above the ground.
    survey = (north < 90.0) & (time > 50.0) & (time < 120.0)
    np.testing.assert_allclose(down[survey], -60.0, atol=3.0)
    knoll = (north > 200.0) & (time < 265.0)
    assert np.ptp(down[knoll]) > 20.0
    np.testing.assert_allclose((ground - down)[knoll], 40.0, atol=4.0)


def test_a_leg_above_the_field_is_refused(place: Path) -> None:
    with pytest.raises(UsageError, match=r"item 3: .* outside the zones to stay in, first at north 0, east -"):
        qrsim.load_scenario(place / "site.yaml", overrides=["world.area.stay_in.0.ceiling=50"])


def test_the_operation_is_that_of_the_place(
    place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A go through a keep-out is none: the zones of the site hold in its brief."""
    monkeypatch.chdir(place.parent)
    text = (place / "site.yaml").read_text()
    (place / "site.yaml").write_text(text.replace("ceiling: 120", "ceiling: 50"))
    assert cli.main(["brief", str(place / "operation.yaml")]) == 2
    (place / "site.yaml").write_text(text)
    assert "outside the zones to stay in" in capsys.readouterr().err
