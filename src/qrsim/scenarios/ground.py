"""Checks of the ground, and of who stands on it."""

from __future__ import annotations

from collections.abc import Iterator

from qrsim.models.vehicles.contracts import Vehicle


def standing_problems(name: str, kind: str, vehicle: Vehicle) -> Iterator[str]:
    """Yield why the vehicles of a fleet, of a kind, cannot be parked."""
    if "ground" in vehicle.reads:
        yield (
            f"fleets.{name}.ground: 'parked' is for vehicles without a contact of their own, and '{kind}' stands on "
            "the ground by itself; leave it out"
        )
    elif vehicle.handling() is None:
        yield (
            f"fleets.{name}.ground: 'parked' needs to know when the thrust exceeds the weight, which '{kind}' does not "
            "say (Vehicle.handling); allowed: stop"
        )
