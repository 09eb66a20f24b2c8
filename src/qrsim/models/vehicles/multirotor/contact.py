"""Contact with the ground: springs with dampers at some points of the vehicle, and bristle friction.

P. Dahl, "A solid friction model", Aerospace Corp. TOR-0158(3107-18)-1, 1968: the bristles remember where they stuck, so
that a vehicle at rest stays where it is in wind, where regularised Coulomb friction would creep.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import parameter, quantity, record
from qrsim.core.vectors import Rotation, Vec3
from qrsim.models.vehicles.multirotor.geometry import Triple, cross_known, dot_known, known_cross
from qrsim.models.vehicles.multirotor.state import Brush, Ground, Motion

# Time in which the bristles of a point that is off the ground straighten [s].
STRAIGHTENING_S = 0.05
# A vehicle has landed when all feet have touched for this long [s] at less than this speed.
LANDED_S, LANDED_M_S = 0.5, 0.1
# A start with every foot this near to the ground [m] is one on the ground.
START_M = 0.01


@record
class Contact:
    """Parameters of the contact of feet, rotor hubs and top with the ground; a number, or one for each vehicle (n,)."""

    sink: Array = parameter(default=0.003, unit="m", doc="depth to which the feet sink under the weight", above=0.0)
    damping: Array = parameter(default=0.7, unit="1", doc="damping ratio of the bounce", minimum=0.0)
    friction: Array = parameter(default=0.6, unit="1", doc="friction coefficient", minimum=0.0)
    bristle: Array = parameter(default=0.005, unit="m", doc="displacement over which friction builds up", above=0.0)
    bristle_speed: Array = parameter(
        default=0.17, unit="m/s", doc="damping of the bristles: speed at which an undeflected bristle slides", above=0.0
    )


@record
class Touch:
    """Contact of vehicles (n,) with the ground."""

    force: Vec3 = quantity(unit="N", doc="in body axes")
    moment: Vec3 = quantity(unit="N m", doc="in body axes")
    brush: tuple[Brush, ...] = quantity(unit="1/s", doc="slope of the bristles of each point")
    impact_speed: Array = quantity(unit="m/s", doc="largest speed into the ground at a point that touches; else 0")
    bearing: Array = quantity(doc="bool: all feet bear")
    hub: Array = quantity(doc="bool: a rotor or the top touches")


def stiffness(contact: Contact, weight: Array, mass: Array, feet: int) -> tuple[Array, Array]:
    """Return spring [N/m] and damper [N s/m] of each contact point, by weight and number of feet (eq. V23)."""
    spring = weight / contact.sink / feet
    return spring, 2.0 * contact.damping * jnp.sqrt(feet * spring * mass) / feet


def plane_below(height: Array, normal: Vec3) -> Ground:
    """Return the ground as a plane ``height`` [m] below the vehicle (n,), with an upward unit normal (n,)."""
    # Northwards and eastwards along the plane; level ground has the axes themselves.
    length = jnp.sqrt(normal.x * normal.x + normal.z * normal.z)
    north = Vec3(-normal.z / length, jnp.zeros_like(length), normal.x / length)
    return Ground(height, normal, north, north.cross(normal))


def touch(
    contact: Contact,
    spring: Array,
    damper: Array,
    feet: Sequence[Triple],
    others: Sequence[Triple],
    motion: Motion,
    turned: Rotation,
    ground: Ground,
    quickest: float,
) -> Touch:
    """Return the contact forces of feet and other points with the ground (eqs. V23 and V24).

    Args:
        contact: parameters.
        spring, damper: of each point, see ``stiffness``.
        feet, others: contact points in body axes [m]; the others are rotor hubs and the top.
        motion: of n vehicles; ``brush`` has one part for each point.
        turned: attitude.
        ground: plane below.
        quickest: time in which bristles bend at the least [s], however fast a point slides: the longest substep, for
            which (V24) is too steep above bristle/quickest. The friction is full there in any case.
    """
    up, north, east = turned.to_body(ground.normal), turned.to_body(ground.north), turned.to_body(ground.east)
    height = ground.height + motion.displacement.dot(ground.normal)
    zero = jnp.zeros_like(height)
    force, moment, slopes = Vec3(zero, zero, zero), Vec3(zero, zero, zero), []
    impact, bearing, hub = zero, jnp.ones(zero.shape, bool), jnp.zeros(zero.shape, bool)
    for number, (point, brush) in enumerate(zip((*feet, *others), motion.brush, strict=True)):
        depth = -(height + dot_known(up, point))
        velocity = motion.velocity + Vec3(*cross_known(motion.rates, point))
        sinking = -velocity.dot(up)
        in_touch = depth > 0.0
        normal = jnp.where(in_touch, jnp.maximum(spring * depth + damper * sinking, 0.0), 0.0)
        bears = normal > 0.0
        sliding, slope = _friction(contact, brush, (velocity.dot(north), velocity.dot(east)), bears, quickest)
        slopes.append(slope)
        along = -contact.friction * normal
        push = up * normal + north * (along * sliding.north) + east * (along * sliding.east)
        force = force + push
        moment = moment + Vec3(*known_cross(point, push))
        impact = jnp.maximum(impact, jnp.where(in_touch, sinking, 0.0))
        if number < len(feet):
            bearing = bearing & bears
        else:
            hub = hub | in_touch
    return Touch(force, moment, tuple(slopes), impact, bearing, hub)


def _friction(
    contact: Contact, brush: Brush, slides: tuple[Array, Array], bears: Array, quickest: float
) -> tuple[Brush, Brush]:
    """Return a sliding point's friction, as a share of its limit, and its bristles' rate [1/s], each (north, east).

    The friction is a part of its largest, north and east, at most 1 together. ``bears``: the ground carries the point.
    """
    north, east = slides
    speed = jnp.sqrt(jnp.maximum(north * north + east * east, 1e-30))
    per_way = 1.0 / jnp.maximum(contact.bristle, speed * quickest)

    def slope(bent: Array, velocity: Array) -> Array:
        """Return a friction bristle's rate of deflection: it follows the sliding under load, else straightens."""
        stuck = (velocity - speed * bent) * per_way
        return jnp.where(bears, stuck, -bent / STRAIGHTENING_S)

    a = brush.north + north / contact.bristle_speed
    b = brush.east + east / contact.bristle_speed
    scale = 1.0 / jnp.maximum(jnp.sqrt(jnp.maximum(a * a + b * b, 1e-30)), 1.0)
    return Brush(a * scale, b * scale), Brush(slope(brush.north, north), slope(brush.east, east))
