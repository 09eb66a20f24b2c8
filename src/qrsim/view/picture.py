"""Pictures of a page, taken by a headless browser."""

from __future__ import annotations

import io
import time
from pathlib import Path

from PIL import Image, ImageDraw
from viser import ViserServer

from qrsim.errors import RunError, UsageError
from qrsim.view.browser import Browser
from qrsim.view.server import address
from qrsim.view.shots import HEIGHT, WIDTH

# A page that has just been opened still makes its labels; pictures are taken until none has changed for so long [s].
QUIET_S, PATIENCE_S = 2.0, 120.0
# What is beside the scene: the panel, and that the browser has no graphics card.
SCENE_ONLY = """
    document.head.insertAdjacentHTML('beforeend',
        '<style>.mantine-Paper-root, .mantine-Notification-root, #qrsim-overlay .qrsim-tools ' +
        '{display: none !important}</style>')
"""


def check_name(path: Path) -> None:
    """Raise UsageError if a picture's name does not end in .png or its folder is missing."""
    if path.suffix.lower() != ".png":
        raise UsageError(f"--screenshot {path}: the name has to end in .png")
    if not path.parent.is_dir():
        raise UsageError(f"--screenshot {path}: there is no folder {path.parent}")


def photograph(server: ViserServer, caption: str, size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    """Return a screenshot of the page in a headless browser as PNG, with ``caption`` as title line.

    Args:
        server: of the page.
        caption: of the picture.
        size: width and height [pixels].

    Raises:
        RunError: there is no browser, or it draws nothing.
    """
    width, height = size
    with Browser(width, height) as browser:
        browser.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        browser.open(f"{address(server)}/?fixedDpr=1")
        wait_for_client(server)
        browser.evaluate(SCENE_ONLY)
        picture = settled(browser)
    # A letter is about half as wide as high.
    size_px = min(20.0, max(9.0, 1.9 * (width - 32) / max(1, len(caption))))
    ImageDraw.Draw(picture).text((16, 12), caption, fill="black", font_size=size_px)
    found = io.BytesIO()
    picture.save(found, "PNG", optimize=True)
    return found.getvalue()


def wait_for_client(server: ViserServer) -> None:
    """Wait until a browser has opened the page; raise RunError if none does in time."""
    deadline = time.monotonic() + PATIENCE_S
    while not server.get_clients():
        if time.monotonic() > deadline:
            raise RunError(f"the browser did not open the page within {PATIENCE_S:g} s")
        time.sleep(0.05)


def settled(browser: Browser) -> Image.Image:
    """Return a screenshot of the page once it is not empty and no longer changes."""
    before, changed = b"", time.monotonic()
    deadline = changed + PATIENCE_S
    while True:
        shot = browser.picture()
        picture, now = Image.open(io.BytesIO(shot)).convert("RGB"), time.monotonic()
        empty = picture.getcolors(1) is not None
        if shot != before or empty:
            before, changed = shot, now
        if empty and now > deadline:
            raise RunError(f"the browser drew nothing within {PATIENCE_S:g} s")
        if now > min(changed + QUIET_S, deadline):
            return picture
        time.sleep(0.25)
