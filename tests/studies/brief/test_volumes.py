"""Volumes of a risk assessment: numbers of the guide, and outlines around a route."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from tests.studies.brief.plans import HOME, write_plan

from qrsim.scenarios.scenario import Scenario
from qrsim.studies.brief.flights import flights_of
from qrsim.studies.brief.operation import checked
from qrsim.studies.brief.volumes import outlines, volumes_of, write_kml

KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    plan = write_plan(tmp_path_factory.mktemp("volumes") / "a.plan")
    content = {
        "operation": "field",
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": str(plan), "vehicle": "x500"}],
        "wind": {"speed": 4, "from": 250},
    }
    return flights_of(checked(content, "field")).scenario


@pytest.mark.long
def test_the_sizes_and_outlines_are_those_of_the_guide(scenario: Scenario) -> None:
    found = volumes_of(scenario)
    # 5 m/s: 5 m in a second, and 25/(2 g) = 1.274 m of braking at 45 degrees; 3 + 3 + 1 m of errors.
    assert (found.speed, found.height) == (5.0, pytest.approx(12.0, abs=0.3))
    assert found.contingency == pytest.approx(13.274, abs=1e-3)
    # 12 m, 1 m of the barometer, 3.5 m of reaction, 1.274 m of braking.
    assert found.contingency_height == pytest.approx(17.774, abs=0.3)
    assert found.ground_risk == found.contingency_height
    # From home 25 m north: the contingency volume is 1 + 13.27 m around that line.
    corners = outlines(scenario, found)["contingency volume"]
    assert corners[:, 1].max() == pytest.approx(14.27, abs=0.2)
    assert corners[:, 0].min() == pytest.approx(-14.27, abs=0.2)
    assert corners[:, 0].max() == pytest.approx(39.27, abs=0.2)

    tree = ElementTree.fromstring(write_kml("a & b", scenario, found))
    names = [each.findtext(f"{KML}name") for each in tree.iter(f"{KML}Placemark")]
    assert names == ["flight geography", "contingency volume", "ground risk buffer"]
    text = next(tree.iter(f"{KML}coordinates")).text or ""
    places = np.array([[float(number) for number in place.split(",")] for place in text.split()])
    # A closed ring of longitude, latitude and height around home.
    assert (places[0] == places[-1]).all()
    assert places[:, :2].mean(axis=0) == pytest.approx([HOME[1], HOME[0]], abs=3e-4)
