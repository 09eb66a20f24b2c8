"""Colours that are told apart, and the formula by which (``make evidence colours``)."""

from __future__ import annotations

import numpy as np
from evidence import colours as study
from tests.runs.colour_vision import ciede2000, linear, seen

from qrsim.runs import colours
from qrsim.runs.export import kml
from qrsim.runs.picture import colours_of
from qrsim.view import shapes

# Sharma, Wu and Dalal (2005), table 1: L*, a*, b* of two colours, and their difference.
SHARMA = """
50.0000 2.6772 -79.7751 50.0000 0.0000 -82.7485 2.0425
50.0000 3.1571 -77.2803 50.0000 0.0000 -82.7485 2.8615
50.0000 2.8361 -74.0200 50.0000 0.0000 -82.7485 3.4412
50.0000 -1.3802 -84.2814 50.0000 0.0000 -82.7485 1.0000
50.0000 -1.1848 -84.8006 50.0000 0.0000 -82.7485 1.0000
50.0000 -0.9009 -85.5211 50.0000 0.0000 -82.7485 1.0000
50.0000 0.0000 0.0000 50.0000 -1.0000 2.0000 2.3669
50.0000 -1.0000 2.0000 50.0000 0.0000 0.0000 2.3669
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0009 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0010 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0011 7.2195
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0012 7.2195
50.0000 -0.0010 2.4900 50.0000 0.0009 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0010 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0011 -2.4900 4.7461
50.0000 2.5000 0.0000 50.0000 0.0000 -2.5000 4.3065
50.0000 2.5000 0.0000 73.0000 25.0000 -18.0000 27.1492
50.0000 2.5000 0.0000 61.0000 -5.0000 29.0000 22.8977
50.0000 2.5000 0.0000 56.0000 -27.0000 -3.0000 31.9030
50.0000 2.5000 0.0000 58.0000 24.0000 15.0000 19.4535
50.0000 2.5000 0.0000 50.0000 3.1736 0.5854 1.0000
50.0000 2.5000 0.0000 50.0000 3.2972 0.0000 1.0000
50.0000 2.5000 0.0000 50.0000 1.8634 0.5757 1.0000
50.0000 2.5000 0.0000 50.0000 3.2592 0.3350 1.0000
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
"""


def test_the_formula_gives_its_published_pairs() -> None:
    table = np.array([line.split() for line in SHARMA.split("\n") if line], float)
    assert len(table) == 34
    np.testing.assert_allclose(ciede2000(table[:, :3], table[:, 3:6]), table[:, 6], atol=6e-5)
    np.testing.assert_allclose(ciede2000(table[:, 3:6], table[:, :3]), table[:, 6], atol=6e-5)


def test_colours_as_they_are_seen() -> None:
    """L*a*b* of sRGB red and grey; to dichromats white stays white, and red and a green of its brightness are alike."""
    np.testing.assert_allclose(seen(np.array([255, 0, 0]), "normal"), [53.24, 80.09, 67.20], atol=0.01)
    np.testing.assert_allclose(linear(np.array([188.0])), [0.5029], atol=1e-4)
    for vision in ("deuteranope", "protanope"):
        np.testing.assert_allclose(seen(np.array([255, 255, 255]), vision), [100.0, 0.0, 0.0], atol=0.02)
        pair = seen(np.array([[200, 90, 60], [110, 125, 60]]), vision)
        assert ciede2000(*pair) < 0.6 * ciede2000(*seen(np.array([[200, 90, 60], [110, 125, 60]]), "normal"))


def test_vehicles_and_what_has_stopped_are_told_apart() -> None:
    found = study.run(False)
    assert found["eight"]["smallest"] >= 12.0
    assert found["ten"]["smallest"] >= 12.0
    assert found["all"]["smallest"] >= 10.0
    least = min(found["eight"][vision] for vision in ("normal", "deuteranope", "protanope"))
    assert found["eight"]["smallest"] == least


def test_red_is_what_has_stopped_and_nothing_else() -> None:
    """Of hue 20 to 60 degrees in L*a*b*, strong: no vehicle, no wind, no ratio."""
    rest = np.concatenate(
        [
            colours.VEHICLES,
            colours.WIND,
            colours.RATIO,
            np.array([colours.MISSING, colours.FOUND, colours.GUST, colours.PLUME, colours.GREY]),
        ]
    )
    _, a, b = seen(np.array(colours.STOPPED), "normal")
    assert 20.0 < np.degrees(np.arctan2(b, a)) < 60.0
    assert np.hypot(a, b) > 75.0
    a, b = seen(rest, "normal")[:, 1:].T
    hue, strength = np.degrees(np.arctan2(b, a)), np.hypot(a, b)
    assert strength[(hue > 0.0) & (hue < 55.0)].max() < 45.0


def test_a_stronger_wind_is_darker() -> None:
    speeds = shapes.speed_colours(np.linspace(0.0, 12.0, 100), 12.0)
    for vision in ("normal", "deuteranope", "protanope"):
        assert (np.diff(seen(speeds, vision)[:, 0]) < 0.0).all()
    assert study.run(False)["wind"]["smallest"] > 8.0


def test_page_figures_and_exports_share_the_colours() -> None:
    np.testing.assert_array_equal(shapes.PALETTE, colours.VEHICLES)
    np.testing.assert_allclose(colours_of(10)[:, :3] * 255.0, colours.VEHICLES)
    import simplekml

    # KML has them as opacity, blue, green, red.
    assert kml._track_style(simplekml, 11, "true").linestyle.color == "ff018be7"
