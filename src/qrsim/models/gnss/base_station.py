"""A base station; its corrections remove the errors that receivers near it have in common with it.

See docs/howto/corrections.md.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw, Drawn, ou_step
from qrsim.core.tree import parameter, quantity, record, replace
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.errors import GaussMarkov2, GaussMarkov2State
from qrsim.models.gnss.schedule import is_on, since

# Number of the "satellite" that the randomness of the base alone belongs to, and pairs of its normals; of satellites
# the error budget has the first ones.
BASE = 0xFFFFFFFE
_CODE_PAIR, _TILT_PAIR, _SURVEY_PAIR = 64, 8, 32
# Time constants [s]: of the multipath of a base that stands still (ours), of what the ionosphere and troposphere leave
# of carrier phase over a baseline, and of carrier multipath.
_CODE_TIMES, _TILT_TIMES, CARRIER_TIME = (100.0, 20.0), (3600.0, 600.0), 30.0


@record
class BaseState:
    """Processes of unit variance."""

    code: GaussMarkov2State = quantity(doc="(S,) multipath of the base, at the next knot")
    tilt: tuple[GaussMarkov2State, ...] = quantity(
        doc="(1,) each: error of north, east, down per distance north, then east"
    )
    carrier: Vec3 = quantity(unit="1", doc="(1,) error of its carrier phase, in position")
    coordinates: Vec3 = quantity(unit="1", doc="(1,) error of its stated position")


@record
class BaseSeen:
    """Corrections of a base station as receivers have them, and its errors; multipath is (K,), by slot."""

    position_ned: Vec3 = quantity(unit="m", doc="() position")
    coordinates: Vec3 = quantity(unit="m", doc="(1,) error of its stated position")
    carrier: Vec3 = quantity(unit="1", doc="(1,) error of its carrier phase, of unit variance")
    tilt_north: Vec3 = quantity(unit="1", doc="(1,) error of a fixed position per way north, of unit variance")
    tilt_east: Vec3 = quantity(unit="1", doc="(1,) the same, east")
    code_before: Array = quantity(unit="1", doc="(K,) its multipath at the last knot, of unit variance")
    code_after: Array = quantity(unit="1", doc="(K,) at the next")
    multipath: Array = quantity(unit="1", doc="() its multipath per that of an airborne antenna")
    age: Array = quantity(unit="s", doc="() time since its last corrections, while it sends any")
    sends: Array = quantity(doc="() bool: it sends corrections")
    reach: Array = quantity(unit="m", doc="() range of its radio")


@record
class BaseStation:
    """A receiver on the ground that sends corrections to those with ``corrections: dgps`` or ``rtk``.

    It uses all satellites of theirs. An error of its stated position moves all that it corrects.
    """

    position_ned: Array = parameter(unit="m", doc="position of its antenna: north, east, down", length=3)
    silent: Array = quantity(unit="s", doc="(M, 2) start and end of each time without corrections")
    survey_error: Array = parameter(default=0.0, unit="m", doc="std of its stated position, per axis", minimum=0.0)
    multipath: Array = parameter(
        default=1.0, unit="1", doc="multipath relative to that of an airborne antenna", minimum=0.0
    )
    interval: Array = parameter(default=1.0, unit="s", doc="interval between corrections", above=0.0)
    reach: Array = parameter(default=1.0e6, unit="m", doc="distance up to which corrections are received", minimum=0.0)

    def init(self, draw: Draw) -> BaseState:
        """Return the base station's random initial errors, in the steady state; ``draw`` is for the S satellites."""
        code = draw.normal_rows(2, first=_CODE_PAIR)
        alone = draw.alone(BASE)
        first, survey = alone.normals(3), alone.normal_rows(3, first=_SURVEY_PAIR)
        tilt = alone.normal_rows(12, first=_TILT_PAIR)
        tilts = tuple(_unit(_TILT_TIMES, code).init(Drawn((tilt[2 * i], tilt[2 * i + 1]))) for i in range(6))
        started = _unit(_CODE_TIMES, code).init(Drawn((code[0], code[1])))
        return BaseState(started, tilts, Vec3(*first), Vec3(survey[0], survey[1], survey[2]))

    def step(self, state: BaseState, draw: Draw, dt: float) -> BaseState:
        """Return the base station's errors ``dt`` [s] later, but for carrier phase, which ``carried`` advances."""
        code = draw.normal_rows(2, first=_CODE_PAIR)
        tilt = draw.alone(BASE).normal_rows(12, first=_TILT_PAIR)
        process = _unit(_TILT_TIMES, code)
        tilts = tuple(
            process.step(before, Drawn((tilt[2 * i], tilt[2 * i + 1])), dt) for i, before in enumerate(state.tilt)
        )
        stepped = _unit(_CODE_TIMES, code).step(state.code, Drawn((code[0], code[1])), dt)
        return replace(state, code=stepped, tilt=tilts)

    def carried(self, state: BaseState, draw: Draw, dt: float) -> BaseState:
        """Return the base station's state with its carrier-phase error dt [s] later, one epoch."""
        return replace(state, carrier=carrier_step(state.carrier, draw.alone(BASE).normals(3), dt))

    def seen(self, now: BaseState, later: BaseState) -> BaseSeen:
        """Return the base station's data as receivers use them from one update of the sky (knot) to the next."""
        north, east, down = self.position_ned[0], self.position_ned[1], self.position_ned[2]
        tilt = [state.error for state in now.tilt]
        zero = jnp.zeros((), now.carrier.x.dtype)
        return BaseSeen(
            position_ned=Vec3(north, east, down),
            coordinates=now.coordinates * jnp.asarray(self.survey_error),
            carrier=now.carrier,
            tilt_north=Vec3(*tilt[:3]),
            tilt_east=Vec3(*tilt[3:]),
            code_before=now.code.error,
            code_after=later.code.error,
            multipath=jnp.asarray(self.multipath),
            age=zero,
            sends=zero == 0.0,
            reach=jnp.asarray(self.reach),
        )

    def heard(self, seen: BaseSeen, carrier: Vec3, seconds: Array, fraction: Array) -> BaseSeen:
        """Return ``seen`` for an epoch: carrier error, age of the corrections [s], and whether they are transmitted."""
        passed = since(0.0, seconds, fraction)
        spans = jnp.reshape(jnp.asarray(self.silent, passed.dtype), (-1, 2))
        quiet = [is_on(spans[i, 0], spans[i, 1], seconds, fraction) for i in range(spans.shape[0])]
        sends = ~jnp.any(jnp.stack(quiet)) if quiet else jnp.ones((), bool)
        # Half a millisecond, so that what was sent now is not an interval old.
        age = jnp.maximum(passed - self.interval * jnp.floor((passed + 5e-4) / self.interval), 0.0)
        return replace(seen, carrier=carrier, age=age, sends=sends)


def carrier_step(carrier: Vec3, normals: tuple[Array, ...], dt: float) -> Vec3:
    """Return carrier-phase errors of unit variance dt [s] later, driven by three standard normals."""
    axes = zip((carrier.x, carrier.y, carrier.z), normals, strict=True)
    one, time = jnp.ones((), carrier.x.dtype), jnp.asarray(CARRIER_TIME, carrier.x.dtype)
    return Vec3(*(ou_step(axis, normal, dt, one, time) for axis, normal in axes))


def _unit(times: tuple[float, float], like: Array) -> GaussMarkov2:
    """Return a Gauss-Markov process of unit variance with the ``times`` [s] (time constant, that of its drive)."""
    one, time, drive = (jnp.asarray(value, like.dtype) for value in (1.0, *times))
    return GaussMarkov2(one, time, drive)


def distance(way: Vec3) -> Array:
    """Return the length [m] of vectors; its gradient is finite at zero length."""
    return jnp.sqrt(way.x * way.x + way.y * way.y + way.z * way.z + math.ulp(1.0))
