"""A client of ``qrsim serve`` that needs NumPy and protobuf only; ``Client`` has the calls."""

from qrsim_client.client import (
    Axis,
    Claim,
    Client,
    ConnectionFailed,
    Episode,
    Heard,
    InvalidState,
    Outcome,
    Refused,
    Sensed,
    SensedVehicle,
    Session,
    State,
    Status,
    VehicleStatus,
)
from qrsim_client.errors import QrsimError, RunError, UsageError

__version__ = "0.1.0"
__all__ = [
    "Axis",
    "Claim",
    "Client",
    "ConnectionFailed",
    "Episode",
    "Heard",
    "InvalidState",
    "Outcome",
    "QrsimError",
    "Refused",
    "RunError",
    "Sensed",
    "SensedVehicle",
    "Session",
    "State",
    "Status",
    "UsageError",
    "VehicleStatus",
]
