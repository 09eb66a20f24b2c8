"""JSON schemas of the messages in an MCAP file; Foxglove's panels know those called foxglove.* by name.

Written from the published descriptions of Foxglove's message schemas, with the properties that are used here.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]

NUMBER, INTEGER, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}


def _object(doc: str = "", **properties: Schema) -> Schema:
    return {"type": "object", **({"description": doc} if doc else {}), "properties": properties}


def _vector(doc: str = "", **extra: Any) -> Schema:
    return {**_object(doc, x=NUMBER, y=NUMBER, z=NUMBER), **extra}


TIME = {"title": "time", **_object("UTC since 1970", sec=INTEGER, nsec=INTEGER)}
QUATERNION = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)

POSE, FRAME, FIX, WIND, LOG = (
    "foxglove.PoseInFrame",
    "foxglove.FrameTransform",
    "foxglove.LocationFix",
    "qrsim.Wind",
    "foxglove.Log",
)
SCHEMAS: dict[str, Schema] = {
    POSE: _object(
        "True pose of the vehicle's axes (forward, left, up) [m], in the frame of frame_id.",
        timestamp=TIME,
        frame_id=TEXT,
        pose=_object(position=_vector(), orientation=QUATERNION),
    ),
    FRAME: _object(
        "True pose of the vehicle's axes (forward, left, up) [m], as a frame that panels can follow.",
        timestamp=TIME,
        parent_frame_id=TEXT,
        child_frame_id=TEXT,
        translation=_vector(),
        rotation=QUATERNION,
    ),
    FIX: _object(
        "Latitude and longitude [deg], height above the WGS-84 ellipsoid [m].",
        timestamp=TIME,
        frame_id=TEXT,
        latitude=NUMBER,
        longitude=NUMBER,
        altitude=NUMBER,
        position_covariance={"type": "array", "items": NUMBER, "minItems": 9, "maxItems": 9},
        position_covariance_type={**INTEGER, "description": "0: the covariance is unknown"},
    ),
    WIND: _object(
        "Velocity of the air at the vehicle, where it blows to: x north, y east, z down [m/s].",
        timestamp=TIME,
        mean_ned=_vector("mean wind", unit="m/s"),
        gust_ned=_vector("turbulence and gusts, to be added to the mean", unit="m/s"),
    ),
    LOG: _object(
        "Event of the run; from tick on, what qrsim adds.",
        timestamp=TIME,
        level={**INTEGER, "description": "0 unknown, 1 debug, 2 information, 3 warning, 4 error, 5 fatal"},
        message=TEXT,
        name=TEXT,
        file=TEXT,
        line=INTEGER,
        tick=INTEGER,
        kind=TEXT,
        field=TEXT,
        value=NUMBER,
    ),
}
