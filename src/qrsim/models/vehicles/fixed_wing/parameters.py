"""Parameters of a fixed wing: mass, shape, aerodynamic coefficients, propeller and stabiliser.

The defaults are the Aerosonde of R. W. Beard and T. W. McLain, Small Unmanned Aircraft, 2012, with the propeller of its
supplement of 2018 and the numbers that were published with its code (mavsim, aerosonde_parameters.py). That code leaves
out the parasitic drag of the book's table E.2, which is here; ``preset: mavsim`` has it as the code.
"""

from __future__ import annotations

from typing import ClassVar, Literal

from jax import Array

from qrsim.core.presets import Presets
from qrsim.core.tree import derived, parameter, quantity, record, replace, setting
from qrsim.models.atmosphere.standard import SiteAir


def _coefficient(default: float, doc: str) -> Array:
    """Return the field declaration of an aerodynamic coefficient."""
    return parameter(default=default, unit="1", doc=doc)


@record
class Longitudinal:
    """Coefficients of lift, drag and pitching moment; angles in rad, rates times half the chord over the airspeed."""

    lift_0: Array = _coefficient(0.23, "lift at no angle of attack")
    lift_alpha: Array = parameter(
        default=5.61, unit="1", doc="lift slope by angle of attack, below the stall", above=0.0
    )
    lift_q: Array = _coefficient(7.95, "lift by pitch rate")
    lift_elevator: Array = _coefficient(0.13, "lift by elevator")
    drag_parasitic: Array = _coefficient(0.0437, "drag without lift")
    drag_q: Array = _coefficient(0.0, "drag by pitch rate")
    drag_elevator: Array = _coefficient(0.0135, "drag by elevator")
    moment_0: Array = _coefficient(0.0135, "pitching moment at no angle of attack")
    moment_alpha: Array = _coefficient(-2.74, "pitching moment by angle of attack")
    moment_q: Array = _coefficient(-38.21, "pitching moment by pitch rate")
    moment_elevator: Array = _coefficient(-0.99, "pitching moment by elevator")
    efficiency: Array = parameter(default=0.9, unit="1", doc="Oswald's factor of the induced drag", above=0.0)
    stall_angle: Array = parameter(
        default=0.47, unit="rad", doc="angle of attack about which the flow separates", above=0.0
    )
    stall_sharpness: Array = parameter(default=50.0, unit="1/rad", doc="sharpness of that separation", above=0.0)


@record
class Lateral:
    """Coefficients of side force, rolling and yawing moment; rates times half the span over the airspeed."""

    side_0: Array = _coefficient(0.0, "side force without sideslip")
    side_beta: Array = _coefficient(-0.98, "side force by sideslip")
    side_p: Array = _coefficient(0.0, "side force by roll rate")
    side_r: Array = _coefficient(0.0, "side force by yaw rate")
    side_aileron: Array = _coefficient(0.075, "side force by aileron")
    side_rudder: Array = _coefficient(0.19, "side force by rudder")
    roll_0: Array = _coefficient(0.0, "rolling moment without sideslip")
    roll_beta: Array = _coefficient(-0.13, "rolling moment by sideslip")
    roll_p: Array = _coefficient(-0.51, "rolling moment by roll rate")
    roll_r: Array = _coefficient(0.25, "rolling moment by yaw rate")
    roll_aileron: Array = _coefficient(0.17, "rolling moment by aileron")
    roll_rudder: Array = _coefficient(0.0024, "rolling moment by rudder")
    yaw_0: Array = _coefficient(0.0, "yawing moment without sideslip")
    yaw_beta: Array = _coefficient(0.073, "yawing moment by sideslip")
    yaw_p: Array = _coefficient(0.069, "yawing moment by roll rate")
    yaw_r: Array = _coefficient(-0.095, "yawing moment by yaw rate")
    yaw_aileron: Array = _coefficient(-0.011, "yawing moment by aileron")
    yaw_rudder: Array = _coefficient(-0.069, "yawing moment by rudder")


@record
class Propeller:
    """A propeller on an electric motor; coefficients over its advance ratio."""

    diameter: Array = parameter(default=0.508, unit="m", doc="diameter of the propeller", above=0.0)
    speed_constant: Array = parameter(
        default=145.0, unit="1", doc="speed constant of the motor, revolutions per minute per volt", above=0.0
    )
    resistance: Array = parameter(default=0.042, unit="Ohm", doc="resistance of the motor", above=0.0)
    idle_current: Array = parameter(default=1.5, unit="A", doc="current of the motor without load", minimum=0.0)
    voltage_max: Array = parameter(default=44.4, unit="V", doc="voltage at full throttle", above=0.0)
    torque_0: Array = _coefficient(0.00523, "torque at no advance")
    torque_1: Array = _coefficient(0.00497, "torque by advance ratio")
    torque_2: Array = _coefficient(-0.01664, "torque by its square")
    thrust_0: Array = parameter(default=0.09357, unit="1", doc="thrust at no advance", above=0.0)
    thrust_1: Array = _coefficient(-0.06044, "thrust by advance ratio")
    thrust_2: Array = _coefficient(-0.1079, "thrust by its square")


@record
class Gains:
    """The stabiliser; gains are of the cruise airspeed, and fall with the square of the airspeed."""

    roll_gain: Array = parameter(default=1.2, unit="1", doc="aileron per roll error")
    roll_rate_gain: Array = parameter(default=0.12, unit="s", doc="opposing aileron per roll rate")
    roll_integral_gain: Array = parameter(default=0.1, unit="1/s", doc="aileron per integrated roll error")
    roll_integral_limit: Array = parameter(
        default=0.1, unit="rad", doc="largest deflection by that integral", minimum=0.0
    )
    pitch_gain: Array = parameter(default=1.5, unit="1", doc="elevator per pitch error")
    pitch_rate_gain: Array = parameter(default=0.25, unit="s", doc="opposing elevator per pitch rate")
    pitch_integral_gain: Array = parameter(default=0.5, unit="1/s", doc="elevator per integrated pitch error")
    pitch_integral_limit: Array = parameter(
        default=0.15, unit="rad", doc="largest deflection by that integral", minimum=0.0
    )
    yaw_damping: Array = parameter(default=0.2, unit="s", doc="rudder per high-pass filtered yaw rate")
    washout: Array = parameter(default=1.0, unit="s", doc="time constant of that high-pass filter", above=0.0)


@record
class Aeroplane:
    """Numbers of an aeroplane; those of the Aerosonde by default."""

    mass: Array = parameter(default=11.0, unit="kg", doc="take-off mass", above=0.0)
    inertia_x: Array = parameter(default=0.8244, unit="kg m^2", doc="moment of inertia about the nose", above=0.0)
    inertia_y: Array = parameter(default=1.135, unit="kg m^2", doc="moment of inertia about the right wing", above=0.0)
    inertia_z: Array = parameter(default=1.759, unit="kg m^2", doc="moment of inertia about body down", above=0.0)
    inertia_xz: Array = parameter(default=0.1204, unit="kg m^2", doc="product of inertia of the nose and down axes")
    area: Array = parameter(default=0.55, unit="m^2", doc="of the wing", above=0.0)
    span: Array = parameter(default=2.8956, unit="m", doc="of the wing", above=0.0)
    chord: Array = parameter(default=0.18994, unit="m", doc="mean chord of the wing", above=0.0)
    density: Array = parameter(
        default=None,
        unit="kg/m^3",
        doc="density of the air; null: the standard atmosphere at the vehicle's height",
        above=0.0,
        nullable=True,
    )
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", above=0.0)
    cruise_airspeed: Array = parameter(
        default=25.0, unit="m/s", doc="trimmed airspeed, and airspeed of a start without a velocity", above=0.0
    )
    longitudinal: Longitudinal = quantity(default=Longitudinal(), doc="coefficients along the plane of symmetry")
    lateral: Lateral = quantity(default=Lateral(), doc="coefficients across it")
    propeller: Propeller = quantity(default=Propeller(), doc="propeller and motor")
    surface_lag: Array = parameter(
        default=0.05, unit="s", doc="time constant of the control surfaces; 0: none", minimum=0.0
    )
    surface_rate_max: Array = parameter(
        default=3.5, unit="rad/s", doc="largest rate of the control surfaces; 0: any", minimum=0.0
    )
    stabiliser: Gains = quantity(default=Gains(), doc="control of roll and pitch")
    downwash: Literal["felt", "at_centre", "ignored"] = setting(
        default="felt",
        doc="wakes of other vehicles; felt: averaged over the vehicle's extent; at_centre: at its "
        "centre, by the law of the first edition; ignored: none",
    )
    longest_substep: float = setting(
        default=0.01, unit="s", doc="longest step of the integration and of the stabiliser", above=0.0, maximum=0.05
    )
    preset: Literal["aerosonde", "mavsim"] = setting(
        default="aerosonde",
        doc="aeroplane that provides the parameters left out: the Aerosonde with parasitic drag, or as "
        "in the book's code",
    )
    site_air: SiteAir = derived(default=SiteAir(), doc="the atmosphere above the site")
    presets: ClassVar[Presets] = {
        "aerosonde": {},
        "mavsim": {"density": 1.2682, "longitudinal": {"drag_parasitic": 0.0}},
    }

    @property
    def air_density(self) -> Array:
        """Density of the air [kg/m^3]: the given one, or else the standard atmosphere's at the site."""
        return self.site_air.site_density if self.density is None else self.density

    def in_density(self, density: Array | None) -> Aeroplane:
        """Return the aeroplane in air of a density (n,) [kg/m^3]; unchanged for None or if its density is given."""
        return self if density is None or self.density is not None else replace(self, density=density)
