"""JSON schemas of the messages in an MCAP file; Foxglove's panels know those called foxglove.* by name.

Written from the published descriptions of Foxglove's message schemas, with the properties that are used here.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]

NUMBER, INTEGER, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}


def _object(doc: str = "", **properties: Schema) -> Schema:
    return {"type": "object", **({"description": doc} if doc else {}), "properties": properties}


def _vector(doc: str = "", **extra: object) -> Schema:
    return {**_object(doc, x=NUMBER, y=NUMBER, z=NUMBER), **extra}


TIME = {"title": "time", **_object("UTC since 1970", sec=INTEGER, nsec=INTEGER)}
QUATERNION = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
BODY = _object(position=_vector(), orientation=QUATERNION)
COLOUR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


_SOLID: dict[str, Any] = {"pose": BODY, "size": _vector(), "color": COLOUR}
_ENTITY = _object(
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime={"title": "duration", **_object("0: for ever", sec=INTEGER, nsec=INTEGER)},
    frame_locked={"type": "boolean"},
    metadata=_list(_object(key=TEXT, value=TEXT)),
    arrows=_list(_object()),
    cubes=_list(_object(**_SOLID)),
    spheres=_list(_object(**_SOLID)),
    cylinders=_list(_object(**_SOLID, bottom_scale=NUMBER, top_scale=NUMBER)),
    lines=_list(
        _object(
            type={**INTEGER, "description": "0: a strip, 1: a loop"},
            pose=BODY,
            thickness=NUMBER,
            scale_invariant={"type": "boolean"},
            points=_list(_vector()),
            color=COLOUR,
            colors=_list(COLOUR),
            indices=_list(INTEGER),
        )
    ),
    triangles=_list(_object()),
    texts=_list(_object()),
    models=_list(_object()),
)

POSE, FRAME, FIX, WIND, LOG, SCENE, POSES = (
    "foxglove.PoseInFrame",
    "foxglove.FrameTransform",
    "foxglove.LocationFix",
    "qrsim.Wind",
    "foxglove.Log",
    "foxglove.SceneUpdate",
    "foxglove.PosesInFrame",
)
SCHEMAS: dict[str, Schema] = {
    SCENE: _object(
        "Area, obstacles, waypoints, persons, sources of a plume and places of a task, east, north, up [m].",
        timestamp=TIME,
        deletions=_list(_object(timestamp=TIME, type=INTEGER, id=TEXT)),
        entities=_list(_ENTITY),
    ),
    POSES: _object(
        "Waypoints of a vehicle in their order, east, north, up [m].",
        timestamp=TIME,
        frame_id=TEXT,
        poses=_list(BODY),
    ),
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
        position_covariance_type={**INTEGER, "description": "0: unknown, 1: approximated"},
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
