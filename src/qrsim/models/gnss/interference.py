"""Interference with receivers: jammers, discs without satellites, spoofers, outages, ionospheric storms.

See docs/howto/jam_and_spoof.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import map_tree, parameter, quantity, record, replace
from qrsim.core.tree import setting as choice
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.schedule import is_on, since
from qrsim.models.gnss.sight import CommonErrors
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.scene.contracts import Ground

# Power of a satellite's signal at the ground [dBW], frequency of L1 [Hz], rate of the C/A code [1/s].
_SIGNAL_DBW, _L1_HZ, _CODE_HZ = -157.0, 1575.42e6, 1.023e6
_LIGHT = 299792458.0
# How little of a jammer's power goes against the code, 1/(R_c int S_j S_s df) of both spectra: white noise over the
# main lobe of the code's spectrum, which has 0.903 of its power, and a tone in the middle of it.
QUALITY = {"wide": 2.0 / 0.903, "narrow": 1.0}
# Gain of an antenna that looks up towards what is below it, and what is left of a jammer that is hidden, in power.
_FROM_BELOW, _HIDDEN = 10.0**-0.5, 10.0**-2.0
# Losses of satellites count from 45 dB-Hz on, as in geometry.py.
_STRONG = 10.0**4.5
# Above every limit of what can be tracked.
BLIND = 1e9
# A storm of the ionosphere grows and fades over so long [s].
_RAMP_S = 60.0
# Of a jammer that is nearer than this [m], the power does not grow.
_NEAREST = 1.0


def _start() -> Array:
    """Return the field declaration of the parameter ``start`` [s] of an interference source."""
    return parameter(default=0.0, unit="s", doc="start of the interference", minimum=0.0)


def _end() -> Array:
    """Return the field declaration of the parameter ``end`` [s] of an interference source, None for never."""
    return parameter(
        default=None, unit="s", doc="end of the interference; null: the end of the run", above=0.0, nullable=True
    )


@record
class Jammer:
    """A transmitter of noise on the frequency of the satellites."""

    position_ned: Array = parameter(unit="m", doc="position: north, east, down", length=3)
    power_w: Array = parameter(default=0.01, unit="W", doc="radiated power", minimum=0.0)
    start: Array = _start()
    end: Array = _end()
    band: Literal["wide", "narrow"] = choice(default="wide", doc="noise as wide as the signals, or a single tone")


@record
class Disc:
    """A simple jammer: no receiver tracks any satellite within a radius."""

    position_ned: Array = parameter(unit="m", doc="position of its centre: north, east, down", length=3)
    radius: Array = parameter(default=100.0, unit="m", doc="radius around the centre", minimum=0.0)
    start: Array = _start()
    end: Array = _end()


@record
class Spoofer:
    """A transmitter of false satellite signals, which moves the fixes of receivers that accept them."""

    position_ned: Array = parameter(unit="m", doc="centre of its range", length=3)
    offset_ned: Array = parameter(unit="m", doc="offset of a fix at the start", length=3)
    rate_ned: Array = parameter(unit="m/s", doc="rate at which the offset grows", length=3)
    radius: Array = parameter(default=None, unit="m", doc="range; null: everywhere", minimum=0.0, nullable=True)
    jam_first: Array = parameter(
        default=0.0,
        unit="s",
        doc="duration of jamming before spoofing, so that receivers lose the true signals",
        minimum=0.0,
    )
    start: Array = _start()
    end: Array = _end()


@record
class Outage:
    """Satellites that send nothing."""

    satellites: Array = quantity(doc="(S,) bool: it is of these")
    start: Array = _start()
    end: Array = _end()


@record
class IonoStorm:
    """A storm of the ionosphere: its delay and slopes are multiplied, ramped over a minute."""

    factor: Array = parameter(default=3.0, unit="1", doc="factor of the ionosphere's delay and slopes", minimum=0.0)
    start: Array = _start()
    end: Array = _end()


@record
class Emitter:
    """A jammer at an epoch."""

    position_ned: Vec3 = quantity(unit="m", doc="() position")
    strength: Array = quantity(
        unit="m^2", doc="() increase of the inverse of C/N0 at 1 m, relative to 45 dB-Hz; 0 if off"
    )


@record
class Circle:
    """A disc at an epoch."""

    position_ned: Vec3 = quantity(unit="m", doc="() centre")
    radius: Array = quantity(unit="m", doc="() negative while it is off")


@record
class Lie:
    """A spoofer at an epoch."""

    where: Circle = quantity(doc="range of its signals")
    jams: Array = quantity(doc="() bool: it still jams")
    offset_ned: Vec3 = quantity(unit="m", doc="() present offset of fixes")
    rate_ned: Vec3 = quantity(unit="m/s", doc="() present offset of velocities")


@record
class Interfering:
    """Interference at an epoch: jammers, discs, spoofers and silent satellites."""

    emitters: tuple[Emitter, ...] = quantity(doc="jammers")
    discs: tuple[Circle, ...] = quantity(doc="places without satellites")
    lies: tuple[Lie, ...] = quantity(doc="spoofers")
    silent: Array = quantity(doc="(K,) bool: the satellite of this slot sends nothing")


@record
class Effect:
    """Effect of interference on receivers (n,) at an epoch."""

    jam: Array = quantity(unit="1", doc="increase of the inverse of C/N0, relative to 45 dB-Hz")
    misled: Array | None = quantity(doc="bool: the receiver is spoofed; None without spoofers")
    offset_ned: Vec3 | None = quantity(unit="m", doc="offset of positions by spoofers, or None")
    rate_ned: Vec3 | None = quantity(unit="m/s", doc="offset of velocities by spoofers, or None")
    above: Array = quantity(unit="1", doc="satellites above the mask that send")
    lost: Array = quantity(unit="1", doc="number of these that are lost to jammers")


@record
class Interference:
    """All that interferes with the receivers of a world."""

    jammers: tuple[Jammer, ...] = quantity(default=(), doc="jammers")
    discs: tuple[Disc, ...] = quantity(default=(), doc="discs")
    spoofers: tuple[Spoofer, ...] = quantity(default=(), doc="spoofers")
    outages: tuple[Outage, ...] = quantity(default=(), doc="outages")
    storms: tuple[IonoStorm, ...] = quantity(default=(), doc="storms")

    @property
    def local(self) -> bool:
        """True if some interference depends on the receiver's position or the satellite: all but ionospheric storms."""
        return bool(self.jammers or self.discs or self.spoofers or self.outages)

    def at(self, places: Array, seconds: Array, fraction: Array) -> Interfering | None:
        """Return the interference active at a time, for satellites with indices ``places`` (K,); None without any."""
        if not self.local:
            return None

        def on(item: Jammer | Disc | Spoofer | Outage) -> Array:
            """Return () bool: an interference source acts at this time."""
            return is_on(item.start, item.end, seconds, fraction)

        emitters = tuple(
            Emitter(_vector(item.position_ned), jnp.where(on(item), strength(item.power_w, item.band), 0.0))
            for item in self.jammers
        )
        discs = tuple(Circle(_vector(item.position_ned), jnp.where(on(item), item.radius, -1.0)) for item in self.discs)
        taken = jnp.maximum(places, 0)
        silent = jnp.zeros(places.shape, bool)
        for item in self.outages:
            silent = silent | (on(item) & jnp.asarray(item.satellites)[taken])
        lies = tuple(self._lie(item, on(item), seconds, fraction) for item in self.spoofers)
        return Interfering(emitters, discs, lies, silent)

    def _lie(self, item: Spoofer, on: Array, seconds: Array, fraction: Array) -> Lie:
        """Return a spoofer's effect at a time: its circle, whether it jams still, position and velocity offsets."""
        passed = since(item.start, seconds, fraction)
        rate = _vector(item.rate_ned)
        where = Circle(_vector(item.position_ned), jnp.where(on, jnp.asarray(item.radius), -1.0))
        return Lie(where, passed < item.jam_first - 1e-4, _vector(item.offset_ned) + rate * passed, rate)

    def stormy(self, common: CommonErrors, seconds: Array, fraction: Array) -> CommonErrors:
        """Return common range errors with the ionospheric ones scaled by the storms active at a time."""
        for item in self.storms:
            begun, ended = (jnp.clip(since(t, seconds, fraction) / _RAMP_S, 0.0, 1.0) for t in (item.start, item.end))
            factor = 1.0 + (item.factor - 1.0) * (begun - ended)
            names = ("delay", "delay_dual", "slope_north", "slope_east")
            more = [map_tree(lambda leaf: leaf * factor, getattr(common, name)) for name in names]  # noqa: B023
            common = replace(common, **dict(zip(names, more, strict=True)))
        return common


def strength(power_w: object, band: str) -> Array:
    """Return the rise of 1/(C/N0) by a jammer of a power [W] at 1 m, in units of 1/(45 dB-Hz) (Kaplan and Hegarty).

    1/(c/n0) = 1/(c/n0 without it) + (j/s)/(Q R_c), j by the power, free space and an antenna of no gain.
    """
    at_1_m = (_LIGHT / (4.0 * math.pi * _L1_HZ)) ** 2 * 10.0 ** (-0.1 * _SIGNAL_DBW)
    return jnp.asarray(power_w) * (at_1_m * _STRONG / (QUALITY[band] * _CODE_HZ))


def jammed(
    now: Interfering,
    affected: Sequence[Array],
    position_ned: Vec3,
    ground: Ground | None,
    skyline: Skyline | None = None,
) -> Array:
    """Return the rise of 1/(C/N0) of receivers (n,) by jammers, discs and jamming spoofers, in 1/(45 dB-Hz).

    Args:
        now: the interference.
        affected: for each spoofer the receivers (n,) bool that it affects.
        position_ned: of the receivers (n,) [m].
        ground: terrain that can hide jammers; None: it hides none.
        skyline: obstacles that can hide jammers; None: they hide none.
    """
    total = jnp.zeros_like(position_ned.x)
    for item in now.emitters:
        way = position_ned - item.position_ned
        gain = jnp.where(way.z > 0.0, 1.0, _FROM_BELOW)
        if ground is not None:
            gain = jnp.where(ground.line_of_sight(position_ned, item.position_ned), gain, gain * _HIDDEN)
        if skyline is not None:
            gain = jnp.where(skyline.sees(position_ned, item.position_ned), gain, gain * _HIDDEN)
        total = total + item.strength * gain / jnp.maximum(way.dot(way), _NEAREST**2)
    for circle in now.discs:
        total = total + jnp.where(_inside(circle, position_ned), BLIND, 0.0)
    for lie, chosen in zip(now.lies, affected, strict=True):
        total = total + jnp.where(chosen & lie.jams & _inside(lie.where, position_ned), BLIND, 0.0)
    return total


def lied_to(now: Interfering, affected: Sequence[Array], position_ned: Vec3) -> tuple[Array, Vec3, Vec3]:
    """Return (n,) bool: a receiver follows a spoofer, and the position [m] and velocity [m/s] offsets that result."""
    zero = jnp.zeros_like(position_ned.x)
    believed, offset, rate = zero > 0.0, Vec3(zero, zero, zero), Vec3(zero, zero, zero)
    for lie, chosen in zip(now.lies, affected, strict=True):
        heard = chosen & ~lie.jams & _inside(lie.where, position_ned)
        believed = believed | heard
        offset, rate = (
            Vec3(*(a + jnp.where(heard, b, 0.0) for a, b in zip(total.axes, more.axes, strict=True)))
            for total, more in ((offset, lie.offset_ned), (rate, lie.rate_ned))
        )
    return believed, offset, rate


def _inside(circle: Circle, position_ned: Vec3) -> Array:
    """Return whether positions NED are inside a circle; never for a circle of negative radius."""
    way = position_ned - circle.position_ned
    # The radius is negative while the disc is off, so that no receiver is inside.
    return way.dot(way) <= circle.radius * jnp.abs(circle.radius)


def _vector(values: object) -> Vec3:
    """Return a sequence of three numbers as a vector."""
    array = jnp.asarray(values)
    return Vec3(array[0], array[1], array[2])
