"""Which stack flies or drives which vehicle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from qrsim.links.mavlink.stack.codes import FIXED_WING, GROUND_ROVER
from qrsim.links.mavlink.stack.contracts import Facts, FlavourName, LocalOrigin, Stack
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.rover_stack import RoverStack
from qrsim.links.mavlink.stack.wing_stack import WingStack
from qrsim.models.site import Site

_KINDS: dict[int, type[FlightStack]] = {GROUND_ROVER: RoverStack, FIXED_WING: WingStack}


def stack_of(flavour: FlavourName = "px4", local_origin: LocalOrigin = "start") -> Callable[[Facts, Site], Stack]:
    """Return a function that builds a vehicle's simulated flight stack, PX4's or ArduPilot's (``flavour``), from facts
    and site."""

    def make(facts: Facts, site: Site) -> Stack:
        """Build the flight stack (multirotor, fixed wing, rover) for the MAV_TYPE in ``facts``."""
        own = replace(facts, local_origin=local_origin)
        return _KINDS.get(facts.mav_type, FlightStack)(own, site, flavour=flavour)

    return make
