"""Gusts at a hovering vehicle in the published wind: 2 ft/s at 20 ft above the ground, from 30 degrees."""

from __future__ import annotations

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, record_of
from qrsim.core.vectors import Vec3
from qrsim.engine.settings import quick_jit
from qrsim.models.atmosphere.contracts import Turbulence
from qrsim.models.atmosphere.dryden import Dryden
from qrsim.models.atmosphere.turbulence import DrydenFirstOrder
from qrsim.models.atmosphere.wind import FEET_PER_METRE, REFERENCE_FT, LogShear
from qrsim.studies.validate.jsbsim_gusts import jsbsim_series
from qrsim.studies.validate.spectra import DT, Case, scales
from qrsim.studies.validate.statistics import against, mean_and_error

WIND_FT_S, FROM_DEG = 2.0, 30.0
SPEED = WIND_FT_S / FEET_PER_METRE
# At 20 ft the mean wind is what the wind is named by; a vehicle that hovers has it as its airspeed.
CASE = Case(REFERENCE_FT / FEET_PER_METRE, SPEED, SPEED)
AXES = ("along", "across", "down")
LAG_S = 10.0
EVERY = 10
# JSBSim starts without gusts: what its first seconds give, more than five time constants, is left out.
SETTLING_S = 400.0


def mean_wind() -> Floats:
    """Return the mean wind (3,) NED [m/s] at the hovering height, in float64."""
    with jax.enable_x64(True):
        wind = record_of(LogShear, SPEED, math.radians(FROM_DEG))
        return np.asarray(wind.velocity_ned(jnp.asarray([CASE.height])).stack())[0]


@partial(quick_jit, static_argnames="steps")
def _simulate_gusts(turbulence: Turbulence, wind: LogShear, height: jax.Array, key: Key, steps: int) -> jax.Array:
    """Simulate gusts (T, vehicles, 3) NED [m/s] at hovering vehicles; one row every EVERY of ``steps`` ticks."""
    ids = jnp.arange(height.size, dtype=jnp.uint32)
    stream, mean = key.stream("gust", ids), wind.velocity_ned(height)
    still, like = Vec3.zeros(height.shape, height.dtype), jnp.zeros((), height.dtype)

    def tick(state: object, now: jax.Array) -> tuple[object, None]:
        """Advance the turbulence by one tick."""
        return turbulence.step(state, Draw(stream, now, like), height, still, mean, DT), None

    def some(state: object, start: jax.Array) -> tuple[object, jax.Array]:
        """Advance the turbulence by EVERY ticks; return its state, and the gusts (vehicles, 3)."""
        state, _ = jax.lax.scan(tick, state, start + jnp.arange(EVERY, dtype=jnp.uint32))
        return state, turbulence.gust_ned(state, height).stack()

    start = turbulence.init(Draw(key.stream("start", ids), jnp.uint32(0), like))
    return jax.lax.scan(some, start, EVERY * jnp.arange(steps // EVERY, dtype=jnp.uint32))[1]


def our_gusts(kind: str, seconds: float, vehicles: int, seed: int) -> Floats:
    """Simulate gusts (T, vehicles, 3) NED [m/s] every 0.2 s; ``kind``: 'dryden' or 'dryden_first_order'."""
    makers = {"dryden": Dryden, "dryden_first_order": DrydenFirstOrder}
    bearing = math.radians(FROM_DEG)
    turbulence = cast(makers[kind](SPEED, bearing), np.float32)
    wind = cast(record_of(LogShear, SPEED, bearing), np.float32)
    height = np.full(vehicles, CASE.height, np.float32)
    gusts = _simulate_gusts(turbulence, wind, height, Key.root(seed), round(seconds / DT))
    return np.asarray(gusts, np.float64)


def jsbsim_gusts(kind: int, seconds: float, seed: int) -> Floats:
    """Simulate gusts (T, 3) NED [m/s] every 0.2 s by JSBSim's type of turbulence ``kind``, once it has settled.

    Raises:
        RunError: no jsbsim.
    """
    settling = round(SETTLING_S / DT)
    series = jsbsim_series(CASE, kind, settling + round(seconds / DT), seed)
    # The body flew north: its axes are turned into those of the wind.
    return in_ned(series[:3, settling + EVERY - 1 :: EVERY].T)


def in_ned(along_across_down: Floats) -> Floats:
    """Rotate gusts (..., 3) from wind axes (along, across, down) into NED."""
    sine, cosine = math.sin(math.radians(FROM_DEG)), math.cos(math.radians(FROM_DEG))
    turn = np.array([[-cosine, sine, 0.0], [-sine, -cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(along_across_down @ turn.T)


def in_wind_axes(gusts_ned: Floats) -> Floats:
    """Rotate gusts (..., 3) from NED into wind axes: along, across, down."""
    sine, cosine = math.sin(math.radians(FROM_DEG)), math.cos(math.radians(FROM_DEG))
    turn = np.array([[-cosine, sine, 0.0], [-sine, -cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(gusts_ned @ turn)


def autocorrelation(kind: str, lag: float) -> Floats:
    """Return the exact autocorrelation (3,) of gusts of a model ``kind``, along, across, down, at a lag [s]."""
    x = lag / (scales(CASE)[0] / CASE.airspeed)
    decay = np.exp(-x)
    return decay if kind == "dryden_first_order" else decay * np.array([1.0, 1.0 - x[1] / 2.0, 1.0 - x[2] / 2.0])


def statistics(kind: str, gusts_ned: Floats) -> dict[str, object]:
    """Compare variance and autocovariance of gusts (T, n, 3) at n vehicles with the closed forms of model ``kind``."""
    gusts, sigma = in_wind_axes(gusts_ned) / scales(CASE)[1], autocorrelation(kind, LAG_S)
    lag = round(LAG_S / (DT * EVERY))
    results: dict[str, object] = {}
    for i, axis in enumerate(AXES):
        found = {}
        for name, products, expected in (
            ("variance", gusts[:, :, i] ** 2, 1.0),
            ("autocovariance_10_s", gusts[lag:, :, i] * gusts[:-lag, :, i], float(sigma[i])),
        ):
            mean, error = mean_and_error(products.mean(axis=0))
            found[name] = against(mean, expected, float(error)) | {"standard_error": float(error)}
        results[axis] = found
    return results
