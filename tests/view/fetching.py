"""What fetches a page as a browser does, without one."""

from __future__ import annotations

import viser
from websockets.sync.client import ClientConnection, connect


def fetching(address: str) -> ClientConnection:
    """Connect as the script of a page does."""
    protocol = f"viser-v{viser.__version__}"
    return connect(address.replace("http", "ws"), subprotocols=[protocol], max_size=None, proxy=None)  # type: ignore[list-item]
