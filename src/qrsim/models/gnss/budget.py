"""Range errors by their causes: satellites, ionosphere and troposphere (docs/explanation/gnss_errors.md)."""

from __future__ import annotations

from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw, Drawn
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.models.gnss.contracts import RangeErrors
from qrsim.models.gnss.errors import GaussMarkov2, GaussMarkov2State
from qrsim.models.gnss.sight import CommonErrors, Scales, Sight

# Number of the "satellite" that the randomness of all of them together belongs to.
ALL = 0xFFFFFFFF


@record
class BudgetState:
    """Processes of unit variance."""

    signal: GaussMarkov2State = quantity(doc="(S,) clock and ephemeris")
    local: GaussMarkov2State = quantity(doc="(S,) ionosphere of each satellite")
    slope_north: GaussMarkov2State = quantity(doc="(S,) its slope over the field, north")
    slope_east: GaussMarkov2State = quantity(doc="(S,) the same, east")
    vertical: GaussMarkov2State = quantity(doc="(1,) vertical ionosphere")
    gradient_north: GaussMarkov2State = quantity(doc="(1,) its gradient, north")
    gradient_east: GaussMarkov2State = quantity(doc="(1,) the same, east")
    troposphere: GaussMarkov2State = quantity(doc="(1,) zenith troposphere")


def _std(default: float, unit: str, doc: str) -> Array:
    """Return the field declaration of a parameter that is a standard deviation, at least 0."""
    return parameter(default=default, unit=unit, doc=doc, minimum=0.0)


def _time(default: float, doc: str) -> Array:
    """Return the field declaration of a parameter that is a time constant [s], above 0."""
    return parameter(default=default, unit="s", doc=doc, above=0.0)


@record
class ErrorBudget(RangeErrors):
    """Range errors by their causes: satellites, ionosphere, troposphere; each a second-order process.

    The receivers of a world share them. ``common: per_vehicle`` gives every ``gnss`` receiver separate errors with the
    same statistics, for studies that need independent ones. The ionosphere leaves less to receivers of two
    frequencies; its terms that end in ``_dual`` are for these.
    """

    gps: Array = _std(0.6, "m", "std of clock and ephemeris of GPS satellites")
    galileo: Array = _std(0.2, "m", "std of clock and ephemeris of Galileo satellites")
    glonass: Array = _std(2.0, "m", "std of clock and ephemeris of GLONASS satellites")
    beidou: Array = _std(0.6, "m", "std of clock and ephemeris of BeiDou satellites, and of any other system")
    ionosphere: Array = _std(1.5, "m", "std of the vertical ionosphere after the broadcast correction")
    gradient: Array = _std(1.0e-3, "m/km", "std of the ionosphere's horizontal gradient")
    local: Array = _std(0.35, "m", "std of each satellite's vertical ionosphere about the plane of the gradient")
    slope: Array = _std(2.0e-3, "m/km", "std of the slope of that vertical residual over the field, per axis")
    ionosphere_dual: Array = _std(0.5, "m", "the same as ionosphere, for two frequencies")
    gradient_dual: Array = _std(3.0e-4, "m/km", "the same as gradient, for two frequencies")
    local_dual: Array = _std(0.2, "m", "the same as local, for two frequencies")
    slope_dual: Array = _std(5.0e-4, "m/km", "the same as slope, for two frequencies")
    troposphere: Array = _std(0.12, "m", "std of the zenith troposphere after its model")
    signal_time: Array = _time(3600.0, "time constant of clocks and ephemerides")
    signal_drive_time: Array = _time(300.0, "time constant of the process that drives them")
    ionosphere_time: Array = _time(3600.0, "time constant of the vertical ionosphere")
    ionosphere_drive_time: Array = _time(300.0, "time constant of the process that drives it")
    gradient_time: Array = _time(7200.0, "time constant of the ionosphere's gradient")
    gradient_drive_time: Array = _time(600.0, "time constant of the process that drives it")
    local_time: Array = _time(1800.0, "time constant of the residual about the plane, and of its slope")
    local_drive_time: Array = _time(300.0, "time constant of the process that drives them")
    troposphere_time: Array = _time(2700.0, "time constant of the troposphere")
    troposphere_drive_time: Array = _time(600.0, "time constant of the process that drives it")
    common: Literal["shared", "per_vehicle"] = setting(
        default="shared", doc="errors shared by all gnss receivers of a world, or independent for each vehicle"
    )
    needs_sight: ClassVar[bool] = True

    def init(self, draw: Draw) -> BudgetState:
        """Return random initial range errors of S satellites, in the statistical steady state."""
        each, together = draw.normals(8), one_for_all(draw).normals(8)
        return BudgetState(*_started(self._per_satellite(), each), *_started(self._for_all(), together))

    def step(self, state: BudgetState, draw: Draw, dt: float) -> BudgetState:
        """Return the range errors' state dt [s] later, by the exact transition."""
        each, together = draw.normals(8), one_for_all(draw).normals(8)
        before = (state.signal, state.local, state.slope_north, state.slope_east)
        rest = (state.vertical, state.gradient_north, state.gradient_east, state.troposphere)
        return BudgetState(
            *_stepped(self._per_satellite(), before, each, dt), *_stepped(self._for_all(), rest, together, dt)
        )

    def value(self, state: BudgetState) -> Array:
        """Return the range errors (S,) [m] of a state, for GPS satellites at the zenith and one frequency."""
        above = self.ionosphere * state.vertical.error + self.local * state.local.error
        return self.gps * state.signal.error + above + self.troposphere * state.troposphere.error

    def seen(self, state: BudgetState, sight: Sight, system: Array) -> CommonErrors:
        """Return the range errors [m], in parts, of S satellites at the elevations in ``sight``, by ``system`` (S,)."""
        std = self.scales(system).signal
        weather = self.troposphere * state.troposphere.error * sight.troposphere

        def delay(vertical: Array, gradient: Array, local: Array) -> Array:
            """Return the ionospheric delay (S,) [m] for stds [m] of its vertical, gradient and local parts."""
            plane = state.gradient_north.error * sight.pierce_north + state.gradient_east.error * sight.pierce_east
            return sight.ionosphere * (vertical * state.vertical.error + gradient * plane + local * state.local.error)

        return CommonErrors(
            signal=std * state.signal.error + weather,
            delay=delay(self.ionosphere, self.gradient, self.local),
            delay_dual=delay(self.ionosphere_dual, self.gradient_dual, self.local_dual),
            slope_north=sight.ionosphere * state.slope_north.error,
            slope_east=sight.ionosphere * state.slope_east.error,
            weather=weather,
        )

    def scales(self, system: Array) -> Scales:
        """Return the standard deviations [m] of the error terms of satellites, by system numbers ``system`` (S,)."""
        number = jnp.asarray(system)
        last = jnp.where(number == 2, self.glonass, self.beidou)
        return Scales(
            signal=jnp.where(number == 0, self.gps, jnp.where(number == 1, self.galileo, last)),
            troposphere=jnp.asarray(self.troposphere),
            vertical=(jnp.asarray(self.ionosphere), jnp.asarray(self.ionosphere_dual)),
            gradient=(jnp.asarray(self.gradient), jnp.asarray(self.gradient_dual)),
            local=(jnp.asarray(self.local), jnp.asarray(self.local_dual)),
            slope=(jnp.asarray(self.slope), jnp.asarray(self.slope_dual)),
        )

    def processes(self) -> tuple[tuple[GaussMarkov2, ...], tuple[GaussMarkov2, ...]]:
        """Return the unit-variance error processes that each satellite has, and those that all satellites share."""
        return self._per_satellite(), self._for_all()

    def _per_satellite(self) -> tuple[GaussMarkov2, ...]:
        """Return the unit-variance error processes that each satellite has by itself."""
        local = _unit(self.local_time, self.local_drive_time)
        return (_unit(self.signal_time, self.signal_drive_time), local, local, local)

    def _for_all(self) -> tuple[GaussMarkov2, ...]:
        """Return the unit-variance error processes that all satellites share."""
        gradient = _unit(self.gradient_time, self.gradient_drive_time)
        vertical = _unit(self.ionosphere_time, self.ionosphere_drive_time)
        return (vertical, gradient, gradient, _unit(self.troposphere_time, self.troposphere_drive_time))


def _unit(time: Array, drive_time: Array) -> GaussMarkov2:
    """Return a Gauss-Markov process of unit variance with this time constant [s], and that of its drive [s]."""
    return GaussMarkov2(jnp.ones_like(jnp.asarray(time)), time, drive_time)


def _started(processes: tuple[GaussMarkov2, ...], normals: tuple[Array, ...]) -> list[GaussMarkov2State]:
    """Return random initial states of error processes, from two standard normals for each process."""
    return [process.init(Drawn(normals[2 * i : 2 * i + 2])) for i, process in enumerate(processes)]


def _stepped(
    processes: tuple[GaussMarkov2, ...], states: tuple[GaussMarkov2State, ...], normals: tuple[Array, ...], dt: float
) -> list[GaussMarkov2State]:
    """Return the states of error processes dt [s] later, from two standard normals for each process."""
    pairs = enumerate(zip(processes, states, strict=True))
    return [process.step(state, Drawn(normals[2 * i : 2 * i + 2]), dt) for i, (process, state) in pairs]


def one_for_all(draw: Draw) -> Draw:
    """Return the random draw (1,) of the errors that all satellites share, from that of the satellites."""
    return draw.alone(ALL)
