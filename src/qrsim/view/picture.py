"""Pictures of a page, drawn by a browser without a window."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import Any

import numpy as np
from viser import ViserServer

from qrsim.errors import RunError, UsageError
from qrsim.view.browser import Browser
from qrsim.view.server import address

WIDTH, HEIGHT = 1280, 800
# A page that has just been opened still makes its labels; pictures are taken until two are the same.
MOST_TRIES, PATIENCE_S = 8, 120.0


def check_name(path: Path) -> None:
    """Raise a UsageError where a picture of this name cannot be written."""
    if path.suffix.lower() != ".png":
        raise UsageError(f"--screenshot {path}: the name has to end in .png")
    if not path.parent.is_dir():
        raise UsageError(f"--screenshot {path}: there is no folder {path.parent}")


def photograph(server: ViserServer, caption: str) -> bytes:
    """Return the scene as PNG, with a line above.

    Raises:
        RunError: there is no browser, or it draws nothing.
    """
    from PIL import Image, ImageDraw

    with Browser(WIDTH, HEIGHT) as browser:
        browser.open(f"{address(server)}/?fixedDpr=1")
        shot = _settled(_client(server))
    picture = Image.fromarray(shot).convert("RGBA")
    white = Image.new("RGBA", picture.size, "white")
    white.alpha_composite(picture)
    ImageDraw.Draw(white).text((16, 12), caption, fill="black", font_size=20)
    found = io.BytesIO()
    white.convert("RGB").save(found, "PNG", optimize=True)
    return found.getvalue()


def _client(server: ViserServer) -> Any:
    deadline = time.monotonic() + PATIENCE_S
    while not (clients := server.get_clients()):
        if time.monotonic() > deadline:
            raise RunError(f"the browser did not open the page within {PATIENCE_S:g} s")
        time.sleep(0.05)
    return next(iter(clients.values()))


def _settled(client: Any) -> Any:
    before = None
    for _ in range(MOST_TRIES):
        try:
            shot = client.get_render(HEIGHT, WIDTH, transport_format="png", timeout=PATIENCE_S)
        except (RuntimeError, TimeoutError) as error:
            raise RunError(f"the browser draws nothing: {error}") from None
        if before is not None and np.array_equal(before, shot):
            break
        before = shot
    return shot
