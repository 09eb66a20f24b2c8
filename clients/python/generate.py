"""Write what this package shares with qrsim: ``python clients/python/generate.py``, with qrsim installed.

The client and the frames are those of ``qrsim.links.reference`` with other imports. The messages are made of the
descriptor of qrsim.proto, without the check of versions that protoc puts into its code, so that every
protobuf from 3.20 on takes them; and in a pool of their own, so that qrsim and qrsim_client can be imported together.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCE, PACKAGE = HERE.parents[1] / "src" / "qrsim" / "links" / "reference", HERE / "qrsim_client"
NOTE = "# Written by generate.py from {}: change that.\n"
IMPORTS = {
    """import numpy as np

from qrsim.errors import UsageError
from qrsim.links.reference.claiming import SharedCalls, kind_of, numbers_of
from qrsim.links.reference.protocol import DecodeError
from qrsim.links.reference.protocol import qrsim_pb2 as pb
""": """import numpy as np
from google.protobuf.message import DecodeError

from qrsim_client import qrsim_pb2 as pb
from qrsim_client.claiming import SharedCalls, kind_of, numbers_of
from qrsim_client.errors import UsageError
""",
    "from qrsim.errors import": "from qrsim_client.errors import",
    "from qrsim.links.reference.protocol.framing import": "from qrsim_client.framing import",
    "from qrsim.links.reference.protocol.qrsim_pb2 import": "from qrsim_client.qrsim_pb2 import",
    "from qrsim.links.reference.replies import": "from qrsim_client.replies import",
    "from qrsim.links.reference.claiming import": "from qrsim_client.claiming import",
    "from qrsim.links.reference.protocol import qrsim_pb2 as pb": "from qrsim_client import qrsim_pb2 as pb",
}
MESSAGES = '''{note}"""The messages of the protocol."""

from google.protobuf import descriptor_pool
from google.protobuf.internal import builder

_pool = descriptor_pool.DescriptorPool()
_pool.AddSerializedFile(
{content}
)
DESCRIPTOR = _pool.FindFileByName("{name}")
builder.BuildMessageAndEnumDescriptors(DESCRIPTOR, globals())
builder.BuildTopDescriptorsAndMessages(DESCRIPTOR, "qrsim_client.qrsim_pb2", globals())
'''
WIDTH = 72


def copied(path: str) -> str:
    """Return a module of qrsim as one of this package."""
    text = (SOURCE / path).read_text("utf-8")
    for old, new in IMPORTS.items():
        text = text.replace(old, new)
    left = [line for line in text.splitlines() if line.startswith(("import qrsim", "from qrsim."))]
    if left:
        raise SystemExit(f"{path}: no place for {left}")
    return NOTE.format(f"src/qrsim/links/reference/{path}") + text


def messages() -> str:
    """Return the module of the messages."""
    descriptor = import_module("qrsim.links.reference.protocol.qrsim_pb2").DESCRIPTOR
    content = descriptor.serialized_pb
    lines = [f"    {content[at : at + WIDTH]!r}" for at in range(0, len(content), WIDTH)]
    note = NOTE.format("src/qrsim/links/reference/protocol/qrsim.proto")
    return MESSAGES.format(note=note, content="\n".join(lines), name=descriptor.name)


def generated() -> dict[Path, str]:
    """Return path -> text of all that is written."""
    return {
        PACKAGE / "client.py": copied("client.py"),
        PACKAGE / "claiming.py": copied("claiming.py"),
        PACKAGE / "replies.py": copied("replies.py"),
        PACKAGE / "framing.py": copied("protocol/framing.py"),
        PACKAGE / "qrsim_pb2.py": messages(),
        HERE.parent / "cpp" / "qrsim.proto": (SOURCE / "protocol" / "qrsim.proto").read_text("utf-8"),
    }


if __name__ == "__main__":
    for path, text in generated().items():
        path.write_text(text, "utf-8")
