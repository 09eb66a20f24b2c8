"""A video of a recorded run: frames of the page by a headless browser, encoded by ffmpeg."""

from __future__ import annotations

import base64
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from viser import ViserServer

from qrsim.errors import RunError, UsageError, shortened
from qrsim.view.browser import Browser
from qrsim.view.picture import SCENE_ONLY, settled, wait_for_client
from qrsim.view.script import run_script
from qrsim.view.server import address

# Encoder and its options by the end of the name.
CODECS = {
    ".mp4": ["-c:v", "libx264", "-crf", "20", "-movflags", "+faststart"],
    ".webm": ["-c:v", "libvpx-vp9", "-crf", "30", "-b:v", "0", "-deadline", "realtime", "-cpu-used", "6"],
}
FRAMES_HZ, MOST_FRAMES = 25, 90_000
# How long a browser may take for one frame [s].
PATIENCE_S = 60.0
CAPTION = (
    "document.body.insertAdjacentHTML('beforeend', '<div id=qrsim-caption style=\"position:fixed;left:16px;top:12px;"
    "z-index:60;font:20px sans-serif;color:#888\"></div>')"
)
# Drawn at the second: the first takes the changes, and labels follow them.
DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"


def find_ffmpeg() -> str:
    """Return the path of ffmpeg: the one on PATH, or that of the package imageio-ffmpeg.

    Raises:
        RunError: there is neither.
    """
    found = shutil.which("ffmpeg")
    if found:
        return found
    with suppress(ImportError, RuntimeError):
        from imageio_ffmpeg import get_ffmpeg_exe  # type: ignore[import-untyped]

        return str(get_ffmpeg_exe())
    raise RunError("a video needs ffmpeg: apt-get install ffmpeg, or python -m pip install imageio-ffmpeg")


def check_video(path: Path) -> None:
    """Raise UsageError if a video cannot be written to this path, such as for an unknown suffix."""
    if path.suffix.lower() not in CODECS:
        raise UsageError(f"--video {path}: the name has to end in {' or '.join(CODECS)}")
    if not path.parent.is_dir():
        raise UsageError(f"--video {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise UsageError(f"--video {path}: is a folder")


def times_of_video(start: float, end: float, speed: float) -> list[float]:
    """Return the times [s] of a video's frames from ``start`` to ``end`` [s], at this playback speed.

    Args:
        start, end: of the video [s].
        speed: simulated seconds in a second of it.

    Raises:
        UsageError: they are too many.
    """
    count = int((end - start) / speed * FRAMES_HZ + 1e-6) + 1
    if count > MOST_FRAMES:
        least = (end - start) * FRAMES_HZ / MOST_FRAMES
        raise UsageError(f"--speed {speed:g}: {count} frames; at most {MOST_FRAMES}, so at least --speed {least:.3g}")
    return [min(end, start + number * speed / FRAMES_HZ) for number in range(count)]


def record_video(
    server: ViserServer,
    path: Path,
    times: list[float],
    size: tuple[int, int],
    draw: Callable[[float], str],
    progress: Callable[[int], None],
) -> None:
    """Write a video; ``draw(time)`` draws the page, returns a caption; ``progress(number)`` is called per frame.

    Args:
        server: of the page.
        path: to write; its name ends in one of CODECS.
        times: of the frames [s].
        size: width and height [pixels].
        draw: draws the frame of a time [s] on the page, and returns its caption.
        progress: called with the number of frames that are done.

    Raises:
        RunError: there is no ffmpeg or no browser, or one of them failed; nothing is written then.
    """
    ffmpeg, (width, height) = find_ffmpeg(), size
    with Browser(width, height) as browser, _encoder(ffmpeg, path) as write:
        browser.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        browser.open(f"{address(server)}/?fixedDpr=1")
        wait_for_client(server)
        browser.evaluate(SCENE_ONLY)
        browser.evaluate(CAPTION)
        settled(browser)
        for number, now in enumerate(times):
            caption = draw(now)
            run_script(server, "shot", f"window.qrsimShot = {number + 1}", exported=False)
            _when(browser, f"window.qrsimShot === {number + 1}")
            browser.evaluate(f"document.getElementById('qrsim-caption').textContent = {_quoted(caption)}; {DRAWN}")
            shot = browser.call("Page.captureScreenshot", format="jpeg", quality=95)
            write(base64.b64decode(shot["data"]))
            progress(number + 1)


def _quoted(text: str) -> str:
    """Return a text as a JavaScript string literal."""
    import json

    return json.dumps(text)


def _when(browser: Browser, condition: str) -> None:
    """Wait until a JavaScript condition holds in the browser; raise RunError if it does not in time."""
    deadline = time.monotonic() + PATIENCE_S
    while not browser.evaluate(condition):
        if time.monotonic() > deadline:
            raise RunError(f"the browser did not draw a frame within {PATIENCE_S:g} s")
        time.sleep(0.01)


@contextmanager
def _encoder(ffmpeg: str, path: Path) -> Iterator[Callable[[bytes], object]]:
    """Start ffmpeg; yield a function that encodes a JPEG image. The video file appears only if all goes well."""
    handle, unfinished = tempfile.mkstemp(suffix=path.suffix, prefix=".", dir=path.parent)
    os.close(handle)
    # Encoders want an even number of pixels.
    even = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"]
    command = [
        ffmpeg,
        "-v",
        "error",
        "-y",
        "-f",
        "image2pipe",
        "-c:v",
        "mjpeg",
        "-framerate",
        str(FRAMES_HZ),
        "-i",
        "-",
    ]
    process = subprocess.Popen(
        [*command, *CODECS[path.suffix.lower()], *even, unfinished], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdin is not None
    try:
        try:
            pipe = process.stdin
            yield lambda data: pipe.write(data)
            process.stdin.close()
        except BrokenPipeError:
            pass
        process.stdin = None
        _, words = process.communicate(timeout=10.0 * PATIENCE_S)
        if process.returncode:
            raise RunError(f"ffmpeg failed: {shortened(words.decode(errors='replace').strip(), 300)}")
        os.chmod(unfinished, 0o644)
        os.replace(unfinished, path)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        with suppress(OSError):
            os.unlink(unfinished)
