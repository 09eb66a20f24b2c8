"""The TCP protocol: messages (qrsim.proto and what is generated from it) and how they are framed.

Both the server and the client import this. ``make proto`` generates qrsim_pb2.py and qrsim_pb2.pyi anew.
"""

from qrsim.extras import require

require("serve", "the TCP protocol")

from google.protobuf.message import DecodeError  # noqa: E402 (the line above says it better where it is missing)

__all__ = ["DecodeError"]
