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
# Routes of other software: a list of waypoints, and routes that were drawn on maps.
WAYPOINTS = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t51.7119000\t-0.2105200\t90.000000\t1
1\t0\t3\t22\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t20.000000\t1
2\t0\t10\t82\t1.00000000\t0.00000000\t0.00000000\t0.00000000\t51.71230000\t-0.21050000\t25.000000\t1
3\t0\t3\t177\t2.00000000\t2.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.000000\t1
4\t0\t3\t20\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.000000\t1
"""
KML_ROUTE = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><name>way</name><LineString>
<altitudeMode>relativeToGround</altitudeMode><coordinates>-0.2105,51.7119,20 -0.2102,51.7121,25</coordinates>
</LineString></Placemark></Document></kml>
"""
GPX_ROUTE = """<?xml version="1.0"?><gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><rte><name>way</name>
<rtept lat="51.7119" lon="-0.2105"><ele>110.5</ele></rtept>
<rtept lat="51.7121" lon="-0.2102"><ele>115</ele></rtept></rte></gpx>
"""
GEOJSON_ROUTE: dict[str, Any] = {
    "type": "Feature", "properties": {"name": "way", "height": 20},
    "geometry": {"type": "LineString", "coordinates": [[-0.2105, 51.7119, 150], [-0.2102, 51.7121, 155]]},
}  # fmt: skip
SCAN: dict[str, Any] = {
    "type": "ComplexItem", "complexItemType": "StructureScan", "version": 3, "EntranceAltitude": 30, "Layers": 2,
    "ScanBottomAlt": 4, "StartFromTop": False, "StructureHeight": 20, "GimbalPitch": 0,
    "CameraCalc": {"AdjustedFootprintFrontal": 8, "DistanceToSurface": 10, "version": 1},
    "polygon": [[51.7121, -0.2105], [51.7121, -0.2103], [51.7120, -0.2103], [51.7120, -0.2105]],
}  # fmt: skip
HEIGHTS = "ncols 6\nnrows 5\nxllcorner -1250\nyllcorner -1250\ncellsize 500\nNODATA_value -9999\n" + 5 * "1 2 3 4 5 6\n"
