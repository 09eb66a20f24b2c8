"""``qrsim view``."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qrsim.apps import OPTIONAL_SECONDS, progress_bar
from qrsim.core.garbage import uncollected
from qrsim.errors import RunError, UsageError, os_error_as
from qrsim.files.interruptions import calling

if TYPE_CHECKING:
    from viser import ViserServer

    from qrsim.view.clock import Clock
    from qrsim.view.recording import Recording
    from qrsim.view.replay import Replay
    from qrsim.view.scene import Scene
    from qrsim.view.several import Several


@dataclass(frozen=True)
class View:
    """Replay a recorded run, or several over each other, in three dimensions, in a browser.

    Opens a web page, by default for this machine alone: vehicles, true and estimated paths, GNSS positions, wind and
    gusts, area and obstacles. It has a time slider, layers, a camera that follows, and plots of all logged quantities.
    Works on running, interrupted and killed runs too, up to the last flush. Ctrl-C ends it.

    With several runs the first is shown whole. Vehicles and true paths of the others are drawn over it, in a colour for
    each run, with the distance between the same vehicle of two runs.

    Needs viser: pip install 'qrsim[view]'. Pictures need a browser too: apt-get install chromium.

    Example:
      qrsim view runs/first
      qrsim view runs/first --screenshot first.png --at 12.5
      qrsim view runs/first --screenshot first.png --camera above --size 1920x1080 --layers "vehicles, true paths"
      qrsim view runs/first --video first.mp4 --camera pelicans_0:chase --colour speed
      qrsim view runs/first --export first_page
      qrsim view runs/first runs/second --align took_off
    """

    run_folders: Annotated[tyro.conf.Positional[list[Path]], tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Run folders, at most 6."""
    align: Annotated[str | None, tyro.conf.arg(metavar="EVENT", help_behavior_hint="(default: the start)")] = None
    """With several runs, the event that all show at the same time: take-off, stop (the first vehicle that stopped) or
    the kind of an event, such as collision; the first of each run counts. The time shown is that of the first run."""
    export: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: no export)")] = None
    """Write a page into this folder that plays the run without qrsim, and end."""
    screenshot: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write a picture (.png), and end."""
    video: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write a video (.mp4 or .webm) from --at to the end, and end. It needs ffmpeg."""
    speed: float = 1.0
    """Simulated seconds in a second of the video."""
    camera: Annotated[str | None, tyro.conf.arg(metavar="VIEW", help_behavior_hint="(default: see below)")] = None
    """View of the picture or video, by default the initial view of the page: south, north, east, west, above, area for
    the whole flight area, the name of a vehicle for a close view, or both, as in NAME:above; NAME:chase and
    NAME:onboard go with the vehicle."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WxH", help_behavior_hint="(default: 1280x800)")] = None
    """Width and height of the picture or video in pixels."""
    layers: Annotated[str | None, tyro.conf.arg(metavar="NAMES", help_behavior_hint="(default: see below)")] = None
    """Layers of the picture or video, separated by commas, or "all"; --layers=-gusts,-poles: the page's layers except
    these; by default those of the page."""
    colour: Annotated[str | None, tyro.conf.arg(metavar="QUANTITY", help_behavior_hint="(default: by vehicle)")] = None
    """Colour vehicles and true paths by a quantity: speed, height, "wind speed", "gust speed", "GNSS error",
    "estimate error", or a column of the log such as truth.battery.charge."""
    image: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Picture of the ground from above, a GeoTIFF (.tif) or MBTiles file, draped over the terrain."""
    at: Annotated[float | None, OPTIONAL_SECONDS, tyro.conf.arg(help_behavior_hint="(default: see below)")] = None
    """Start time of the replay or video, or time of the picture; by default the start, and for a picture the end."""
    port: int = 8080
    """Port of the page; if it is in use, the next free one. 0: any free port."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address of this machine that the page listens on. If it is not 127.0.0.1, the printed address has a token, which
    is needed to view and control the page; nothing is encrypted."""
    code: bool = False
    """Load the Python files and modules that the recorded scenario names; only if you trust its author."""

    def run(self) -> None:
        """Run ``qrsim view``: check the options, then serve the 3-D page, save a picture or write a film."""
        from qrsim.view.server import require_viser

        require_viser()
        self._check()
        if self.export is None and self.screenshot is None and self.video is None:
            self._serve()
            return
        recording = self._opened()
        end = recording.end
        if self.screenshot is not None:
            self._photograph(recording, self.screenshot, end if self.at is None else self.at)
        if self.export is not None:
            from qrsim.view.film import export, thinned

            for line in thinned(recording):
                print(line, file=sys.stderr)
            with progress_bar(recording.heading, 1, "{task.completed} of {task.total} frames") as update:

                def told(done: int, total: int) -> None:
                    """Show how much of the film has been written."""
                    update(completed=done, total=total)

                page = export(recording, self.export, told, self.colour)
            print(page)
        if self.video is not None:
            self._film(recording, self.video, self.at or 0.0)

    def _opened(self) -> Recording | Several:
        """Open the recorded runs, print warnings about what is not shown as flown, and add image and colours."""
        from qrsim.runs import open_run
        from qrsim.view.several import open_several

        opened = lambda folder: open_run(folder, code=self.code)  # noqa: E731
        recording, lines = open_several(self.run_folders, opened, self.align)
        for line in lines:
            print(line, file=sys.stderr)
        end = recording.end
        if self.at is not None and self.at > end + 1e-6:
            raise UsageError(f"--at {self.at:g}: the recording ends at {end:g} s")
        if self.image is not None:
            from qrsim.view.imagery import read_imagery

            with os_error_as(UsageError, f"--image {self.image}"):
                recording.imagery = read_imagery(self.image, recording.cast, recording.world)
        if self.colour is not None:
            recording.paints.of(self.colour)
        if recording.shown > 1:
            print(f"so long a log is shown at every {recording.shown}th of its ticks", file=sys.stderr)
        return recording

    def _check(self) -> None:
        """Raise UsageError for options that are out of range or do not go together."""
        if not self.run_folders:
            raise UsageError("RUN: expected the folder of a run, or of several")
        if self.align is not None and len(self.run_folders) == 1:
            raise UsageError(f"--align {self.align}: only for several runs")
        if self.at is not None and not (math.isfinite(self.at) and self.at >= 0.0):
            raise UsageError(f"--at {self.at:g}: expected a number of seconds from 0")
        given = {"--camera": self.camera, "--size": self.size, "--layers": self.layers}
        alone = [option for option, value in given.items() if value is not None]
        if alone and self.screenshot is None and self.video is None:
            raise UsageError(f"{', '.join(alone)}: only for a picture; add --screenshot FILE.png, or --video FILE.mp4")
        if not (math.isfinite(self.speed) and self.speed > 0.0):
            raise UsageError(f"--speed {self.speed:g}: expected a number above 0")
        if self.speed != 1.0 and self.video is None:
            raise UsageError("--speed: only for a video; add --video FILE.mp4")
        if self.size is not None:
            from qrsim.view.shots import parsed_size

            parsed_size(self.size)
        if self.screenshot is not None:
            from qrsim.view.picture import check_name

            check_name(self.screenshot)
        if self.video is not None:
            from qrsim.view.browser import require_browser
            from qrsim.view.video import check_video, find_ffmpeg

            check_video(self.video)
            find_ffmpeg()
            require_browser()

    def _photograph(self, recording: Recording | Several, path: Path, time: float) -> None:
        """Save a picture of the recording at a time [s], with the camera, size and layers of the options."""
        from qrsim.files.atomic import write_atomically
        from qrsim.view.picture import photograph

        with self._staged(recording, time) as (server, _):
            picture = photograph(server, f"{recording.heading}, {time:.2f} s", self._pixels)
        with os_error_as(RunError, f"--screenshot {path}"):
            write_atomically(path, picture)
        print(path)

    def _film(self, recording: Recording | Several, path: Path, start: float) -> None:
        """Save a video of the recording from a time [s] on, with the camera, size and layers of the options."""
        from qrsim.view.replay import remember_paths
        from qrsim.view.video import record_video, times_of_video

        times = times_of_video(start, recording.end, self.speed)
        with (
            self._staged(recording, start) as (server, scene),
            progress_bar(recording.heading, 1, "{task.completed} of {task.total} frames") as update,
            os_error_as(RunError, f"--video {path}"),
        ):

            def draw(time: float) -> str:
                """Draw the video's frame at a time [s], and return its caption."""
                scene.stage.sky = lambda vehicle: recording.sky(vehicle, time)
                frame = recording.frame(time)
                remember_paths(scene, recording, frame.time)
                scene.draw(frame)
                return f"{recording.heading}, {frame.time:.2f} s"

            record_video(server, path, times, self._pixels, draw, lambda done: update(completed=done, total=len(times)))
        print(path)

    @property
    def _pixels(self) -> tuple[int, int]:
        """Width and height [pixels] of the picture or video."""
        from qrsim.view.shots import HEIGHT, WIDTH, parsed_size

        return (WIDTH, HEIGHT) if self.size is None else parsed_size(self.size)

    @contextmanager
    def _staged(self, recording: Recording | Several, time: float) -> Iterator[tuple[ViserServer, Scene]]:
        """In the context, serve a 3-D scene of the recording at a time [s], with the options' camera, layers, colour
        and image; yield its server and scene."""
        from qrsim.view.replay import remember_paths
        from qrsim.view.scene import Scene
        from qrsim.view.server import start_server
        from qrsim.view.shots import RIDES, Camera, parsed_layers
        from qrsim.view.sky import told

        camera = None if self.camera is None else Camera.parsed(self.camera, recording.cast.names)
        server = start_server(0)
        try:
            scene = Scene(server, recording.cast, recording.world, imagery=recording.imagery)
            if self.layers is not None:
                shown = {title: layer.root.visible for title, layer in scene.layers.items()}
                for title, visible in parsed_layers(self.layers, shown).items():
                    scene.show(title, visible)
            if self.colour is not None:
                scene.colour(recording.paints.of(self.colour))
            scene.stage.sky = lambda vehicle: recording.sky(vehicle, time)
            frame = recording.frame(time)
            remember_paths(scene, recording, frame.time)
            scene.draw(frame, everything=True)
            if camera is not None:
                camera.aim(scene, recording.world)
                if camera.vehicle is not None:
                    number = recording.cast.names.index(camera.vehicle)
                    scene.overlay.sky(told(camera.vehicle, recording.sky(number, time)), None)
                    if self.video is not None and camera.direction not in RIDES:
                        scene.overlay.follow(number)
            yield server, scene
        finally:
            server.stop()

    def _serve(self) -> None:
        """Serve the 3-D page of the runs until Ctrl-C; the page shows a note while they are being loaded."""
        from qrsim.view.clock import SPEEDS, Clock
        from qrsim.view.loading import show_loading
        from qrsim.view.server import address, start_server

        # Options can be wrong for these runs, which is an error before there is a page.
        plain = all(option is None for option in (self.at, self.align, self.colour, self.image))
        plain = plain and all((folder / "run.json").is_file() for folder in self.run_folders)
        recording = None if plain else self._opened()
        server = start_server(self.port, host=self.host)
        clock = Clock(playing=False, speeds=SPEEDS[:-1])
        try:
            with uncollected():
                if recording is None:
                    names = ", ".join(folder.resolve().name for folder in self.run_folders)
                    show_loading(server, names)
                    # Programs wait for the line of a page that is whole.
                    if sys.stdout.isatty():
                        print(f"loading {names}: {address(server)}", flush=True)
                    recording = self._opened()
                replay = self._replay(server, recording, clock)
            stop = threading.Event()

            def end() -> None:
                """Stop the page, and wake the thread that waits for its clock."""
                stop.set()
                clock.close()

            # An exception would be lost where it meets a callback of a library.
            with calling(end):
                print(f"{recording.heading}, {recording.end:g} s: {address(server)}  (Ctrl-C ends it)", flush=True)
                replay.run(stop)
        finally:
            server.stop()

    def _replay(self, server: ViserServer, recording: Recording | Several, clock: Clock) -> Replay:
        """Build the page of the recording on the server, and return its replay at the start time of the options."""
        # These take most of the time of a start, which the page is there for already.
        from qrsim.view.page import Page
        from qrsim.view.replay import Replay

        # At once: browsers would fetch the hundred parts one by one, and each time this thread would wait for them.
        with server.atomic():
            page = Page(server, recording.cast, recording.world, recording.heading, clock, recording.imagery)
            return Replay(recording, page, clock, self.at or 0.0, self.colour)
