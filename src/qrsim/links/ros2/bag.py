"""rosbag2: a recorded run as ROS 2 would have recorded it, MCAP with CDR messages and metadata.yaml."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Literal

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError

from qrsim.errors import RunError
from qrsim.links.ros2 import topics as t
from qrsim.links.ros2.blank import stamp_of
from qrsim.links.ros2.profiles import PROFILES
from qrsim.links.ros2.publications import Publications
from qrsim.links.ros2.recorded import Recorded
from qrsim.links.ros2.transforms import static_transforms
from qrsim.links.ros2.typestore import Types
from qrsim.links.ros2.vehicle import Publication
from qrsim.runs import Run

# rosbag2's format of metadata.yaml since Jazzy, and before.
VERSION: Literal[8, 9] = 9
BEFORE: Literal[8, 9] = 8
_BEFORE = ("humble", "iron")
METADATA = "metadata.yaml"
# What rmw takes for never: 2^63 - 1 nanoseconds.
_ENDLESS = QosTime(9_223_372_036, 854_775_807)


def write(run: Run, folder: Path, every: int, distro: str = "jazzy") -> dict[str, int]:
    """Write every ``every``-th tick of a run as a ROS 2 bag (MCAP); return {"messages": their number}.

    Args:
        run: with the streams of its sensors, commands or truth.
        folder: of the bag; replaced where it exists.
        every: keep the ticks that this divides.
        distro: whose message types and whose form of metadata.yaml are written.

    Raises:
        RunError: the run has no tick, or the bag cannot be written.
        ScenarioError, UsageError: its scenario cannot be built, or there is no such distribution.
    """
    types = Types(distro)
    recorded = Recorded(run, every)
    temporary = folder.with_name(f".{folder.name}.tmp")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        # The file in it is called as the folder.
        count = _write_messages(types, recorded, temporary / folder.name, BEFORE if distro in _BEFORE else VERSION)
        shutil.rmtree(folder, ignore_errors=True)
        os.replace(temporary / folder.name, folder)
    except (OSError, WriterError) as error:
        raise RunError(f"cannot write {folder}: {error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return {"messages": count}


def _write_messages(types: Types, recorded: Recorded, folder: Path, version: Literal[8, 9]) -> int:
    """Write all messages of a recorded run to a bag in MCAP, and return their number; ``version``: of the bag's
    format."""
    world = recorded.world
    names = recorded.names
    publications = Publications(types, world, names, recorded.sensor, [False] * len(names), recorded.has_truth)
    commanded = [
        [
            (publications.add(own.topic), own)
            for own in (Publication(types, kind, namespace, lambda _: None, 0) for kind in t.ASKED_KINDS)
        ]
        for namespace in publications.namespaces
    ]
    count = 0
    with Writer(folder, version=version, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[int, object] = {}

        def put(number: int, topic: t.Topic, nanoseconds: int, cdr: bytes) -> None:
            """Write a CDR message to the bag at a time [ns]; the connection of topic ``number`` is made at its first
            message."""
            if number not in connections:
                qos = [_bag_qos(topic.quality)]
                connections[number] = writer.add_connection(
                    topic.name, topic.type, typestore=types.store, offered_qos_profiles=qos
                )
            writer.write(connections[number], nanoseconds, cdr)

        static = static_transforms(types, world, publications.namespaces, recorded.site)
        for tick, time, values, news, true, asked in recorded.ticks(publications.columns):
            nanoseconds = round(time * 1e9)
            if not count and static.transforms:
                put(-1, t.TF_STATIC, nanoseconds, types.encode(static))
                count += 1
            # A controller asked for it one tick before what came of it.
            before = max(0, tick - 1) * world.time_step
            for own, row in zip(commanded, asked.tolist(), strict=True):
                for number, publication in own:
                    message = publication.message(row, *stamp_of(before)) if tick else None
                    if message is not None:
                        put(number, publications.topics[number], round(before * 1e9), message)
                        count += 1
            believed = [max(0.0, time - behind) for behind in recorded.behind]
            for number, cdr in publications.of_tick(tick, believed, values, news, true):
                put(number, publications.topics[number], nanoseconds, cdr)
                count += 1
    return count


def _bag_qos(quality: t.Quality) -> Qos:
    """Return a topic's QoS profile in the form that rosbags stores in a bag."""
    profile = PROFILES[quality]
    return Qos(
        QosHistory.KEEP_LAST,
        profile.depth,
        QosReliability.RELIABLE if profile.reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if profile.latched else QosDurability.VOLATILE,
        _ENDLESS,
        _ENDLESS,
        QosLiveliness.AUTOMATIC,
        _ENDLESS,
        False,
    )
