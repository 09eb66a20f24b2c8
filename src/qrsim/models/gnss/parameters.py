"""Parameters of the sensor ``gnss`` (docs/howto/choose_a_receiver.md)."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.presets import Presets
from qrsim.core.tree import derived, parameter, record, setting
from qrsim.models.gnss.presets import PRESETS, default
from qrsim.models.gnss.sight import MASK_LOWEST


def _number(name: str, unit: str, doc: str, *, positive: bool = False, most: float | None = None) -> Array:
    """Return the field declaration of a receiver parameter, its default that of the default receiver preset."""
    least, above = (None, 0.0) if positive else (0.0, None)
    return parameter(default=default(name), unit=unit, doc=doc, minimum=least, maximum=most, above=above)


@record
class ReceiverParameters:
    """Parameters of n receivers of type ``gnss``, as the parts of their model use them."""

    preset: Literal["m8n", "f9p_single", "f9p_sbas", "f9p_rtk", "gps_2011"] = setting(
        default="f9p_single", doc="receiver that provides the parameters left out"
    )
    systems: str = setting(
        default=default("systems"),
        doc="letters of the satellite systems in use: G (GPS), E (Galileo), R (GLONASS), C (BeiDou)",
    )
    frequencies: Literal["single", "dual"] = setting(default=default("frequencies"), doc="frequencies in use")
    velocity: Literal["doppler", "differenced"] = setting(
        default=default("velocity"), doc="source of the velocity: Doppler shifts, or differenced positions"
    )
    corrections: Literal["none", "sbas", "dgps", "rtk"] = setting(
        default=default("corrections"),
        doc="corrections from satellites (sbas), or from a base station by code (dgps) or carrier phase (rtk)",
    )
    moving_base: str = setting(
        default=default("moving_base"), doc="vehicle of the fleet that serves as the base; empty: world.base_station"
    )
    first_fix: Literal["float", "fixed"] = setting(
        default=default("first_fix"), doc="state of the carrier phase at the start of a run"
    )
    nlos: Literal["track", "ignore"] = setting(
        default=default("nlos"), doc="reflections of satellites that obstacles hide: tracked, or ignored"
    )
    elevation_mask_rad: float = setting(
        default=default("elevation_mask_rad"),
        unit="rad",
        doc="satellites below this elevation are not used",
        minimum=MASK_LOWEST,
        maximum=math.pi / 2,
    )
    delay: int = setting(
        default=default("delay"), unit="periods", doc="age of a fix at its report", minimum=0, maximum=50
    )
    period: float = setting(
        default=default("period"), unit="s", doc="interval between fixes, a multiple of the sky's period", above=0.0
    )
    per_satellite: bool = setting(
        default=default("per_satellite"), doc="readings contain C/N0, state, number and direction of each satellite"
    )
    obstacle_period: float = setting(
        default=default("obstacle_period"),
        unit="s",
        doc="interval at which the view past obstacles is computed",
        above=0.0,
    )
    multipath: Array = _number("multipath", "1", "multipath relative to that of an airborne antenna")
    multipath_time: Array = _number("multipath_time", "s", "time constant of its faster half at rest", positive=True)
    multipath_slow_time: Array = _number(
        "multipath_slow_time", "s", "time constant of its slower half at rest", positive=True
    )
    multipath_length: Array = _number(
        "multipath_length", "m", "distance over which multipath decorrelates in flight", positive=True
    )
    cn0_zenith: Array = _number("cn0_zenith", "dB-Hz", "carrier to noise density of a satellite at the zenith")
    code_bandwidth: Array = _number("code_bandwidth", "Hz", "noise bandwidth of the code loop")
    correlator_spacing: Array = _number("correlator_spacing", "1", "early to late, in chips")
    doppler_noise: Array = _number("doppler_noise", "m/s", "std of each range rate at 45 dB-Hz")
    system_bias: Array = _number("system_bias", "m", "std of a system's residual offset after calibration")
    loop_time: Array = _number("loop_time", "s", "time constant of the first lag", positive=True)
    smoothing_time: Array = _number("smoothing_time", "s", "time constant of the second lag", positive=True)
    acquisition: Array = _number("acquisition", "s", "time until a satellite that has risen is used")
    entry: Array = _number("entry", "s", "time in which its weight grows to full", positive=True)
    # Longer ones would be ages that geometry.py takes for those of satellites that are not seen.
    reacquisition: Array = _number(
        "reacquisition", "s", "time until a satellite that was hidden or jammed is used again", most=500.0
    )
    reacquisition_long: Array = _number(
        "reacquisition_long", "s", "the same, after more than a minute without signal", most=500.0
    )
    coast: Array = _number("coast", "s", "time for which it extrapolates without enough satellites")
    float_time: Array = _number(
        "float_time", "s", "time constant of the second lag, without a fixed phase", positive=True
    )
    fix_time: Array = _number("fix_time", "s", "mean time to fix carrier phase with 16 satellites", positive=True)
    wrong_fixes: Array = _number("wrong_fixes", "1", "share of fixed carrier phases that are wrong", most=1.0)
    fixed_accuracy: Array = _number(
        "fixed_accuracy", "m", "error below which half of all fixed positions, and half of all heights, lie"
    )
    fixed_per_distance: Array = _number(
        "fixed_per_distance", "1", "increase of that error with the distance from the base"
    )
    base_vehicle: Any = derived(default=None, doc="(n,) bool: which vehicle is the moving base")
    spoofed: tuple[Array, ...] | None = derived(
        default=None, doc="for each spoofer of the world (n,) bool: which vehicles it is for"
    )
    presets: ClassVar[Presets] = PRESETS

    @property
    def takes_base(self) -> bool:
        """True if the receiver uses the corrections of a base station."""
        return self.corrections in ("dgps", "rtk")


def across(parameter: object) -> Array:
    """Return a parameter () unchanged, or (n,) as (1, n), to broadcast against arrays (slots, receivers)."""
    value = jnp.asarray(parameter)
    return value[None, :] if value.ndim else value


def column(receiver: ReceiverParameters) -> int:
    """Return the index of the receiver's ionosphere errors in tables: 0 for one frequency, 1 for two."""
    return 0 if receiver.frequencies == "single" else 1


def times(receiver: ReceiverParameters) -> tuple[Array, Array]:
    """Return the time constants [s] of the fast and the slow multipath of a receiver at rest."""
    return receiver.multipath_time, receiver.multipath_slow_time
