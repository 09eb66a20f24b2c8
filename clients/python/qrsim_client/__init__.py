"""A client of ``qrsim serve`` that needs NumPy and protobuf only; ``Client`` has the calls."""

from qrsim_client.client import (
    Axis,
    Client,
    ConnectionFailed,
    Episode,
    InvalidState,
    Outcome,
    Refused,
    Session,
    State,
)
from qrsim_client.errors import QrsimError, RunError, UsageError

__version__ = "0.1.0"
__all__ = [
    "Axis",
    "Client",
    "ConnectionFailed",
    "Episode",
    "InvalidState",
    "Outcome",
    "QrsimError",
    "Refused",
    "RunError",
    "Session",
    "State",
    "UsageError",
]
