"""A recorded run as one web page that needs no server."""

from __future__ import annotations

import itertools
import shutil
from pathlib import Path

import numpy as np

from qrsim.errors import RunError, UsageError
from qrsim.view.recording import Recording
from qrsim.view.replay import remember_paths
from qrsim.view.scene import Scene
from qrsim.view.server import start_server

PAGE = "index.html"
# Of the film: at most so many pictures a second, positions of vehicles and pictures in all: viser keeps it in memory.
FASTEST_HZ, MOST_POSES, MOST_FRAMES = 20.0, 1_500_000, 12_000


def export(recording: Recording, folder: Path) -> Path:
    """Write a page that plays the run, and return its path.

    Raises:
        UsageError: there is something in the folder already.
        RunError: it cannot be written.
    """
    path = folder / PAGE
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"--export {folder}: it exists and is not empty; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        text = film(recording)
        free = shutil.disk_usage(folder).free
        if len(text) > free:
            raise RunError(f"--export {folder}: the page has {len(text) / 1e6:.0f} MB, {free / 1e6:.0f} MB are free")
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror or error}") from None
    return path


def times_of(recording: Recording) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the times [s] of the frames of a film."""
    most = min(MOST_FRAMES, max(2, MOST_POSES // recording.cast.size))
    count = min(most, int(recording.end * FASTEST_HZ) + 1, len(recording.time))
    return np.linspace(float(recording.time[0]), recording.end, max(1, count))


def film(recording: Recording) -> str:
    """Return the page as text."""
    server = start_server(0)
    try:
        scene = Scene(server, recording.cast, recording.world)
        times = times_of(recording)
        first = recording.frame(times[0])
        remember_paths(scene, recording, first.time)
        scene.draw(first, everything=True)
        serializer = server.get_scene_serializer()
        for before, now in itertools.pairwise(times):
            serializer.insert_sleep(float(now - before))
            remember_paths(scene, recording, now)
            scene.draw(recording.frame(now))
        return serializer.as_html()
    finally:
        server.stop()
