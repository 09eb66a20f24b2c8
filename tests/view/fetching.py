"""What fetches a page as a browser does, without one."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection


def fetching(address: str) -> ClientConnection:
    """Connect as the script of a page does."""
    import viser
    from websockets.sync.client import connect

    protocol = f"viser-v{viser.__version__}"
    return connect(address.replace("http", "ws"), subprotocols=[protocol], max_size=None, proxy=None)  # type: ignore[list-item]
