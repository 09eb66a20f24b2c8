"""A recorded run as one web page that needs no server: written part by part, however long the run was."""

from __future__ import annotations

import html
import io
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import RunError, UsageError, os_error_as
from qrsim.models.gnss.constellations import satellite_name
from qrsim.runs.export.output import replacing
from qrsim.view.loading import loading_element
from qrsim.view.plots import BAND, Plots
from qrsim.view.rays import RAYS, Rays, rays_of_film
from qrsim.view.readings import Skies
from qrsim.view.recording import Recording
from qrsim.view.replay import remember_paths
from qrsim.view.scene import Scene
from qrsim.view.server import start_server
from qrsim.view.several import Several
from qrsim.view.tape import Packing, Tape
from qrsim.view.timeline import marks, plots_script

PAGE = "index.html"
# At most so many frames a second, positions of vehicles and frames in all: a browser keeps the whole page.
FASTEST_HZ, MOST_POSES, MOST_FRAMES = 20.0, 1_500_000, 36_000
# A browser unpacks so many at a time.
FRAMES_OF_A_PART = 400
# Progress is told at every so-many-th frame.
TOLD_FRAMES = 50

Progress = Callable[[int, int], None]


def untold(done: int, total: int) -> None:
    """Ignore the progress of an export (frames done, frames in all); the default of ``progress``."""


def export(
    recording: Recording | Several, folder: Path, progress: Progress = untold, colour: str | None = None
) -> Path:
    """Write an HTML page that plays the run to a folder; return its path. ``colour``: quantity that colours vehicles.

    Args:
        recording: what is played.
        folder: of the page; it may not hold anything yet.
        progress: called with the number of frames that are done, and of all.
        colour: quantity that colours vehicles and true paths; None: none does.

    Raises:
        UsageError: there is something in the folder already.
        RunError: it cannot be written, or has no room on the disk; nothing of it is left then.
    """
    path = folder / PAGE
    with os_error_as(RunError, f"cannot write {path}"):
        there = folder.exists()
        if there and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(f"--export {folder}: it exists and is not empty; choose another folder")
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with replacing(path) as file:
            write_film(recording, file, progress, lambda: shutil.disk_usage(folder).free, colour)
    except BaseException:
        if not there:
            with suppress(OSError):
                folder.rmdir()
        raise
    return path


def film(recording: Recording | Several) -> str:
    """Return an HTML page that plays the run without a server, as text."""
    file = io.BytesIO()
    write_film(recording, file)
    return file.getvalue().decode("utf-8")


def times_of(recording: Recording | Several) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the times [s] of the frames of an exported page."""
    count = min(_most_frames(recording), _frames(recording))
    return np.linspace(float(recording.time[0]), recording.end, max(1, count))


def _most_frames(recording: Recording | Several) -> int:
    """Return the largest number of frames that an exported page of this recording may have, at least 2."""
    return min(MOST_FRAMES, max(2, MOST_POSES // recording.cast.size))


def _frames(recording: Recording | Several) -> int:
    """Return the number of frames of an exported page at the usual rate, before any limit."""
    return min(int(recording.end * FASTEST_HZ) + 1, len(recording.time))


def thinned(recording: Recording | Several) -> list[str]:
    """Return lines of text that say what an exported page of a long run leaves out."""
    found, times = [], times_of(recording)
    if _frames(recording) > len(times) or recording.shown > 1:
        found.append(f"so long a run is exported at every {times[1] - times[0]:.2g} s")
    period = float(np.diff(Plots(recording).times()[:2])[0])
    if period > 1.0:
        found.append(f"its quantities are plotted at every {period:.2g} s")
    return found


def write_film(
    recording: Recording | Several,
    file: BinaryIO,
    progress: Progress = untold,
    free: Callable[[], int] | None = None,
    colour: str | None = None,
) -> None:
    """Write an HTML page that plays the run to a file; ``free()``: bytes left, ``colour``: quantity to colour by.

    Args:
        recording: what is played.
        file: to write to.
        progress: called with the number of frames that are done, and of all.
        free: returns how much room there is for it [bytes].
        colour: quantity that colours vehicles and true paths; None: none does.

    Raises:
        RunError: there is no room for it.
    """
    server = start_server(0)
    try:
        scene = Scene(server, recording.cast, recording.world, recording.title, recording.imagery)
        if colour is not None:
            scene.colour(recording.paints.of(colour))
        found = _Film(recording, scene)
        page = found.first_page(server.get_scene_serializer)
        end = page.rindex("</body>")
        file.write(page[:end].encode("utf-8"))
        tape = Tape(server)
        for number, text in enumerate(found.parts(tape, progress)):
            if number == 0 and free is not None:
                _check_room(len(text) * len(found.first) + len(page), free())
            _write_element(file, f"part-{number}", text)
        _write_element(file, "nodes", tape.nodes())
        plots = Plots(recording)
        for number, text in enumerate(_lines(plots)):
            _write_element(file, f"plots-{number}", text)
        about = json.dumps({**found.about(plots), "sky": _write_skies(file, recording)})
        _write_element(file, "about", about.replace("<", "\\u003c"))
        file.write(_script(recording, plots).encode("utf-8"))
        file.write(page[end:].encode("utf-8"))
    finally:
        server.stop()


def _check_room(wanted: int, free: int) -> None:
    """Raise RunError if a page of ``wanted`` bytes does not fit into ``free`` bytes on the disk."""
    if wanted > free:
        raise RunError(f"no room for the page: it would have about {wanted / 1e6:.3g} MB, {free / 1e6:.3g} MB are free")


def _write_element(file: BinaryIO, name: str, text: str) -> None:
    """Write text to an HTML file as a script element of this name that is data for the page's scripts."""
    file.write(f'<script type="text/plain" id="qrsim-{name}">{text}</script>\n'.encode())


def _lines(plots: Plots) -> Iterator[str]:
    """Yield the values that each vehicle's plots show, as packed text, one vehicle after the other."""
    for values in plots.of_vehicles():
        packing = Packing()
        yield packing.text({"values": packing.array(values)})


def _write_skies(file: BinaryIO, recording: Recording | Several) -> dict[str, object]:
    """Write each receiver's satellites over time to the HTML file; return {"times", "names": by satellite number}."""
    first = recording.members[0].recording
    skies = Skies(first.run, first.end)
    numbers: set[int] = set()
    for number, said in enumerate(skies.of_vehicles()):
        numbers |= {int(which) for which in np.unique(said["satellite"]) if which >= 0}
        packing = Packing()
        _write_element(file, f"sky-{number}", packing.text({name: packing.array(of) for name, of in said.items()}))
    names = {number: satellite_name(number) for number in sorted(numbers)}
    return {"names": names, "times": [round(time, 6) for time in skies.time.tolist()]}


def _script(recording: Recording | Several, plots: Plots) -> str:
    """Return the HTML script element of an exported page, with its player, timeline, event marks and plots."""
    scripts = ("film_details.js", "film.js", "timeline.js")
    details, player, timeline = (files("qrsim.view").joinpath(name).read_text("utf-8") for name in scripts)
    data = json.dumps({"end": recording.end, "marks": _marks(recording)}).replace("<", "\\u003c")
    drawing = plots_script(plots, highlights=plots.highlights())
    text = f"{{{details}\n{player}}}\n{{const data = {data};\n{timeline}}}\n{{{drawing}}}"
    return f"<script>{text.replace('</', '<' + chr(92) + '/')}</script>\n"


def _marks(recording: Recording | Several) -> list[tuple[float, str]]:
    """Return (time [s], text) of the events to mark on the timeline; [] if events were not recorded."""
    return marks(recording.events)


class _Film:
    """The frames of a page.

    Attributes:
        first: number of the first frame of each part.
    """

    def __init__(self, recording: Recording | Several, scene: Scene):
        self._recording, self._scene, self._times = recording, scene, times_of(recording)
        self.first = list(range(0, len(self._times), FRAMES_OF_A_PART))
        self._flying: list[tuple[float, int]] = []
        # All layers are recorded; which are shown, the page's own switches say.
        self._shown = {title: layer.root.visible for title, layer in scene.layers.items()}
        for layer in scene.layers.values():
            layer.root.visible = layer.in_film
            if layer.most_in_film is not None:
                layer.every = max(layer.every, len(self._times) / layer.most_in_film)

    def _draw(self, time: float, everything: bool = False) -> Floats:
        """Draw the frame at a time [s] (``everything``: slow layers too), and return vehicle positions (n, 3) [m]."""
        frame = self._recording.frame(time)
        remember_paths(self._scene, self._recording, frame.time)
        self._scene.draw(frame, everything)
        flying = int((frame.valid & self._recording.cast.fliers).sum())
        if not self._flying or self._flying[-1][1] != flying:
            self._flying.append((frame.time, flying))
        return np.nan_to_num(frame.position_ned)

    def first_page(self, serializer: Callable[[], Any]) -> str:
        """Return viser's HTML page of the first frame; ``serializer`` makes viser's scene serializer."""
        self._draw(self._times[0], everything=True)
        text: str = serializer().as_html()
        name = html.escape(self._recording.title)
        text = text.replace("<title>Viser</title>", f"<title>qrsim - {name}</title>", 1)
        return text.replace("<body>", f"<body>{loading_element(self._recording.heading)}", 1)

    def parts(self, tape: Tape, progress: Progress) -> Iterator[str]:
        """Draw all frames, and yield every FRAMES_OF_A_PART of them as text to write to the HTML file."""
        for first in self.first:
            positions = []
            for number, time in enumerate(self._times[first : first + FRAMES_OF_A_PART].tolist(), first):
                if number > first:
                    tape.begin_frame(time)
                positions.append(self._draw(time))
                if number == first:
                    tape.begin_part(time)
                if number % TOLD_FRAMES == 0:
                    progress(number, len(self._times))
            yield tape.part(positions=np.stack(positions))
        progress(len(self._times), len(self._times))

    def about(self, plots: Plots) -> dict[str, object]:
        """Return what the page shows in heading, timeline, panel and plots, as content for JSON."""
        recording, layers = self._recording, self._scene.layers
        times = plots.times()
        return {
            "heading": recording.heading,
            "end": recording.end,
            "times": [round(time, 6) for time in self._times.tolist()],
            "first": self.first,
            "vehicles": recording.cast.names,
            "layers": [
                {"title": layer.label, "path": layer.path, "shown": self._shown[t]}
                for t, layer in layers.items()
                if layer.in_film
            ],
            "flying": self._flying,
            "others": recording.cast.others,
            "fliers": int(recording.cast.fliers.sum()),
            "modes": recording.modes,
            "waypoints": recording.cast.waypoints,
            "rays": rays_of_film(rays) if isinstance(rays := layers.get(RAYS), Rays) else None,
            "stops": [(event.time, i, recording.why(event)) for event, i in recording.stops],
            "quantities": list(plots.quantities),
            "band": BAND,
            "period": float(times[1] - times[0]),
            "notes": [*thinned(recording), *recording.notes],
        }
