"""JSON schemas of the messages in an MCAP file; Foxglove's panels know those called foxglove.* by name.

Written from the published descriptions of Foxglove's message schemas, with the properties that are used here.
"""

from __future__ import annotations

from qrsim.files import Content

Schema = Content

NUMBER, INTEGER, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}


def _object_schema(doc: str = "", **properties: Schema) -> Schema:
    """Return the JSON schema of an object with the given properties, name -> schema."""
    return {"type": "object", **({"description": doc} if doc else {}), "properties": properties}


def _vector_schema(doc: str = "", **extra: object) -> Schema:
    """Return the JSON schema of an object with numbers x, y, z; ``extra`` adds keywords to the schema."""
    return {**_object_schema(doc, x=NUMBER, y=NUMBER, z=NUMBER), **extra}


TIME = {"title": "time", **_object_schema("UTC since 1970", sec=INTEGER, nsec=INTEGER)}
QUATERNION = _object_schema(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
BODY = _object_schema(position=_vector_schema(), orientation=QUATERNION)
COLOUR = _object_schema(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)


def _list_schema(items: Schema) -> Schema:
    """Return the JSON schema of a list with entries of the schema ``items``."""
    return {"type": "array", "items": items}


_SOLID: Content = {"pose": BODY, "size": _vector_schema(), "color": COLOUR}
_ENTITY = _object_schema(
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime={"title": "duration", **_object_schema("0: for ever", sec=INTEGER, nsec=INTEGER)},
    frame_locked={"type": "boolean"},
    metadata=_list_schema(_object_schema(key=TEXT, value=TEXT)),
    arrows=_list_schema(_object_schema()),
    cubes=_list_schema(_object_schema(**_SOLID)),
    spheres=_list_schema(_object_schema(**_SOLID)),
    cylinders=_list_schema(_object_schema(**_SOLID, bottom_scale=NUMBER, top_scale=NUMBER)),
    lines=_list_schema(
        _object_schema(
            type={**INTEGER, "description": "0: a strip, 1: a loop"},
            pose=BODY,
            thickness=NUMBER,
            scale_invariant={"type": "boolean"},
            points=_list_schema(_vector_schema()),
            color=COLOUR,
            colors=_list_schema(COLOUR),
            indices=_list_schema(INTEGER),
        )
    ),
    triangles=_list_schema(_object_schema()),
    texts=_list_schema(_object_schema()),
    models=_list_schema(_object_schema()),
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
    SCENE: _object_schema(
        "Area, obstacles, waypoints, persons, sources of a plume and places of a task, east, north, up [m].",
        timestamp=TIME,
        deletions=_list_schema(_object_schema(timestamp=TIME, type=INTEGER, id=TEXT)),
        entities=_list_schema(_ENTITY),
    ),
    POSES: _object_schema(
        "Waypoints of a vehicle in their order, east, north, up [m].",
        timestamp=TIME,
        frame_id=TEXT,
        poses=_list_schema(BODY),
    ),
    POSE: _object_schema(
        "True pose of the vehicle's axes (forward, left, up) [m], in the frame of frame_id.",
        timestamp=TIME,
        frame_id=TEXT,
        pose=_object_schema(position=_vector_schema(), orientation=QUATERNION),
    ),
    FRAME: _object_schema(
        "True pose of the vehicle's axes (forward, left, up) [m], as a frame that panels can follow.",
        timestamp=TIME,
        parent_frame_id=TEXT,
        child_frame_id=TEXT,
        translation=_vector_schema(),
        rotation=QUATERNION,
    ),
    FIX: _object_schema(
        "Latitude and longitude [deg], height above the WGS-84 ellipsoid [m].",
        timestamp=TIME,
        frame_id=TEXT,
        latitude=NUMBER,
        longitude=NUMBER,
        altitude=NUMBER,
        position_covariance={"type": "array", "items": NUMBER, "minItems": 9, "maxItems": 9},
        position_covariance_type={**INTEGER, "description": "0: unknown, 1: approximated"},
    ),
    WIND: _object_schema(
        "Velocity of the air at the vehicle, where it blows to: x north, y east, z down [m/s].",
        timestamp=TIME,
        mean_ned=_vector_schema("mean wind", unit="m/s"),
        gust_ned=_vector_schema("turbulence and gusts, to be added to the mean", unit="m/s"),
    ),
    LOG: _object_schema(
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
