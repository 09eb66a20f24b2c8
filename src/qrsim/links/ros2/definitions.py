"""Message and service types of packages outside ROS itself, from the text files of this folder's ``definitions``.

The files have the fields of the published definitions alone: mavros_msgs 2.12, px4_msgs of PX4 1.15, geographic_msgs
and std_srvs.
"""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

Fields = list[tuple[str, Any]]
EVENT_INFO = "service_msgs/msg/ServiceEventInfo"


def definitions_of(*packages: str) -> dict[str, tuple[list[object], Fields]]:
    """Return the message and service types of ROS packages by name, such as "std_srvs/srv/Trigger", as rosbags
    registers them.

    A service has a type for its request and one for its response, ``_Request`` and ``_Response``.
    """
    found: dict[str, tuple[list[object], Fields]] = {}
    for package in packages:
        for file in (files(__package__) / "definitions" / package).iterdir():
            own, _, kind = file.name.rpartition(".")
            text = file.read_text(encoding="utf-8")
            if kind == "msg":
                found[f"{package}/msg/{own}"] = _parsed_fields(text, f"{package}/msg/{own}")
            else:
                request, _, response = text.partition("---\n")
                found[f"{package}/srv/{own}_Request"] = _parsed_fields(request, f"{package}/msg/{own}_Request")
                found[f"{package}/srv/{own}_Response"] = _parsed_fields(response, f"{package}/msg/{own}_Response")
    return found


def _parsed_fields(text: str, name: str) -> tuple[list[object], Fields]:
    """Parse the text of a message definition of type ``name`` to (constants, fields) in rosbags' form."""
    (found,) = get_types_from_msg(text, name).values()
    return found


def service_types(name: str, info: Fields) -> dict[str, tuple[list[object], Fields]]:
    """Return the types from which ROS computes a service's hash: the service, its event, and ServiceEventInfo.

    Args:
        name: of the service, such as "std_srvs/srv/Trigger".
        info: fields of ServiceEventInfo.
    """
    one = Nodetype.NAME
    # Its identifier is of type char, which is hashed as uint8 (rosidl's parser of .msg files).
    known = [
        (field, (kind, (content[0] if content[0][1][0] != "char" else (content[0][0], ("uint8", 0)), content[1])))
        if kind == Nodetype.ARRAY
        else (field, (kind, content))
        for field, (kind, content) in info
    ]
    event: Fields = [("info", (one, EVENT_INFO))]
    event += [
        (field, (Nodetype.SEQUENCE, ((one, f"{name}_{field.capitalize()}"), 1))) for field in ("request", "response")
    ]
    parts: Fields = [
        (f"{part}_message", (one, f"{name}_{part.capitalize()}")) for part in ("request", "response", "event")
    ]
    return {name: ([], parts), f"{name}_Event": ([], event), EVENT_INFO: ([], known)}
