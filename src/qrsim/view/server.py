"""The web server of a page: at a free port, silent, of this machine alone unless another address is asked for."""

from __future__ import annotations

import json
import secrets
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from qrsim.core.arrays import Floats
from qrsim.errors import RunError, UsageError
from qrsim.extras import require
from qrsim.view.gate import Gate

if TYPE_CHECKING:
    from viser import ViserServer

LOOPBACK, PORT = "127.0.0.1", 8080


def require_viser() -> None:
    """Raise MissingExtraError with the install command if the packages of the 3-D page are missing."""
    require("view", "the 3-D page")


def start_server(port: int = PORT, label: str = "qrsim", host: str = LOOPBACK) -> ViserServer:
    """Start a server of 3-D pages on a free port from ``port`` on; beyond this machine its address has a token.

    Args:
        port: to listen on; 0: any that is free.
        label: heading of the page's panel.
        host: address of this machine to listen on.

    Raises:
        MissingExtraError: viser is not installed.
        UsageError: it is no port, or no address of this machine.
        RunError: no port is free.
    """
    require_viser()
    if not 0 <= port <= 65535:
        raise UsageError(f"--port {port}: expected 0 to 65535")
    import logging

    import rich
    from viser import ViserServer

    port = free_port(port, host)
    # viser announces itself on standard output, which belongs to the command.
    console = rich.get_console()
    console.quiet = True
    # Browsers open connections that they close without a word.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    gate = Gate("" if host == LOOPBACK else secrets.token_urlsafe(16))
    with gate.installed():
        server = ViserServer(host, port, label=label, verbose=False)
    _gates[server] = gate
    # Sharing would send the scene to a server elsewhere.
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    # Lights alone: reflections of a sky and shadows would cost a computer without graphics card most of its time.
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(enabled=True, cast_shadow=False)
    return server


_gates: weakref.WeakKeyDictionary[ViserServer, Gate] = weakref.WeakKeyDictionary()


class Delivery:
    """Counts dropped frames: a frame that a browser has not fetched is replaced by the next one.

    Attributes:
        missed: frames, over all browsers.
    """

    def __init__(self, server: ViserServer):
        # How far each browser is, viser says nowhere else.
        self._buffer = server._websock_server._broadcast_buffer
        self._last = self._buffer.message_counter - 1
        self.missed = 0
        self._gate = _gates[server]

    @property
    def lag_s(self) -> float:
        """Delay [s] of the slowest browser."""
        return self._gate.lag_s

    def sent(self) -> None:
        """Count a drawn frame as sent, and those that browsers have skipped as missed."""
        self.missed += sum(cursor < self._last for cursor in list(self._buffer.generator_cursors.values()))
        self._last = self._buffer.message_counter - 1


def free_port(port: int, host: str = LOOPBACK) -> int:
    """Return the first free TCP port from ``port`` on; 0 (any port) is returned unchanged."""
    import errno
    import socket

    for candidate in range(port, min(port + 100, 65536)):
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((host, candidate))
            except socket.gaierror:
                raise UsageError(f"{host}: expected an IPv4 address of this machine, such as 0.0.0.0 for all") from None
            except OSError as error:
                if error.errno in (errno.EADDRINUSE, errno.EACCES):
                    continue
                raise RunError(f"cannot listen on {host}:{candidate}: {error.strerror or error}") from None
            return candidate
    raise RunError(f"cannot listen on {host}: ports {port} to {min(port + 99, 65535)} are all in use")


def listen(server: ViserServer, wish: Callable[[Any], bytes | None]) -> None:
    """Set the function ``wish`` that answers each request of the page's script; it is called in a thread.

    What it returns is sent to that script.
    """
    _gates[server].wish = wish


def packed(head: dict[str, object], values: Floats | None = None) -> bytes:
    """Return bytes: the length of the JSON head in 4 bytes, the head, and values as float32."""
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    return len(text).to_bytes(4, "little") + text + (b"" if values is None else values.astype("<f4").tobytes())


def address(server: ViserServer) -> str:
    """Return the server's URL, with its access token if it has one."""
    token = _gates[server].token
    return f"http://{server.get_host()}:{server.get_port()}" + (f"/{token}" if token else "")
