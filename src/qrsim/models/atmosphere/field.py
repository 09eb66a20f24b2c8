"""Turbulence as one field of a world: what all vehicles fly through, with the spectra of MIL-F-8785C along any line.

The gust is a function of seed, world, place and time. It is a sum of waves (``field_modes``), the same for all worlds
but for a random rotation, reflection, dilation and phases, so that the mean over worlds is isotropic and has closed
forms: for the Dryden form f = exp(-r/L) along and g = (1 - r/(2 L)) exp(-r/L) across a separation r.

North and east are weighted by the lengths and intensities that MIL-F-8785C has for the horizontal gusts, down by those
for the vertical ones; above 2000 ft they are equal and the field has no divergence. The field moves with one velocity,
that of the mean wind at ``convection_height`` or the one given. Frequencies are whole numbers of turns/2^32 per second,
so that whole seconds are multiplied without rounding in runs of any length. Waves have a lifetime
(``field_waves``), or last for ever in a frozen field.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.fastmath import exp, power, reciprocal_root, rounded, sincos_turns
from qrsim.core.noise import Draw, Noise, ou_decay
from qrsim.core.tree import computed, parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import CONVECTION_HEIGHT, Turbulence, Wind, horizontal_mean
from qrsim.models.atmosphere.dryden import HIGH_LENGTH_FT, dryden_scales
from qrsim.models.atmosphere.field_modes import SEGMENTS, Floats, Modes, modes
from qrsim.models.atmosphere.field_waves import FieldWaves, draw_ages, waves_at, whole_turns
from qrsim.models.atmosphere.turbulence import (
    NEAR_GROUND,
    NearGround,
    StillState,
    carrying_speed,
    driving_speed,
    high_severity,
)

# Above 2000 ft the von Karman form has a longer length (MIL-F-8785C, 3.7.2.1), and 1.339 is its (k L)'s factor.
VON_KARMAN_HIGH_LENGTH_FT = 2500.0
VON_KARMAN_SCALE = math.gamma(1.0 / 3.0) / (math.sqrt(math.pi) * math.gamma(5.0 / 6.0))
# E(k) = s^2 L E0 x^4/(1 + x^2)^p, with x = k L or k times the scaled length: E0.
DRYDEN_ENERGY = 8.0 / math.pi
VON_KARMAN_ENERGY = 55.0 * math.gamma(5.0 / 6.0) / (9.0 * math.sqrt(math.pi) * math.gamma(1.0 / 3.0))
# Of the Dryden form beyond the highest wavenumber k: 16/(3 pi k L) of the variance. A first-order process of that
# variance and these lengths times 1/k continues the tails 2 s^2/(pi L O^2) along and 3 s^2/(pi L O^2) across.
RESIDUAL_SHARE, RESIDUAL_ALONG, RESIDUAL_ACROSS = 16.0 / (3.0 * math.pi), 16.0 / (3.0 * math.pi), 32.0 / (9.0 * math.pi)


@record
class ResidualState:
    """Gusts of what is smaller than the shortest wave, each (n,), in units of their standard deviation."""

    gust: Vec3 = quantity(unit="1", doc="north, east and down")


class Sums(NamedTuple):
    """Sums over all waves at n vehicles, in the axes of the waves: gust and half its curl for two sets of weights."""

    across: Vec3
    down: Vec3
    across_curl: Vec3
    down_curl: Vec3


@record
class DrydenField(Turbulence):
    """One turbulent field that all vehicles of a world share, with Dryden or von Karman spectra at each vehicle."""

    speed_20ft: Array = driving_speed(" below 2000 ft")
    convection_ned: Array | None = parameter(
        default=None,
        unit="m/s",
        doc="[north, east] velocity that carries the field; null: the mean wind at convection_height",
        minimum=-100.0,
        maximum=100.0,
        length=2,
        nullable=True,
    )
    convection_height: Array = parameter(
        default=CONVECTION_HEIGHT,
        unit="m",
        doc="height of the mean wind that carries the field",
        minimum=1.0,
        maximum=300.0,
    )
    sweep: Array = parameter(
        default=0.0,
        unit="m/s",
        doc="std of the random speed of each chain of waves along itself",
        minimum=0.0,
        maximum=10.0,
    )
    lifetime: Array = parameter(
        default=100.0,
        unit="s",
        doc="time in which each wave fades in and out, before it returns with a new phase",
        minimum=10.0,
        maximum=10000.0,
    )
    evolution: Literal["lifetime", "frozen"] = setting(
        default="lifetime",
        doc="'lifetime': waves fade; 'frozen': Taylor's hypothesis, in which waves are permanent and a "
        "hovering vehicle feels steady tones",
    )
    near_ground: NearGround = setting(default="blocked", doc=NEAR_GROUND)
    severity: int = high_severity()
    spectrum: Literal["dryden", "von_karman"] = setting(default="dryden", doc="form of the spectra of MIL-F-8785C")
    residual: Literal["none", "filter"] = setting(
        default="none",
        doc="'filter' adds gusts smaller than the shortest wave, independent for each vehicle; 'none' "
        "keeps one pure field",
    )
    chains: int = setting(
        default=16, unit="1", doc="chains of waves in each of two segments, a multiple of 4", minimum=8, maximum=64
    )
    octaves: int = setting(
        default=12,
        unit="1",
        doc="octaves of wavelength down from 6560 m; fewer leave out small gusts",
        minimum=8,
        maximum=14,
    )

    rates: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "seconds", "fraction", "field")
    sees_wind: ClassVar[bool] = True

    @computed
    def normals(self) -> int:
        """Number of standard normals per vehicle and tick, for the part of the gusts that the field leaves out."""
        return 3 if self.residual == "filter" else 0

    @computed
    def field_ids(self) -> int:
        """Number of random ids that an episode draws for the field, one for each chain of waves."""
        return SEGMENTS * self.chains

    def convection_velocity_ned(self, wind: Wind) -> Vec3:
        """Return the horizontal velocity () [m/s] NED that carries the gust field: as given, or the mean wind's."""
        if self.convection_ned is not None:
            return Vec3(self.convection_ned[0], self.convection_ned[1], jnp.zeros_like(self.convection_ned[0]))
        return horizontal_mean(wind, jnp.asarray(self.convection_height))

    def draw_field(self, draw: Draw, wind: Any = None) -> FieldWaves:
        """Return an episode's random gust field: its waves' orientation, phases and frequencies.

        Every product is rounded on its own, so that the frequencies are the same in every program.
        """
        words, _ = draw.stream.words(draw.tick, 0)
        sweep = draw.normal_rows(1, first=1)[0]
        turned, handedness = _rotation(draw.normal_rows(4, first=2)[:, 0], draw.stream.words(draw.tick, 5)[0][0])
        # As many bits as are exact in single precision, so that it is below 1.
        share = (draw.stream.words(draw.tick, 4)[0][0] >> 9).astype(jnp.int32).astype(draw.like.dtype) * 2.0**-23
        dilation = exp(rounded(share * (math.log(2.0) / self.chains)))
        way = _times(turned, self.convection_velocity_ned(wind).map(lambda axis: jnp.asarray(axis, share.dtype)))
        start = self._modes()
        waves = Vec3.of(_numbers(start.directions.reshape(-1, 3), share))
        along = rounded(waves.x * way.x) + (rounded(waves.y * way.y) + rounded(waves.z * way.z))
        speed = along + rounded(sweep * self.sweep)
        per_metre = rounded(_numbers(start.first.reshape(-1) / (2.0 * math.pi), share) * dilation)
        frequency = rounded(per_metre * speed)
        ages = None if self.evolution == "frozen" else draw_ages(draw, 6, jnp.asarray(self.lifetime, share.dtype))
        return FieldWaves(words, whole_turns(frequency), frequency, turned, handedness, dilation, ages)

    def init(self, draw: Noise) -> StillState | ResidualState:
        """Return the random initial residual in the steady state: vehicles' own gusts beyond the field; else empty."""
        return ResidualState(Vec3(*draw.normals(3))) if self.residual == "filter" else StillState()

    def step(
        self,
        state: StillState | ResidualState,
        draw: Noise,
        height_agl: Array,
        velocity_ned: Vec3,
        mean_wind_ned: Vec3,
        dt: float,
    ) -> StillState | ResidualState:
        """Return the residual gusts (n,) dt [s] later, correlated along the level path through the air and across."""
        if isinstance(state, StillState):
            return state
        normals = Vec3(*draw.normals(3))
        way = dt * carrying_speed("relative", velocity_ned, mean_wind_ned) * self._modes().highest
        along, across = (ou_decay(1.0, length / way) for length in (RESIDUAL_ALONG, RESIDUAL_ACROSS))
        north, east = _heading(velocity_ned - mean_wind_ned)
        gust = state.gust
        forward = along[0] * (north * gust.x + east * gust.y) + along[1] * normals.x
        right = across[0] * (north * gust.y - east * gust.x) + across[1] * normals.y
        down = across[0] * gust.z + across[1] * normals.z
        return ResidualState(Vec3(north * forward - east * right, east * forward + north * right, down))

    def gust_ned(
        self,
        state: StillState | ResidualState,
        height_agl: Array,
        position_ned: Vec3,
        seconds: Array,
        fraction: Array,
        field: FieldWaves,
    ) -> Vec3:
        """Return the gust velocity (n,) [m/s] NED at positions (n,) [m], heights (n,) [m] above ground and a time.

        Args:
            state: of the residual.
            height_agl: (n,) [m], which gives lengths and intensities.
            position_ned: (n,) [m].
            seconds, fraction: () time since the start [s] in whole seconds, int32, and the rest.
            field: what the world has drawn.
        """
        lengths, sigma = self._scales(height_agl)
        sums = self._sums(lengths, position_ned, seconds, fraction, field)
        size = self._size(lengths, sigma, field)
        across, down = _back(field.turned, sums.across), _back(field.turned, sums.down)
        gust = Vec3(size.x * across.x, size.x * across.y, size.z * down.z)
        if isinstance(state, StillState):
            return gust
        share = lengths.map(lambda length: jnp.minimum(RESIDUAL_SHARE / (self._modes().highest * length), 1.0))
        scaled = Vec3(sigma.x * state.gust.x, sigma.y * state.gust.y, sigma.z * state.gust.z)
        return gust + Vec3(jnp.sqrt(share.x) * scaled.x, jnp.sqrt(share.y) * scaled.y, jnp.sqrt(share.z) * scaled.z)

    def gust_rates_ned(
        self,
        state: StillState | ResidualState,
        height_agl: Array,
        position_ned: Vec3,
        seconds: Array,
        fraction: Array,
        field: FieldWaves,
    ) -> Vec3:
        """Return the air's rotation (n,) [rad/s] NED, half the curl of the gust field; arguments as ``gust_ned``.

        The change of the weights with height is left out of the curl.
        """
        lengths, sigma = self._scales(height_agl)
        sums = self._sums(lengths, position_ned, seconds, fraction, field)
        size = self._size(lengths, sigma, field) * (field.handedness * field.dilation)
        across, down = _back(field.turned, sums.across_curl), _back(field.turned, sums.down_curl)
        return Vec3(
            0.5 * (size.x * across.x + size.z * down.x),
            0.5 * (size.x * across.y + size.z * down.y),
            size.x * across.z,
        )

    def _modes(self) -> Modes:
        """Return the fixed set of waves that the settings ``chains`` and ``octaves`` give."""
        return modes(self.chains, self.octaves)

    def _scales(self, height_agl: Array) -> tuple[Vec3, Vec3]:
        """Return length scales [m] and standard deviations [m/s] of the gusts at heights (n,) [m] above ground."""
        high = HIGH_LENGTH_FT if self.spectrum == "dryden" else VON_KARMAN_HIGH_LENGTH_FT
        return dryden_scales(height_agl, self.speed_20ft, self.severity, high, self.near_ground)

    def _size(self, lengths: Vec3, sigma: Vec3, field: FieldWaves) -> Vec3:
        """Return the amplitude factor (n,) [m/s] of each gust axis, common to all waves, from scales and stds."""
        energy, scale = DRYDEN_ENERGY, field.dilation
        if self.spectrum == "von_karman":
            energy, scale = VON_KARMAN_ENERGY, VON_KARMAN_SCALE * field.dilation
        amplitude = math.sqrt(2.0 * energy * math.log(2.0) / self.chains)

        def size(std: Array, length: Array) -> Array:
            """Return one axis' amplitude factor (n,) [m/s] for its standard deviation [m/s] and length scale [m]."""
            scaled = length * scale
            return (amplitude * std) * (scaled * scaled) * jnp.sqrt(scaled)

        return Vec3(size(sigma.x, lengths.x), size(sigma.y, lengths.y), size(sigma.z, lengths.z))

    def _weight(self, square: Array) -> Array:
        """Return the factor of a wave's amplitude that depends on its wavenumber kappa, for L^2 + 1/kappa^2 [m^2]."""
        root = reciprocal_root(square)
        return (root * root) * (root if self.spectrum == "dryden" else power(root, 5.0 / 6.0))

    def _sums(self, lengths: Vec3, position_ned: Vec3, seconds: Array, fraction: Array, field: FieldWaves) -> Sums:
        """Return the gust field's velocity and rotation at positions (n,), summed over all waves, for scales [m].

        With x = kappa l the amplitude of a wave of the Dryden form goes with x^(5/2)/(1 + x^2)^(3/2), which is
        l^(5/2)/(l^2 + 1/kappa^2)^(3/2) over the root of kappa. The last is in the tables of the waves, the first in
        ``_size``.
        """
        dryden = self.spectrum == "dryden"
        scale = field.dilation * (1.0 if dryden else VON_KARMAN_SCALE)
        squares = [((length * scale) * (length * scale))[None] for length in (lengths.x, lengths.z)]
        place = _times(field.turned, position_ned) * field.dilation
        of = self._modes()
        # A group that an octave does not have is left out.
        kappa = np.where(of.centre > 0.0, of.centre, np.inf)
        own = kappa ** (-0.5 if dryden else -1.0 / 3.0)
        turns, amplitude = waves_at(field, seconds, fraction)
        values = list(_group_values(of, own, turns, amplitude, place))
        sums: list[Vec3] = []
        curls: list[Vec3] = []
        for square in squares:
            parts = [
                value * self._weight(square + _numbers(each**-2.0, scale))
                for value, each in zip(values, kappa, strict=True)
            ]
            total = rotation = parts[-1]
            # The wavenumber doubles from octave to octave.
            for part in reversed(parts[:-1]):
                total, rotation = total + part, (rotation + rotation) + part
            sums.append(total)
            curls.append(rotation * _numbers(0.5 * of.centre[0] * of.handedness, scale))
        return Sums(*(total.map(lambda axis: jnp.sum(axis, axis=0)) for total in (*sums, *curls)))


def _group_values(of: Modes, own: Floats, turns: Array, amplitude: Array | None, place: Vec3) -> Iterator[Vec3]:
    """Yield, for each octave, velocity sums (B, n) of B groups of waves, in the waves' axes, weighted by ``own`` only.

    Args:
        of: the set of waves, B groups of C chains.
        own: (J, B, 1), a factor of each group's waves.
        turns: (B C,) phases at the origin.
        amplitude: (B C,) of chains, None for 1.
        place: (n,) dilated, in the axes of the waves [m].
    """
    wave = Vec3.of(_numbers(of.turns_per_metre, turns))
    row = place.map(lambda axis: axis[None, None])
    phase = turns.reshape(of.first.shape)[:, :, None] + (wave.x * row.x + (wave.y * row.y + wave.z * row.z))
    sine, cosine = sincos_turns(phase)
    size = 1.0 if amplitude is None else amplitude.reshape(of.first.shape)[:, :, None]
    for octave in range(of.octaves):
        if octave:
            double = sine + sine
            sine, cosine = double * cosine, 1.0 - double * sine
        sized_sine, sized_cosine = (sine, cosine) if amplitude is None else (sine * size, cosine * size)
        own_size = own[octave][:, None, None]
        by_cosine, by_sine = (Vec3.of(_numbers(own_size * table[octave], turns)) for table in (of.cosine, of.sine))
        yield Vec3(
            jnp.sum(rounded(by_cosine.x * sized_cosine) + by_sine.x * sized_sine, axis=1),
            jnp.sum(rounded(by_cosine.y * sized_cosine) + by_sine.y * sized_sine, axis=1),
            jnp.sum(rounded(by_cosine.z * sized_cosine) + by_sine.z * sized_sine, axis=1),
        )


def _numbers(table: Floats, like: Array) -> Array:
    """Return a NumPy table as an array with the dtype of ``like``."""
    return jnp.asarray(table.astype(like.dtype))


def _rotation(normals: Array, word: Array) -> tuple[tuple[Vec3, Vec3, Vec3], Array]:
    """Return the rows of a random rotation, negated if bit 31 of ``word`` is set, and its determinant, 1 or -1."""
    w, x, y, z = normals
    sign = jnp.where(word >> 31 == 1, -1.0, 1.0).astype(normals.dtype)

    def product(a: Array, b: Array) -> Array:
        """Return the product a b, rounded before any sum, so that all programs give the same bits."""
        return rounded(a * b)

    squares = [product(a, a) for a in (w, x, y, z)]
    scale = sign / ((squares[0] + squares[1]) + (squares[2] + squares[3]))

    def diagonal(mine: int) -> Array:
        """Return the rotation's diagonal entry for quaternion component ``mine``, 1 to 3."""
        first, second = (i for i in (1, 2, 3) if i != mine)
        return product((squares[0] + squares[mine]) - (squares[first] + squares[second]), scale)

    def beside(a: Array, b: Array, c: Array) -> Array:
        """Return an off-diagonal entry of the rotation, 2 (a b + w c) over the quaternion's squared norm."""
        return product(2.0 * (product(a, b) + product(w, c)), scale)

    rows = (
        Vec3(diagonal(1), beside(x, y, -z), beside(x, z, y)),
        Vec3(beside(x, y, z), diagonal(2), beside(y, z, -x)),
        Vec3(beside(x, z, -y), beside(y, z, x), diagonal(3)),
    )
    return rows, sign


def _times(rows: tuple[Vec3, Vec3, Vec3], vector: Vec3) -> Vec3:
    """Return the product of a 3 x 3 matrix, given by its rows, and a vector."""
    return Vec3(rows[0].dot(vector), rows[1].dot(vector), rows[2].dot(vector))


def _back(rows: tuple[Vec3, Vec3, Vec3], vector: Vec3) -> Vec3:
    """Return the product of a transposed 3 x 3 matrix, given by its rows, and a vector."""
    return rows[0] * vector.x + rows[1] * vector.y + rows[2] * vector.z


def _heading(velocity_ned: Vec3) -> tuple[Array, Array]:
    """Return cosine and sine (n,) of the bearing of horizontal velocities; north for a zero velocity."""
    square = velocity_ned.x * velocity_ned.x + velocity_ned.y * velocity_ned.y
    moves = square > 1e-6
    speed = jnp.sqrt(jnp.where(moves, square, 1.0))
    return jnp.where(moves, velocity_ned.x / speed, 1.0), jnp.where(moves, velocity_ned.y / speed, 0.0)
