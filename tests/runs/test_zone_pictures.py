"""Zones in pictures: of figures, of Foxglove and of the 3-D page, with the levels of floors and ceilings."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_hex

from qrsim.core.tree import cast
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.zone import Zone
from qrsim.models.scene.zones import ZonesArea
from qrsim.runs.export.mcap_scene import _area_entities
from qrsim.runs.plan import zone_patches
from qrsim.runs.surroundings import Surroundings, _zones
from qrsim.view.ground import _levels, corners_of, rings_of

SQUARE = ((-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0))
HOLE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0))
FIELD = Zone(True, (SQUARE, HOLE), ceiling=80.0, name="field")
SCHOOL = Zone(False, (), (20.0, -20.0), 5.0, 10.0, 30.0, terrain=True, name="school")


def test_figures_hatch_what_to_stay_out_of() -> None:
    edge, hole = zone_patches(FIELD)
    assert (edge.get_label(), edge.get_hatch(), edge.get_fill()) == ("stay in", None, False)
    assert edge.get_xy()[1].tolist() == [50.0, -50.0]  # east, north
    (school,) = zone_patches(SCHOOL)
    assert [patch.get_label() for patch in (hole, school)] == ["stay out", "stay out"]
    assert [patch.get_hatch() for patch in (hole, school)] == ["///", "///"]
    assert to_hex(school.get_edgecolor()) == "#784818"


def test_foxglove_has_the_edges_between_floor_and_ceiling() -> None:
    around = Surroundings(zones=(FIELD, SCHOOL), down=(-60.0, 0.0))
    field, school = _area_entities(around)
    assert (field["id"], school["id"]) == ("stay in field", "stay out school")
    # Two levels and four upright edges, and the same of the hole: three edges.
    assert len(field["lines"]) == 2 + 4 + 2 + 3
    heights = {point["z"] for line in field["lines"] for point in line["points"]}
    assert heights == {0.0, 60.0}
    assert {point["z"] for line in school["lines"] for point in line["points"]} == {10.0, 30.0}


def test_the_page_separates_what_to_stay_out_of_and_follows_the_ground() -> None:
    area = cast(ZonesArea(z_min=-60.0).of([FIELD, SCHOOL], FlatGround(height=np.array(7.0))), np.dtype("float32"))  # type: ignore[arg-type]
    assert [zone.name for zone, _ in rings_of(area, keep=True)] == ["field"]
    (_, hole), (zone, ring) = rings_of(area, keep=False)
    assert (hole, zone.name) == (HOLE, "school")
    low, high = _levels(zone, ring, area)
    assert (low[0, 2], high[0, 2]) == (-17.0, -37.0)
    corners, top, bottom = corners_of(area)  # type: ignore[misc]
    assert (corners.min(), corners.max(), top, bottom) == (-50.0, 50.0, -60.0, 0.0)


def test_a_recorded_scenario_has_its_zones() -> None:
    entry = {"circle_ned": [20.0, -20.0], "radius": 5.0, "floor": 10.0, "ceiling": 30.0, "above": "terrain"}
    assert _zones({"type": "zones", "stay_out": [{**entry, "name": "school"}]}) == (SCHOOL,)
    assert _zones({"type": "box"}) == ()
