"""The table of docs/reference/ros2_topics.md is that of the code."""

from __future__ import annotations

import re
from pathlib import Path

from qrsim.links.ros2 import topics

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "ros2_topics.md"


def rows() -> dict[str, tuple[str, str, str, str]]:
    """Return type, meaning, rate and quality of service of each topic of a vehicle."""
    found = {}
    part = PAGE.read_text("utf-8").partition("## Topics of a vehicle")[2].partition("## Commands")[0]
    for line in re.findall(r"^\| `.*\|$", part, re.MULTILINE):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        names, types = (re.findall(r"`([^`]+)`", cell) for cell in cells[:2])
        if len(cells) == 5 and types:
            package = types[0].partition("/")[0]
            whole = [kind if "/" in kind else f"{package}/{kind}" for kind in types]
            for i, name in enumerate(names):
                found[name] = (whole[min(i, len(whole) - 1)], *cells[2:])
    return found


def test_every_topic_of_a_vehicle_is_on_the_page() -> None:
    page = rows()
    assert page["imu/data"][0] == "sensor_msgs/Imu"
    assert len(topics.KINDS) == 15
    for kind in topics.KINDS:
        type_, meaning, rate, quality = page[kind.topic]
        assert type_ == kind.type.replace("/msg/", "/"), kind.topic
        assert quality == kind.quality, kind.topic
        if kind.sensor is not None:
            assert rate in ("sensor", "each fix"), kind.topic
        else:
            assert rate == (f"{1.0 / kind.every:g} Hz" if kind.every else "tick"), kind.topic
        if kind.frame in ("gnss", "range"):
            assert f"`NAME/{kind.frame}`" in meaning, kind.topic


def test_every_topic_of_the_world_is_on_the_page() -> None:
    text = PAGE.read_text("utf-8")
    for topic in (topics.CLOCK, topics.TF, topics.TF_STATIC, topics.STATUS):
        assert f"| `{topic.name}` | `{topic.type.replace('/msg/', '/')}` |" in text
