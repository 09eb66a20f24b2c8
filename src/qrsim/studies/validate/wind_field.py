"""The field of gusts: how alike they are at two points, and how they travel, against closed forms.

Dryden's spectra are those of isotropic turbulence whose longitudinal correlation is f(r) = exp(-r/L); across a
separation it is g(r) = f + r f'/2 = (1 - r/(2 L)) exp(-r/L) (G. K. Batchelor, The Theory of Homogeneous Turbulence,
1953, 3.4). Along a line in the wind they are the spectra of MIL-F-8785C. In a frozen field that travels with the mean
wind (Taylor's hypothesis) gusts are later and further downwind what they were before. By default waves have a lifetime,
and gusts are forgotten by the autocorrelation of its sin^2 window.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, record_of
from qrsim.core.vectors import Vec3
from qrsim.engine.settings import quick_jit
from qrsim.models.atmosphere.field import DrydenField
from qrsim.models.atmosphere.wind import LogShear
from qrsim.studies.validate.published import dryden_scales, wind_over_20ft
from qrsim.studies.validate.report import Check, Outcome, Part, Picture
from qrsim.studies.validate.statistics import CONFIDENCE, mean_and_error, widest_z

Evolution = Literal["lifetime", "frozen"]

SEED, HEIGHT, SPEED_20FT = 1953, 15.0, 5.0
WORLDS, FEW_WORLDS, PAIRS = 400, 100, 24
SEPARATIONS = (1.0, 3.0, 10.0, 30.0, 100.0)
# What the finite set of waves leaves out of the variance at this height: of horizontal and of vertical gusts.
LEFT_OUT = (0.005, 0.03)
# Lags [s] of gusts that travel, a height of the wind that carries them, and the lifetime of the waves [s].
LAGS, CARRIED_AT, LIFETIME = (1.0, 5.0, 20.0), 20.0, 100.0


@partial(quick_jit, static_argnames="worlds")
def _gusts_at(field: DrydenField, wind: LogShear, place: jax.Array, seconds: jax.Array, worlds: int) -> jax.Array:
    """Return gusts (W, n, 3) [m/s] of a field in W worlds at points (n, 3) and whole seconds (n,)."""
    ids, like = jnp.arange(field.field_ids, dtype=jnp.uint32), jnp.zeros((), jnp.float32)

    def one(world: jax.Array) -> jax.Array:
        """Return the gusts (n, 3) [m/s] of one world."""
        waves = field.draw_field(Draw(Key.root(SEED, world).stream("/turbulence", ids), jnp.int32(0), like), wind)

        def at(point: jax.Array, second: jax.Array) -> jax.Array:
            """Return the gust (3,) [m/s] at a point and a second."""
            where = Vec3(*(axis[None] for axis in point))
            state = field.init(None)  # type: ignore[arg-type]
            gust = field.gust_ned(state, -where.z, where, seconds=second, fraction=like, field=waves)
            return gust.stack()[0]

        return jax.vmap(at)(place, seconds)

    return jax.vmap(one)(jnp.arange(worlds, dtype=jnp.uint32))


def gusts(place: Floats, seconds: Floats, worlds: int, evolution: Evolution = "lifetime") -> Floats:
    """Return gusts (W, n, 3) [m/s] of a gust field in a wind that blows north, at places (n, 3) and seconds (n,)."""
    given = record_of(DrydenField, speed_20ft=SPEED_20FT, evolution=evolution)
    field = jax.tree.map(jnp.asarray, cast(given, np.float32))
    wind = cast(record_of(LogShear, SPEED_20FT, np.pi), np.float32)
    found = _gusts_at(field, wind, jnp.asarray(place, jnp.float32), jnp.asarray(seconds, jnp.int32), worlds)
    return np.asarray(found, np.float64)


def closed(r: float) -> dict[str, float]:
    """Return the closed-form correlations of gusts at a separation ``r`` [m]: along, across, vertical."""
    (length, _, vertical), _ = dryden_scales(HEIGHT, SPEED_20FT)
    return {
        "along": float(np.exp(-r / length)),
        "across": float((1.0 - r / (2.0 * length)) * np.exp(-r / length)),
        "vertical": float((1.0 - r / (2.0 * vertical)) * np.exp(-r / vertical)),
    }


def two_points(worlds: int) -> dict[str, dict[str, tuple[float, float]]]:
    """Return separation [m] -> (correlation, standard error) of gusts at two points, by component; at 0 the variance.

    The variance is in units of the standard's.
    """
    rng = np.random.default_rng(SEED)
    here = np.column_stack([rng.uniform(-2000.0, 2000.0, (PAIRS, 2)), np.full(PAIRS, -HEIGHT)])
    way = rng.uniform(0.0, 2.0 * np.pi, PAIRS)
    ahead = np.column_stack([np.cos(way), np.sin(way), 0.0 * way])
    aside = np.column_stack([-np.sin(way), np.cos(way), 0.0 * way])
    places = np.concatenate([here, *(here + r * ahead for r in SEPARATIONS)])
    every = gusts(places, np.zeros(len(places)), worlds).reshape(worlds, -1, PAIRS, 3)
    _, sigma = dryden_scales(HEIGHT, SPEED_20FT)

    def parts_of(gust: Floats) -> dict[str, Floats]:
        """Return the gusts' components along and across the separation, and vertical."""
        return {"along": _component(gust, ahead), "across": _component(gust, aside), "vertical": gust[:, :, 2]}

    first = parts_of(every[:, 0])
    found = {
        "0": {
            name: _ratio(value**2, np.full_like(value, size**2))
            for (name, value), size in zip(first.items(), sigma, strict=True)
        }
    }
    for i, r in enumerate(SEPARATIONS, start=1):
        other = parts_of(every[:, i])
        found[f"{r:g}"] = {
            name: _ratio(first[name] * other[name], 0.5 * (first[name] ** 2 + other[name] ** 2)) for name in first
        }
    return found


def _ratio(above: Floats, below: Floats) -> tuple[float, float]:
    """Return the ratio of the means of two arrays (W, n), and its first-order standard error over W worlds."""
    a, b = above.mean(axis=1), below.mean(axis=1)
    ratio = float(a.mean() / b.mean())
    _, error = mean_and_error((a - ratio * b) / b.mean())
    return ratio, float(error)


def _component(gust: Floats, axis: Floats) -> Floats:
    """Return the component (W, n) of gusts (W, n, 3) along an axis (n, 3)."""
    return np.asarray(np.einsum("wni,ni->wn", gust, axis))


def kept(lifetimes: object) -> Floats:
    """Return the correlation of gusts with later ones in the field's moving frame, after times in lifetimes.

    The autocorrelation of sin^2 over half a turn.
    """
    x = np.minimum(np.abs(np.asarray(lifetimes, float)), 1.0)
    return np.asarray((1.0 - x) * (2.0 + np.cos(2.0 * np.pi * x)) / 3.0 + np.sin(2.0 * np.pi * x) / (2.0 * np.pi))


def travelling(worlds: int, evolution: Evolution = "frozen") -> dict[str, tuple[float, float]]:
    """Return lag [s] -> (correlation, standard error) of gusts with those that the mean wind carries downwind."""
    speed = SPEED_20FT * wind_over_20ft(CARRIED_AT)
    rng = np.random.default_rng(SEED + 1)
    here = np.column_stack([rng.uniform(-500.0, 500.0, (PAIRS, 2)), np.full(PAIRS, -HEIGHT)])
    first = gusts(here, np.zeros(PAIRS), worlds, evolution)
    found = {}
    for lag in LAGS:
        later = gusts(here + np.array([speed * lag, 0.0, 0.0]), np.full(PAIRS, lag), worlds, evolution)
        found[f"{lag:g}"] = _ratio((first * later).sum(axis=2), 0.5 * (first**2 + later**2).sum(axis=2))
    return found


Carried = dict[str, tuple[float, float]]


def _field_checks(
    points: dict[str, dict[str, tuple[float, float]]], frozen: Carried, carried: Carried, worlds: int
) -> list[Check]:
    """Return the checks of the gust field's variances and correlations against closed forms."""
    z = widest_z(sum(len(each) for each in points.values()) + len(carried))
    checks = []
    for r, each in points.items():
        expected = closed(float(r))
        for name, (value, error) in each.items():
            left_out = LEFT_OUT[name == "vertical"]
            what = "variance" if r == "0" else f"correlation at {r} m"
            checks.append(
                Check(
                    f"{what}, {name}",
                    value,
                    expected[name],
                    z * error + left_out,
                    "",
                    f"closed form; {z:.1f} standard errors of the mean of {worlds} worlds, {100 * CONFIDENCE:g} % for"
                    f" all together, and {100 * left_out:g} % of the variance in waves that the field leaves out",
                )
            )
    return (
        checks
        + [
            Check(
                f"travel: correlation of gusts with those {lag} s before and as far upwind as the wind at 20 m, frozen",
                value,
                1.0,
                1e-3,
                "",
                "Taylor's hypothesis; single precision",
            )
            for lag, (value, _) in frozen.items()
        ]
        + [
            Check(
                f"travel: the same of waves with a lifetime, {lag} s",
                value,
                float(kept(float(lag) / LIFETIME)),
                z * error,
                "",
                f"closed form; {z:.1f} standard errors of the mean of {worlds} worlds",
            )
            for lag, (value, error) in carried.items()
        ]
    )


def _run_part(paths: Mapping[str, Path], full: bool) -> Outcome:
    """Simulate gusts at pairs of points, in full or quickly; return the outcome for the report."""
    worlds = WORLDS if full else FEW_WORLDS
    points, frozen, carried = two_points(worlds), travelling(20), travelling(worlds, "lifetime")
    near = points["3"]["along"][0]
    return Outcome(
        method=f"Gusts of {worlds} worlds are taken at {PAIRS} pairs of points in each, {HEIGHT:g} m above the ground,"
        f" in a wind of {SPEED_20FT:g} m/s at 20 ft, in all directions; their variances and correlations are"
        " compared with those that isotropic turbulence of the standard's spectra has.",
        reading=f"Neighbours meet the same air: 3 m apart their gusts are correlated by {near:.2f}, and what one meets"
        " the next one downwind meets a few seconds later, when the wind has carried it there.",
        checks=_field_checks(points, frozen, carried, worlds),
        findings=[],
        pictures=[_draw_correlations(points)],
        numbers={
            "two_points": {
                r: {
                    name: {"value": value, "standard_error": error, "closed_form": closed(float(r))[name]}
                    for name, (value, error) in each.items()
                }
                for r, each in points.items()
            },
            "travel": {
                name: {lag: {"value": value, "standard_error": error} for lag, (value, error) in each.items()}
                for name, each in (("frozen", frozen), ("lifetime", carried))
            },
        },
    )


def _draw_correlations(points: dict[str, dict[str, tuple[float, float]]]) -> Picture:
    """Draw the simulated correlations of gusts at two points over the closed forms."""
    from qrsim.runs.picture import new_figure
    from qrsim.studies.validate.pictures import OTHER, RECORDED, SIMULATED, picture

    figure = new_figure(7.0, 4.4)
    axes = figure.subplots()
    fine = np.geomspace(0.5, 200.0, 200)
    for name, colour in (("along", SIMULATED), ("across", OTHER), ("vertical", RECORDED)):
        axes.plot(fine, [closed(float(r))[name] for r in fine], "--", color=colour, lw=1.0)
        rows = [(float(r), *each[name]) for r, each in points.items() if r != "0"]
        apart, value, error = np.array(rows).T
        axes.errorbar(apart, value, 2.0 * error, fmt="o", ms=4, color=colour, capsize=2, label=name)
    axes.set(xscale="log", xlabel="separation [m]", ylabel="correlation", ylim=(-0.15, 1.1))
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    return picture(
        figure,
        "Correlation of gusts at two points: horizontal ones along and across their separation, and vertical ones; dots"
        " with two standard errors, dashed the closed form.",
    )


PART = Part(
    "wind_field",
    "Gusts of one field",
    "no figure of the paper, with independent gusts for each vehicle: two points of one field",
    (),
    _run_part,
)
