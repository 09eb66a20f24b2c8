"""A headless browser, driven over its DevTools protocol; it takes pictures of the page."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from qrsim.errors import RunError

NAMES = ("chromium", "chromium-browser", "google-chrome")
INSTALL = "on Debian or Ubuntu: apt-get install chromium"
# The last of these keeps it from all other machines: it would ask its maker for this and that.
FLAGS = (
    "--headless",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--disable-quic",
    "--disable-sync",
    "--remote-debugging-port=0",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)
PATIENCE_S = 60.0


def find_browser() -> str | None:
    """Return the path of an installed browser that can run headless, None if there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


def require_browser() -> str:
    """Return the path of an installed browser that can run headless; raise an error if there is none.

    Raises:
        RunError: there is none; it says how to install one.
    """
    path = find_browser()
    if path is None:
        raise RunError(f"a picture of the page needs a browser: {', '.join(NAMES)} not found; {INSTALL}")
    return path


class Browser:
    """One page in its own headless browser; a context manager.

    Args:
        width, height: of the page [pixels].

    Attributes:
        requested: addresses that the page and its workers asked for, those of this machine included.
    """

    def __init__(self, width: int = 1280, height: int = 800):
        self._size = (width, height)
        self.requested: list[str] = []
        self._number = 0
        self._answers: dict[int, dict[str, Any]] = {}
        self._arrived = threading.Condition()
        self._gone = False

    def __enter__(self) -> Browser:
        path = require_browser()
        self._profile = tempfile.TemporaryDirectory(prefix="qrsim-browser-", ignore_cleanup_errors=True)
        sandbox = ["--no-sandbox"] if os.name == "posix" and os.geteuid() == 0 else []
        command = [
            path,
            *FLAGS,
            *sandbox,
            f"--user-data-dir={self._profile.name}",
            f"--window-size={self._size[0]},{self._size[1]}",
            "about:blank",
        ]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            self._connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the headless browser and end its process."""
        if hasattr(self, "_socket"):
            with suppress(OSError):
                self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(10.0)
        self._profile.cleanup()

    def _connect(self) -> None:
        """Wait for the browser's debugging port, connect to its page and start the thread that reads messages."""
        from urllib.request import urlopen

        note = Path(self._profile.name) / "DevToolsActivePort"
        deadline = time.monotonic() + PATIENCE_S
        while not (note.is_file() and len(note.read_text("utf-8").split()) == 2):
            if self._process.poll() is not None:
                raise RunError(f"the browser ended at once, with code {self._process.returncode}")
            if time.monotonic() > deadline:
                raise RunError(f"the browser did not start within {PATIENCE_S:g} s")
            time.sleep(0.05)
        port = note.read_text("utf-8").split()[0]
        with urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
            pages = [page for page in json.load(answer) if page["type"] == "page"]
        self._socket = connect(pages[0]["webSocketDebuggerUrl"], max_size=None, compression=None, proxy=None)
        threading.Thread(target=self._read, name="browser", daemon=True).start()
        self.call("Network.enable")
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=True, flatten=True)
        self.call("Page.enable")

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method of the Chrome DevTools protocol, such as "Page.navigate", and return its result.

        Raises:
            RunError: it was refused, or the browser is gone.
        """
        number = self._send(method, parameters)
        with self._arrived:
            self._arrived.wait_for(lambda: number in self._answers or self._gone, PATIENCE_S)
            message = self._answers.pop(number, None)
        if message is None:
            raise RunError(f"the browser does not answer {method}")
        if "error" in message:
            raise RunError(f"the browser refuses {method}: {message['error'].get('message')}")
        result: dict[str, object] = message["result"]
        return result

    def _send(self, method: str, parameters: Mapping[str, object], **more: str) -> int:
        """Send a command of the DevTools protocol, and return its number at once; a closed browser is ignored."""
        with self._arrived:
            self._number += 1
            number = self._number
        with suppress(OSError, EOFError, ConnectionClosed):
            self._socket.send(json.dumps({"id": number, "method": method, "params": parameters, **more}))
        return number

    def _read(self) -> None:
        """Handle the browser's messages until its connection ends; runs in a thread."""
        with suppress(OSError, EOFError, ConnectionClosed):
            for text in self._socket:
                message = json.loads(text)
                if "method" in message:
                    self._note(message["method"], message["params"])
                elif "sessionId" not in message:
                    with self._arrived:
                        self._answers[message["id"]] = message
                        self._arrived.notify_all()
        with self._arrived:
            self._gone = True
            self._arrived.notify_all()

    def _note(self, method: str, parameters: dict[str, Any]) -> None:
        """Record an address that the page requests; attach to a new worker before it starts."""
        if method == "Network.requestWillBeSent":
            self.requested.append(parameters["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requested.append(parameters["url"])
        elif method == "Target.attachedToTarget":
            # A worker, which waits to be watched.
            for wish in ("Network.enable", "Runtime.runIfWaitingForDebugger"):
                self._send(wish, {}, sessionId=parameters["sessionId"])

    def open(self, url: str) -> None:
        """Load an address in the headless browser's page."""
        self.call("Page.navigate", url=url)

    def evaluate(self, expression: str) -> Any:
        """Evaluate JavaScript in the page and return its value."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        return found["result"].get("value")

    def picture(self) -> bytes:
        """Return a screenshot of the page, as PNG."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
            except RunError as error:
                # For a moment after another page was opened there is none.
                if "active page" not in str(error) or time.monotonic() > deadline:
                    raise
                time.sleep(0.1)

    def click(self, x: float, y: float) -> None:
        """Click on the page with the left mouse button at a position [pixels] from its top left."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button: dict[str, object] = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)
            time.sleep(0.05)
