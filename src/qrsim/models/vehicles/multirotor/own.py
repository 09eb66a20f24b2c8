"""A multirotor of one's own from six numbers that its builder knows, by rules of thumb with stated ranges.

docs/explanation/models/multirotor.md lists the rules, with the range of vehicles with published parameters (sets.py).
Whatever is known better replaces what is derived here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from qrsim.errors import UsageError, did_you_mean, warn_user
from qrsim.models.vehicles.multirotor.geometry import Rotor, ring, square_feet
from qrsim.models.vehicles.multirotor.motor_table import MOST_EFFICIENT, MotorTable
from qrsim.models.vehicles.multirotor.stabiliser import Stabiliser
from qrsim.models.vehicles.multirotor.vehicle import Multirotor

AIR_DENSITY, GRAVITY = 1.225, 9.81
# Radius over the distance between neighbours, so that propellers just clear each other; and at most over the arm.
OF_SPACING, OF_ARM = 0.45, 0.6
# Thrust coefficient T/(rho A (W R)^2) of two-bladed propellers: 0.009 to 0.015; of large slow ones down to 0.006.
THRUST_COEFFICIENT = 0.0125
# Ideal power of hover over that of the shafts, from which torque follows.
FIGURE_OF_MERIT = 0.65
# Power of the shaft over that from the battery: motor and its controller.
EFFICIENCY = 0.8
# Moment of inertia over mass times arm squared: roll and pitch 0.17 to 0.25, yaw 1.8 to 2 times as much.
INERTIA, INERTIA_YAW = 0.23, 0.43
# Time constant of a rotor that speeds up [s/m of radius], and the shortest [s]; it slows down half as fast.
SPIN_UP_PER_M, SPIN_UP_LEAST = 0.12, 0.012
# Deceleration for each m/s of airspeed by drag of the rotors [1/s].
ROTOR_DRAG = 0.3
# Share of the textbook's loss of thrust to axial inflow.
INFLOW = 0.5
# Drag coefficient of a body of half an arm across, twice as large from above.
BODY_DRAG = 0.6
# The stabiliser's rate loop is three times as fast as that of the angles, and as fast as the rotors allow at most.
RATE_OVER_ATTITUDE, RATE_TIMES_SPIN_UP = 3.0, 0.45
# Thrust of two rotors on one axis over that of two apart: the lower one works in the wake of the upper one.
COAXIAL = 0.9
# Number -> unit, least and largest of what is sensible.
RANGES: dict[str, tuple[str, float, float]] = {
    "mass": ("kg", 0.01, 100.0),
    "arm": ("m", 0.02, 3.0),
    "hover_throttle": ("", 0.1, 0.95),
    "thrust_to_weight": ("", 1.2, 20.0),
    "attitude_bandwidth": ("rad/s", 1.0, 40.0),
}
# Parameters from which others are derived.
SOURCES = ("spin_up", "rotor_radius", "thrust_coefficient", "speed_max")
# In place of two of the six.
TABLE, OF_TABLE = "motor_table", ("hover_throttle", "thrust_to_weight")
SIX = ("mass", "arm", "rotors", "hover_throttle", "thrust_to_weight", "attitude_bandwidth")


@dataclass(frozen=True)
class Geometry:
    """A usual arrangement of rotors.

    Attributes:
        arms: number of arms.
        first_deg: angle of the first one from the nose, clockwise from above.
        coaxial: two rotors on each arm.
    """

    arms: int
    first_deg: float
    coaxial: bool = False

    @property
    def count(self) -> int:
        """Number of rotors of the arrangement."""
        return self.arms * (2 if self.coaxial else 1)


GEOMETRIES = {
    "quad_x": Geometry(4, 45.0),
    "quad_plus": Geometry(4, 0.0),
    "hexa_x": Geometry(6, 30.0),
    "hexa_plus": Geometry(6, 0.0),
    "octo_x": Geometry(8, 22.5),
    "coaxial_x8": Geometry(4, 45.0, coaxial=True),
}
# Where only the number of rotors is said.
USUAL = {4: "quad_x", 6: "hexa_x", 8: "octo_x"}


def rotors_of(geometry: str, arm: float, height: float = 0.0) -> tuple[Rotor, ...]:
    """Return the rotors of a named arrangement with arms [m], clockwise from the nose; neighbours spin opposite ways.

    Args:
        geometry: one of GEOMETRIES.
        arm: distance of each hub from the middle [m].
        height: of the hubs over the centre of mass [m].

    Raises:
        UsageError: no arrangement is called so.
    """
    kind = _arrangement(geometry)
    # The first one, right of the nose, turns counterclockwise: as the front right one of common autopilots.
    upper = ring(kind.arms, arm, math.radians(kind.first_deg), direction=-1, down=-height)
    if not kind.coaxial:
        return upper
    below = 0.2 * arm
    lower = ring(kind.arms, arm, math.radians(kind.first_deg), direction=1, down=below - height)
    return (*upper, *lower)


def own_parameters(
    mass: float,
    arm: float,
    rotors: int,
    hover_throttle: float,
    thrust_to_weight: float,
    attitude_bandwidth: float,
    geometry: str | None = None,
    known: Mapping[str, object] | None = None,
    curve: float | None = None,
) -> dict[str, Any]:
    """Return a multirotor's parameters by name, derived by the rules of docs/explanation/models/multirotor.md.

    Args:
        mass: take-off mass [kg].
        arm: distance of the rotors' hubs from the middle [m].
        rotors: how many.
        hover_throttle: throttle at which it hovers, 0 to 1.
        thrust_to_weight: largest thrust over weight.
        attitude_bandwidth: 1 over the time in which it reaches 63 % of a step of roll [rad/s].
        geometry: one of GEOMETRIES; None: the usual one of the number of rotors.
        known: parameters from which others are derived: ``spin_up``, ``rotor_radius``, ``thrust_coefficient`` and
            ``speed_max``.
        curve: of the throttle, where it is known; None: derived.

    Raises:
        UsageError: a number out of its range, or numbers that contradict each other.
    """
    given = {
        "mass": mass,
        "arm": arm,
        "hover_throttle": hover_throttle,
        "thrust_to_weight": thrust_to_weight,
        "attitude_bandwidth": attitude_bandwidth,
    }
    _check(given)
    kind = _geometry(rotors, geometry)
    known = known_numbers(known or {})
    weight, radius = mass * GRAVITY, known.get("rotor_radius", _radius(arm, kind.arms))
    pairs = COAXIAL if kind.coaxial else 1.0
    most = thrust_to_weight * weight / rotors
    # The larger coefficient is that of a propeller alone.
    thrust = known.get("thrust_coefficient", THRUST_COEFFICIENT * AIR_DENSITY * math.pi * radius**4 * pairs)
    if "speed_max" in known and "thrust_coefficient" not in known:
        thrust = most / known["speed_max"] ** 2
    fastest = known.get("speed_max", math.sqrt(most / thrust))
    _check_thrust(thrust_to_weight, rotors * thrust * fastest**2 / weight)
    hovering = math.sqrt(weight / (rotors * thrust))
    induced = math.sqrt(weight / (2.0 * AIR_DENSITY * rotors * math.pi * radius**2))
    spin_up = known.get("spin_up", max(SPIN_UP_LEAST, SPIN_UP_PER_M * radius))
    _check_bandwidth(attitude_bandwidth, spin_up)
    # Of T/(rho A (W R)^2), with what two rotors on one axis lose made good; C_Q = C_T^1.5/(sqrt(2) FM).
    loading = thrust / (pairs * AIR_DENSITY * math.pi * radius**4)
    drag = 0.5 * AIR_DENSITY * BODY_DRAG * arm**2
    gains: dict[str, Any] = {"attitude_gain": attitude_bandwidth, "rate_gain": RATE_OVER_ATTITUDE * attitude_bandwidth}
    return {
        "mass": mass,
        "inertia_x": INERTIA * mass * arm**2,
        "inertia_y": INERTIA * mass * arm**2,
        "inertia_z": INERTIA_YAW * mass * arm**2,
        "thrust_coefficient": thrust,
        "torque_ratio": radius * math.sqrt(0.5 * loading) / FIGURE_OF_MERIT / pairs,
        "efficiency": EFFICIENCY,
        "speed_max": fastest,
        "spin_up": spin_up,
        "spin_down": 2.0 * spin_up,
        "rotor_radius": radius,
        "rotor_inertia": 0.0,
        "rotor_drag": ROTOR_DRAG * mass / (rotors * hovering),
        "inflow_loss": INFLOW * weight / (2.0 * rotors * induced * hovering),
        "translational_lift": 0.0,
        "drag_x": drag,
        "drag_y": drag,
        "drag_z": 2.0 * drag,
        "throttle_curve": _curve(hover_throttle, thrust_to_weight) if curve is None else curve,
        "stabiliser": Stabiliser(**gains),
        "rotors": rotors_of(geometry or USUAL[rotors], arm),
        "feet": square_feet(0.5 * arm, 0.3 * arm + 0.02),
        "top": (0.0, 0.0, -0.3 * arm - (0.2 * arm if kind.coaxial else 0.0)),
    }


def own_multirotor(
    *,
    mass: float,
    arm: float,
    rotors: int,
    attitude_bandwidth: float,
    hover_throttle: float | None = None,
    thrust_to_weight: float | None = None,
    motor_table: Mapping[str, object] | None = None,
    geometry: str | None = None,
    warn: Callable[[str], None] = warn_user,
    **parameters: object,
) -> Multirotor:
    """Return a multirotor derived from six numbers, or from four and a motor table, for ``make_scenario``.

    Args:
        mass: take-off mass [kg].
        arm: distance of the rotors' hubs from the middle [m].
        rotors: number of rotors.
        attitude_bandwidth: 1 over the time in which it reaches 63 % of a step of roll [rad/s].
        hover_throttle: throttle at which it hovers, 0 to 1; None with a motor table.
        thrust_to_weight: largest thrust over weight; None with a motor table.
        geometry: name of the rotors' arrangement; None: the usual one of the number of rotors.
        motor_table: columns of one motor with its propeller by name (``motor_table.py``), or ``{"file": PATH}`` of a
            CSV file with them, in place of hover throttle and thrust to weight; it also gives the electrical power.
        warn: called with a sentence for each thing in the table that is not plausible.
        parameters: fields of ``Multirotor`` that are known better than by a rule.

    Raises:
        UsageError: a number out of its range, numbers that contradict each other, or an unknown parameter.

    Examples:
        >>> vehicle = qrsim.own_multirotor(mass=1.2, arm=0.225, rotors=4, hover_throttle=0.5, thrust_to_weight=2.2,
        ...                                attitude_bandwidth=8.0)
    """
    table: dict[str, float] = {}
    if motor_table is not None:
        _check({"mass": mass})
        kind = _geometry(rotors, geometry)
        try:
            columns = MotorTable.of(motor_table)
            table = columns.numbers(mass * GRAVITY, kind.count)
            if (ratio := table["thrust_to_weight"]) > RANGES["thrust_to_weight"][2]:
                raise UsageError(
                    f"{kind.count} motors lift {ratio:.4g} times the weight; allowed: at most "
                    f"{RANGES['thrust_to_weight'][2]:g} (thrust_N is in newtons, thrust_g in grams)"
                )
        except UsageError as error:
            raise UsageError(f"{TABLE}: {error}") from None
        hover_throttle, thrust_to_weight = table["hover_throttle"], table["thrust_to_weight"]
    if hover_throttle is None or thrust_to_weight is None:
        raise UsageError(f"own_multirotor: give hover_throttle and thrust_to_weight, or {TABLE}")
    of_table = {name: table[name] for name in ("thrust_coefficient", "speed_max") if table}
    derived = own_parameters(
        mass,
        arm,
        rotors,
        hover_throttle,
        thrust_to_weight,
        attitude_bandwidth,
        geometry,
        of_table | parameters,
        curve=table.get("throttle_curve"),
    )
    if table:
        derived |= _powered(derived, table)
        for words in columns.oddities(float(derived["rotor_radius"])):
            warn(f"{TABLE}: {words}")
    for name in parameters:
        if name not in Multirotor.__dataclass_fields__:
            known = list(Multirotor.__dataclass_fields__)
            raise UsageError(f"own_multirotor: no such parameter '{name}'{did_you_mean(name, known)}")
    return Multirotor(**(derived | parameters))


def _powered(derived: Mapping[str, Any], table: Mapping[str, float]) -> dict[str, float]:
    """Return {efficiency, torque_ratio} with which a motor draws the power of its table in hover."""
    shaft = derived["torque_ratio"] * derived["thrust_coefficient"] * table["hover_speed"] ** 3
    efficiency = min(shaft / table["hover_power"], MOST_EFFICIENT)
    return {
        "efficiency": efficiency,
        "torque_ratio": derived["torque_ratio"] * efficiency * table["hover_power"] / shaft,
    }


def known_numbers(parameters: Mapping[str, object]) -> dict[str, float]:
    """Return the user's parameters that are positive numbers and from which others are derived, by name."""
    found = {name: parameters[name] for name in SOURCES if name in parameters}
    return {
        name: float(value)
        for name, value in found.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0
    }


def _check_thrust(declared: float, found: float) -> None:
    """Raise UsageError if the declared thrust-to-weight ratio differs from ``found``, that of the parameters."""
    # Numbers are given to two digits.
    if abs(found - declared) > 0.02 * declared:
        raise UsageError(
            f"thrust_to_weight: {declared:g}; thrust_coefficient and speed_max give {found:.4g}; leave out one of the "
            "three"
        )


def _check(given: dict[str, float]) -> None:
    """Raise UsageError for a number in ``given`` {name: value} that is out of its range."""
    for name, value in given.items():
        unit, low, high = RANGES[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            shown = f"{value:g} {unit}".strip() if isinstance(value, int | float) else repr(value)
            raise UsageError(f"{name}: {shown}; allowed: {low:g} to {high:g}{f' {unit}' if unit else ''}")


def _arrangement(name: object) -> Geometry:
    """Return the arrangement of rotors with a name, such as "quad_x"; raise UsageError for other names."""
    if not isinstance(name, str) or name not in GEOMETRIES:
        raise UsageError(f"geometry: no arrangement is called '{name}'{did_you_mean(str(name), GEOMETRIES)}")
    return GEOMETRIES[name]


def _geometry(rotors: int, geometry: str | None) -> Geometry:
    """Return the arrangement of ``rotors`` rotors named ``geometry``, or the usual one for None."""
    if isinstance(rotors, bool) or not isinstance(rotors, int) or rotors < 3:
        raise UsageError(f"rotors: {rotors!r}; a multirotor needs 4, 6 or 8, or a geometry")
    if geometry is None:
        if rotors not in USUAL:
            raise UsageError(f"rotors: {rotors}; allowed: {', '.join(map(str, USUAL))}")
        geometry = USUAL[rotors]
    kind = _arrangement(geometry)
    if kind.count != rotors:
        raise UsageError(f"rotors: {rotors}; '{geometry}' has {kind.count}")
    return kind


def _radius(arm: float, arms: int) -> float:
    """Return the usual rotor radius [m] for ``arms`` arms of length ``arm`` [m]."""
    spacing = 2.0 * arm * math.sin(math.pi / arms)
    return min(OF_SPACING * spacing, OF_ARM * arm)


def _curve(hover: float, ratio: float) -> float:
    """Return a of thrust/largest = a u^2 + (1 - a) u, from hover throttle and thrust-to-weight; raise UsageError."""
    low, high = 1.0 / ratio, 1.0 / math.sqrt(ratio)
    # Numbers are given to two digits.
    if not low - 0.005 <= hover <= high + 0.005:
        raise UsageError(
            f"hover_throttle: {hover:g}; with thrust_to_weight {ratio:g} a vehicle hovers at {low:.3g} (thrust in "
            f"proportion to the throttle) to {high:.3g} (to its square)"
        )
    return min(1.0, max(0.0, (hover - low) / (hover - hover * hover)))


def _check_bandwidth(attitude: float, spin_up: float) -> None:
    """Raise UsageError if the attitude loop [rad/s] is too fast for the rotors' time constant ``spin_up`` [s]."""
    fastest = RATE_TIMES_SPIN_UP / (RATE_OVER_ATTITUDE * spin_up)
    if attitude > 1.02 * fastest:
        raise UsageError(
            f"attitude_bandwidth: {attitude:g} rad/s; rotors of a time constant of {spin_up:.3g} s allow {fastest:.3g} "
            "rad/s at most; give spin_up if yours are faster"
        )
