"""What a page's server sends, cut into parts that a browser can show in any order, without the server.

A part begins with all that is on the page then (its key), and goes on with what changes. Nodes are numbered: the
message that makes one is written once, and parts refer to it.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import msgspec
from viser import ViserServer

Item = int | dict[str, Any]
ALIGNED = 8


class Packing:
    """JSON and the arrays beside it, as text for a page.

    The text is the base64 of what deflate made of: 8 bytes with the length of the JSON, the JSON, and the arrays, all
    aligned to 8 bytes.

    Attributes:
        arrays: those that are referred to, in order.
    """

    def __init__(self) -> None:
        self.arrays: list[memoryview] = []

    def message(self, message: Any) -> dict[str, Any]:
        """Return a viser message as content for JSON, its arrays stored and replaced by references."""
        found: dict[str, object] = self._referring(message.as_serializable_dict(self.arrays))
        return found

    def array(self, values: Any) -> dict[str, Any]:
        """Store an array as float32, and return a reference to it for JSON."""
        view = memoryview(values.astype("<f4").tobytes())
        self.arrays.append(view)
        return {"__binary_index": len(self.arrays) - 1, "dtype": "<f4"}

    def _referring(self, value: object) -> Any:
        """Return content for JSON, its bytes stored and replaced by references."""
        if isinstance(value, bytes | bytearray | memoryview):
            self.arrays.append(memoryview(value).cast("B"))
            return {"__binary_index": len(self.arrays) - 1, "dtype": "|u1"}
        if isinstance(value, dict):
            return {key: self._referring(item) for key, item in value.items()}
        return [self._referring(item) for item in value] if isinstance(value, list | tuple) else value

    def text(self, content: object) -> str:
        """Return content and the arrays that it refers to as one compressed base64 text."""
        head = msgspec.json.encode({"content": content, "lengths": [array.nbytes for array in self.arrays]})
        squeeze = zlib.compressobj(6)
        pieces = [squeeze.compress(len(head).to_bytes(ALIGNED, "little") + head + bytes(-len(head) % ALIGNED))]
        for array in self.arrays:
            pieces += [squeeze.compress(array), squeeze.compress(bytes(-array.nbytes % ALIGNED))]
        return base64.b64encode(b"".join([*pieces, squeeze.flush()])).decode("ascii")


class Tape:
    """Records the scene of a server.

    Attributes:
        frames: of the part that is being recorded: times [s] with what changed, the first with the key.
    """

    def __init__(self, server: ViserServer):
        # viser has no other way to learn what it sends.
        self._messages = server._websock_server
        self._numbers: dict[int, int] = {}
        self._made: list[object] = []
        self._nodes: list[dict[str, object]] = []
        self.frames: list[tuple[float, list[Item]]] = []
        self._packing, self._packing_of_nodes = Packing(), Packing()
        handles: Any = self._messages._record_handles
        handles.append(self)

    def _insert_message(self, message: Any) -> None:
        """Record a message that viser sends to browsers; viser's server calls this."""
        if self.frames and message.entity_type == "scene":
            self.frames[-1][1].append(self._item(message))

    def _item(self, message: Any) -> Item:
        """Return the number of the scene node that a message creates; for other messages the packed message."""
        if message.lifecycle_phase != "create":
            return self._packing.message(message)
        # It is kept, so that no other can have its identity; and written at once, for viser changes it later.
        if id(message) not in self._numbers:
            self._numbers[id(message)] = len(self._made)
            self._made.append(message)
            self._nodes.append(self._packing_of_nodes.message(message))
        return self._numbers[id(message)]

    def begin_part(self, time: float) -> None:
        """Begin a part of the exported page at a time [s], with messages for all that the page shows then."""
        buffer = self._messages._broadcast_buffer
        with buffer.buffer_lock:
            now = list(buffer.message_from_id.values())
        self._packing = Packing()
        shown = [message for message in now if message.entity_type == "scene" and message.lifecycle_phase != "remove"]
        self.frames = [(time, [self._item(message) for message in shown])]

    def begin_frame(self, time: float) -> None:
        """Begin a frame of the exported page at a time [s]; messages recorded from now on belong to it."""
        self.frames.append((time, []))

    def part(self, **beside: object) -> str:
        """Return the packed text of the present part of the exported page, with further arrays by name."""
        arrays = {name: self._packing.array(values) for name, values in beside.items()}
        return self._packing.text({"frames": self.frames, **arrays})

    def nodes(self) -> str:
        """Return the packed text of the messages that create scene nodes, in order of their numbers."""
        return self._packing_of_nodes.text(self._nodes)
