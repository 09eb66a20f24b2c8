"""Small plans, fences, buildings and elevations to be mutated."""

from __future__ import annotations

from typing import Any

PLAN: dict[str, Any] = {
    "fileType": "Plan", "version": 1, "groundStation": "QGroundControl",
    "mission": {
        "version": 2, "plannedHomePosition": [51.7119, -0.21052, 0.0],
        "items": [
            {"type": "SimpleItem", "command": 22, "frame": 3, "autoContinue": True,
             "params": [15, 0, 0, None, 51.7119, -0.21052, 20]},
            {"type": "SimpleItem", "command": 16, "frame": 3, "autoContinue": True,
             "params": [0, 0, 0, None, 51.7123, -0.2105, 25]},
            {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"version": 2, "Items": [
                {"type": "SimpleItem", "command": 16, "frame": 0, "params": [0, 0, 0, None, 51.7121, -0.2102, 25]}]}},
            {"type": "SimpleItem", "command": 20, "frame": 2, "params": [0, 0, 0, 0, 0, 0, 0], "autoContinue": True},
        ],
    },
    "geoFence": {"version": 2, "circles": [], "polygons": [
        {"version": 1, "inclusion": True,
         "polygon": [[51.710, -0.213], [51.714, -0.213], [51.714, -0.207], [51.710, -0.207]]}]},
    "rallyPoints": {"version": 2, "points": []},
}  # fmt: skip
KML = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><name>field</name><Polygon><outerBoundaryIs><LinearRing>
<coordinates>-0.213,51.710,0 -0.207,51.710,0 -0.207,51.714,0 -0.213,51.714,0 -0.213,51.710,0</coordinates>
</LinearRing></outerBoundaryIs></Polygon></Placemark><Placemark><name>gate</name><Point><coordinates>-0.21,51.71,0
</coordinates></Point></Placemark></Document></kml>
"""
GEOJSON: dict[str, Any] = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "id": "way/1",
            "properties": {"building": "yes", "height": "12 m"},
            "geometry": {
                "type": "Polygon",
                "coordinates": [
                    [[-0.2104, 51.7120], [-0.2102, 51.7120], [-0.2102, 51.7122], [-0.2104, 51.7122], [-0.2104, 51.7120]]
                ],
            },
        },
        {
            "type": "Feature",
            "properties": {"building": "house", "building:levels": 2, "roof:levels": "1"},
            "geometry": {
                "type": "MultiPolygon",
                "coordinates": [
                    [
                        [
                            [-0.2108, 51.7116],
                            [-0.2106, 51.7116],
                            [-0.2106, 51.7118],
                            [-0.2108, 51.7118],
                            [-0.2108, 51.7116],
                        ]
                    ]
                ],
            },
        },
        {
            "type": "Feature",
            "properties": {"natural": "tree"},
            "geometry": {"type": "Point", "coordinates": [-0.21, 51.7]},
        },
    ],
}
HEIGHTS = "ncols 6\nnrows 5\nxllcorner -1250\nyllcorner -1250\ncellsize 500\nNODATA_value -9999\n" + 5 * "1 2 3 4 5 6\n"
