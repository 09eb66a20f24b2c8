"""Common errors that each receiver has for itself, for studies that need independent ones.

See docs/explanation/gnss_errors.md.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw, Drawn
from qrsim.core.tree import map_tree, quantity, record
from qrsim.models.gnss.budget import ErrorBudget
from qrsim.models.gnss.errors import GaussMarkov2State
from qrsim.models.gnss.slots import Slots

# Pairs of normals, far from those of multipath: two for each satellite's number, and four for all together.
_SIGNAL_PAIRS, _LOCAL_PAIRS, _TOGETHER_PAIR = 1 << 25, 1 << 26, 16


@record
class Apart:
    """Processes of unit variance of n receivers, without the ionosphere's slope over the field."""

    signal: GaussMarkov2State = quantity(doc="(K, n) clock and ephemeris")
    local: GaussMarkov2State = quantity(doc="(K, n) ionosphere of each satellite")
    vertical: GaussMarkov2State = quantity(doc="(n,) vertical ionosphere")
    gradient_north: GaussMarkov2State = quantity(doc="(n,) its gradient, north")
    gradient_east: GaussMarkov2State = quantity(doc="(n,) the same, east")
    troposphere: GaussMarkov2State = quantity(doc="(n,) zenith troposphere")


def _normals(draw: Draw, slots: Slots) -> tuple[list[Drawn], list[Drawn]]:
    """Return standard normals for each satellite's own error processes, and for those that all satellites share."""
    each = [Drawn(draw.normal_pairs(slots.ids + jnp.uint32(first))) for first in (_SIGNAL_PAIRS, _LOCAL_PAIRS)]
    rows = draw.normal_rows(8, first=_TOGETHER_PAIR)
    return each, [Drawn((rows[2 * i], rows[2 * i + 1])) for i in range(4)]


def apart_init(budget: ErrorBudget, draw: Draw, slots: Slots) -> Apart:
    """Return random initial range errors of each satellite at each receiver, in the statistical steady state."""
    each, together = _normals(draw, slots)
    of_each, of_all = budget.processes()
    return Apart(
        *(process.init(drawn) for process, drawn in zip(of_each[:2], each, strict=True)),
        *(process.init(drawn) for process, drawn in zip(of_all, together, strict=True)),
    )


def apart_step(budget: ErrorBudget, state: Apart, draw: Draw, slots: Slots, same: Array, dt: float) -> Apart:
    """Return the range errors dt [s] later; those of a satellite that is new in its slot are drawn again."""
    each, together = _normals(draw, slots)
    of_each, of_all = budget.processes()
    found = []
    for process, before, drawn in zip(of_each[:2], (state.signal, state.local), each, strict=True):
        new = process.init(drawn)
        found.append(map_tree(lambda a, b: jnp.where(same[:, None], a, b), process.step(before, drawn, dt), new))
    states = (state.vertical, state.gradient_north, state.gradient_east, state.troposphere)
    rest = [process.step(s, drawn, dt) for process, s, drawn in zip(of_all, states, together, strict=True)]
    return Apart(*found, *rest)


def apart_at(budget: ErrorBudget, state: Apart, slots: Slots, column: int) -> tuple[Array, Array]:
    """Return range errors (K, n) [m] of code and of carrier phase; ``column`` 0: one frequency, 1: two."""
    sight, scales = slots.sight, slots.scales
    zenith = (scales.troposphere * state.troposphere.error)[None, :]
    signal = scales.signal[:, None] * state.signal.error + sight.troposphere[:, None] * zenith
    plane = (
        sight.pierce_north[:, None] * state.gradient_north.error[None, :]
        + sight.pierce_east[:, None] * state.gradient_east.error[None, :]
    )
    vertical = (scales.vertical[column] * state.vertical.error)[None, :] + scales.gradient[column] * plane
    delay = sight.ionosphere[:, None] * (vertical + scales.local[column] * state.local.error)
    return signal + delay, signal - delay
