"""The parameters of a multirotor."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import derived, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.standard import SiteAir
from qrsim.models.vehicles.multirotor.contact import Contact
from qrsim.models.vehicles.multirotor.geometry import Rotor, Triple
from qrsim.models.vehicles.multirotor.stabiliser import Stabiliser

_X500 = (
    Rotor((0.174, 0.174, -0.06), -1),
    Rotor((-0.174, 0.174, -0.06), 1),
    Rotor((-0.174, -0.174, -0.06), -1),
    Rotor((0.174, -0.174, -0.06), 1),
)
_X500_FEET = ((0.15, 0.15, 0.2), (-0.15, 0.15, 0.2), (-0.15, -0.15, 0.2), (0.15, -0.15, 0.2))


@record
class Airframe:
    """Mass, rotors, body, electrics and loops of a multirotor; by default the X500 of PX4's Gazebo models.

    A number is one for all, or one per vehicle (n,). Where rotors and contact points are is part of the program.
    """

    mass: Array = parameter(default=2.0643, unit="kg", doc="take-off mass", above=0.0)
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", above=0.0)
    inertia_x: Array = parameter(default=0.02166667, unit="kg m^2", doc="moment of inertia, roll", above=0.0)
    inertia_y: Array = parameter(default=0.02166667, unit="kg m^2", doc="moment of inertia, pitch", above=0.0)
    inertia_z: Array = parameter(default=0.04, unit="kg m^2", doc="moment of inertia, yaw", above=0.0)
    thrust_coefficient: Array = parameter(
        default=8.54858e-6, unit="N s^2", doc="thrust of a rotor divided by its speed squared (k_T)", above=0.0
    )
    torque_ratio: Array = parameter(
        default=0.016, unit="m", doc="reaction torque of a rotor divided by its thrust (k_Q/k_T)", above=0.0
    )
    speed_max: Array = parameter(
        default=1000.0, unit="rad/s", doc="largest rotor speed at the nominal voltage", above=0.0
    )
    spin_up: Array = parameter(default=0.0125, unit="s", doc="time constant of a rotor that speeds up", above=0.0)
    spin_down: Array = parameter(default=0.025, unit="s", doc="time constant of a rotor that slows down", above=0.0)
    rotor_radius: Array = parameter(default=0.128, unit="m", doc="radius of a rotor", above=0.0)
    rotor_inertia: Array = parameter(
        default=0.0, unit="kg m^2", doc="moment of inertia of a rotor about its axis", minimum=0.0
    )
    rotor_drag: Array = parameter(
        default=8.06428e-5,
        unit="N s^2/m",
        doc="in-plane drag of a rotor divided by its speed and airspeed (k_d)",
        minimum=0.0,
    )
    inflow_loss: Array = parameter(
        default=0.0,
        unit="N s^2/m",
        doc="loss of thrust of a rotor divided by its speed and the inflow (k_z)",
        minimum=0.0,
    )
    translational_lift: Array = parameter(
        default=0.0,
        unit="N s^2/m^2",
        doc="gain of thrust of a rotor divided by its airspeed squared (k_h)",
        minimum=0.0,
    )
    flapping: Array = parameter(
        default=0.0,
        unit="N s^2",
        doc="flapping moment of a rotor divided by its speed and airspeed (k_flap)",
        minimum=0.0,
    )
    drag_x: Array = parameter(default=0.02, unit="N s^2/m^2", doc="drag of the body, forward", minimum=0.0)
    drag_y: Array = parameter(default=0.02, unit="N s^2/m^2", doc="drag of the body, sideways", minimum=0.0)
    drag_z: Array = parameter(default=0.03, unit="N s^2/m^2", doc="drag of the body, vertical", minimum=0.0)
    air_density: Array = parameter(
        default=1.225, unit="kg/m^3", doc="density of the air at which the coefficients hold", above=0.0
    )
    throttle_curve: Array = parameter(
        default=1.0,
        unit="1",
        doc="coefficient a of thrust/largest thrust = a u^2 + (1 - a) u at throttle u",
        minimum=0.0,
        maximum=1.0,
    )
    nominal_voltage: Array = parameter(
        default=14.8, unit="V", doc="battery voltage below which the largest rotor speed falls in proportion", above=0.0
    )
    efficiency: Array = parameter(
        default=0.75,
        unit="1",
        doc="power at the rotors' shafts divided by power from the battery",
        above=0.0,
        maximum=1.0,
    )
    avionics_power: Array = parameter(default=5.0, unit="W", doc="power of all but the motors", minimum=0.0)
    process_noise: Array = parameter(
        default=0.0, unit="m/s^2, rad/s^2", doc="std of the six white accelerations at a step of 0.02 s", minimum=0.0
    )
    crash_speed: Array = parameter(
        default=3.0, unit="m/s", doc="speed of impact above which the vehicle crashes", above=0.0
    )
    stabiliser: Stabiliser = quantity(default=Stabiliser(), doc="the autopilot's inner loops")
    contact: Contact = quantity(default=Contact(), doc="how the vehicle meets the ground")
    rotors: tuple[Rotor, ...] = setting(default=_X500, doc="position [m], direction and axis of each rotor")
    feet: tuple[Triple, ...] = setting(default=_X500_FEET, doc="contact points that support the vehicle, body axes [m]")
    top: Triple = setting(
        default=(0.0, 0.0, -0.1), doc="highest point, which touches the ground when the vehicle lies on its back [m]"
    )
    longest_substep: float = setting(
        default=0.004, unit="s", doc="longest substep; a time step is divided into equal substeps", above=0.0
    )
    downwash: Literal["felt", "at_centre", "ignored"] = setting(
        default="felt",
        doc="wakes of other vehicles; felt: averaged over the vehicle's extent; at_centre: at its "
        "centre, by the law of the first edition; ignored: none",
    )
    thin_air: Literal["felt", "ignored"] = setting(
        default="felt", doc="forces follow the density of the air, or are those at air_density everywhere"
    )
    on_failure: Literal["none", "reallocate"] = setting(
        default="none", doc="response of the stabiliser 0.1 s after a rotor has failed"
    )
    crash: Literal["stop", "none"] = setting(
        default="stop",
        doc="rotors that touch the ground, or an impact above crash_speed, end the flight, or have no further effect",
    )

    site_air: SiteAir = derived(default=SiteAir(), doc="the atmosphere above the site")

    @property
    def inertia(self) -> Vec3:
        """Moments of inertia about the body axes [kg m^2]."""
        return Vec3(self.inertia_x, self.inertia_y, self.inertia_z)

    @property
    def drag(self) -> Vec3:
        """Coefficients of the body's quadratic drag along its axes [N s^2/m^2]."""
        return Vec3(self.drag_x, self.drag_y, self.drag_z)

    @property
    def others(self) -> tuple[Triple, ...]:
        """Contact points other than the feet, in body axes [m]: the rotor hubs and the top."""
        return (*(rotor.position for rotor in self.rotors), self.top)

    @property
    def lift_share(self) -> float:
        """Collective thrust over one rotor's thrust, with all rotors at one speed."""
        return -sum(rotor.axis[2] for rotor in self.rotors)

    @property
    def thrust_max(self) -> Array:
        """Largest collective thrust [N], at nominal voltage and air density."""
        return self.thrust_coefficient * (self.speed_max * self.speed_max * self.lift_share)

    def thrust_of(self, throttle: Array) -> Array:
        """Return the collective thrust [N] at a throttle (n,), 0 to 1, at the nominal air density (eq. V31)."""
        a = self.throttle_curve
        return self.thrust_max * throttle * (a * throttle + (1.0 - a))

    def throttle_of(self, thrust: Array) -> Array:
        """Return the throttle, 0 to 1, for a collective thrust [N] at the nominal air density."""
        a, share = self.throttle_curve, thrust / self.thrust_max
        return 2.0 * share / ((1.0 - a) + jnp.sqrt((1.0 - a) * (1.0 - a) + 4.0 * a * share))

    @property
    def site_share(self) -> Array | float:
        """Air density at the site over the nominal one, for which the coefficients hold."""
        return 1.0 if self.thin_air == "ignored" else self.site_air.site_density / self.air_density

    def share(self, position_ned: Vec3) -> Array | float:
        """Return the air density at positions (n,) [m] over the nominal one, for which the coefficients hold."""
        return 1.0 if self.thin_air == "ignored" else self.site_air.density(position_ned) / self.air_density

    def in_density(self, share: Array | float) -> Airframe:
        """Return the vehicle with all air forces scaled by ``share``, a relative air density (n,) (eq. S30)."""
        if self.thin_air == "ignored":
            return self
        names = (
            "thrust_coefficient",
            "rotor_drag",
            "inflow_loss",
            "translational_lift",
            "flapping",
            "drag_x",
            "drag_y",
            "drag_z",
            "air_density",
        )
        return replace(self, **{name: getattr(self, name) * share for name in names})
