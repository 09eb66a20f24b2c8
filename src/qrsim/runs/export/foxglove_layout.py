"""A layout for Foxglove: how an MCAP file of qrsim is looked at, to be imported there beside it."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import quote

from qrsim.runs import Run
from qrsim.runs.export.output import replacing

# More vehicles than these have no plot of their own.
MOST_PLOTTED = 10
ENDING = ".layout.json"


def layout_path(path: Path) -> Path:
    """Return the path of the Foxglove layout that belongs to an MCAP file."""
    return path.with_name(path.stem + ENDING)


def write_layout(run: Run, path: Path) -> None:
    """Write the Foxglove layout for a run's MCAP file: scene, map, plots of height and wind, and the events.

    Raises:
        RunError: the file cannot be written.
    """
    with replacing(path) as file:
        file.write(f"{json.dumps(layout(run), indent=2)}\n".encode())


def layout(run: Run) -> dict[str, object]:
    """Return a Foxglove layout for a run, as a dict for JSON: scene, map, plots of height and wind, events."""
    topics = [f"/{quote(name, safe='')}" for name in run.vehicles]
    shown = topics[:MOST_PLOTTED]
    drawn = {"/scene": {"visible": True}} | {f"{topic}/pose": {"visible": True, "type": "arrow"} for topic in topics}
    grid = {"grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "size": 200, "divisions": 20}}
    space: dict[str, object] = {
        "cameraState": {
            "distance": 150.0,
            "perspective": True,
            "phi": 60.0,
            "thetaOffset": 0.0,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45.0,
            "near": 0.5,
            "far": 5000.0,
        },
        "followMode": "follow-none",
        "followTf": "map",
        "scene": {},
        "transforms": {},
        "topics": drawn,
        "layers": grid,
    }
    panels = {
        "3D!space": space,
        "map!place": {"center": {"lat": 0, "lon": 0}, "zoomLevel": 16, "disabledTopics": [], "followTopic": ""},
        "Plot!height": _plot_panel("height [m]", [f"{topic}/pose.pose.position.z" for topic in shown]),
        "Plot!wind": _plot_panel("gust north [m/s]", [f"{topic}/wind.gust_ned.x" for topic in shown]),
        "RosOut!events": {"searchTerms": [], "minLogLevel": 1, "topicToRender": "/events"},
    }
    below = {"direction": "column", "first": "Plot!height", "second": "Plot!wind", "splitPercentage": 50}
    right = {"direction": "column", "first": "map!place", "second": below, "splitPercentage": 35}
    left = {"direction": "column", "first": "3D!space", "second": "RosOut!events", "splitPercentage": 75}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": {"direction": "row", "first": left, "second": right, "splitPercentage": 62},
    }


def _plot_panel(title: str, paths: list[str]) -> dict[str, object]:
    """Return the configuration of a Foxglove plot panel of some message paths over the file's time.

    The messages have no ``header``, which the stamp of a header would need.
    """
    lines = [{"value": path, "enabled": True, "timestampMethod": "receiveTime"} for path in paths]
    return {"title": title, "paths": lines, "showLegend": True, "isSynced": True, "xAxisVal": "timestamp"}
