"""The ratios of a picture's own windows alone (docs/explanation/models/sensors.md).

``Camera.develop`` computes every window that the largest picture could have, which suits a compiler that handles whole
arrays. A picture from 25 m has a tenth of them. Here a loop goes through the rows of each picture piece by piece, and
takes as many turns as the pictures have pieces. The numbers are the same.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.noise import Stream
from qrsim.models.scene.contents import Surroundings
from qrsim.models.sensors.person_classifier import Close

# Windows that are computed at once. More of them do not fit into registers, and fewer leave the processor waiting.
COLUMNS = 32
# Beyond this times ``near`` no rounding makes a distance shorter than ``near``.
MARGIN = 1.001


class _Shown(NamedTuple):
    """Windows of each picture (n, Q) in which a missing person is nearest, and rows (n,) that all of them lie in."""

    row: Array
    column: Array
    wins: Array
    first: Array
    last: Array


def ratios(camera: Any, reading: Any, around: Surroundings, stream: Stream, size: Array, to: Array) -> Any:
    """Return the log-likelihood ratios (n, R, C) of the last pictures' ground windows; 0 outside a picture's grid.

    Args:
        camera: a ``Camera`` of vehicles (n,).
        reading, around, stream, size: see ``Camera.develop``.
        to: zeros (n, R, C).
    """
    own = camera.for_each(reading)
    tick = camera.tick_of(reading, around)
    view = jax.vmap(lambda each, one: each.view(one, around, size))(own, reading)
    # A vehicle that has stopped has no pose, and its picture no window.
    finite = jnp.isfinite(view.rows + view.columns)
    rows, columns = (jnp.where(finite, part, 0.0).astype(jnp.int32) for part in (view.rows, view.columns))
    shown = _persons(own, view, around, tick, size)
    every = jnp.arange(camera.most_columns).astype(to.dtype)
    vehicles, wide = to.shape[0], min(COLUMNS, camera.most_columns)
    # No window is nearer than the height of the camera.
    least = jnp.minimum(jnp.abs(view.position.z), own.classifier.range_limit)
    low = least <= MARGIN * own.classifier.near
    right = jax.vmap(lambda each, seen: each.right(each.middle(seen, 0.0, every)[0]))(own, view)

    def turn(now: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        """Return the loop's state with one more block of windows computed, a part of a row of one picture."""
        vehicle, row, left, found = now
        # The last piece of the longest row ends with it.
        left_most = jnp.minimum(left, camera.most_columns - wide)
        column = left_most + jnp.arange(wide, dtype=jnp.int32)
        one, seen = (jax.tree.map(lambda leaf: leaf[vehicle], part) for part in (own, view))
        noise = jnp.zeros(wide, to.dtype)
        if camera.noisy:
            window, count = row * camera.most_columns + column, camera.most_rows * camera.most_columns
            noise = _noise(Stream(stream.high, stream.low, stream.ids[vehicle]), tick[vehicle], window, to, count)
        present = jnp.zeros(wide, bool)
        if shown is not None:
            present = _present(_Shown(*(part[vehicle] for part in shown)), row, column)
        ahead = one.ahead(one.middle(seen, row.astype(to.dtype), 0.0)[1]) + 0.0
        middle = one.shown(seen, lax.dynamic_slice(right, (vehicle, left_most), (1, wide))[0], ahead)
        ratio = one.ratio(seen, around, middle, present, noise, partial(_close, one.classifier, low[vehicle]))
        inside = (row < rows[vehicle]) & (column < columns[vehicle])
        ratio = jnp.where(inside & jnp.isfinite(ratio), ratio, 0.0)
        found = lax.dynamic_update_slice(found, ratio[None, None], (vehicle, row, left_most))
        over = left + wide >= columns[vehicle]
        last = over & (row + 1 >= rows[vehicle])
        row = jnp.where(last, 0, jnp.where(over, row + 1, row))
        return jnp.where(last, vehicle + 1, vehicle), row, jnp.where(over, 0, left + wide), found

    zero = jnp.int32(0)
    return lax.while_loop(lambda now: now[0] < vehicles, turn, (zero, zero, zero, to))[3]


def _close(classifier: Any, low: Array, distance: Array) -> Close:
    """Return ``PersonClassifier.close``, computed only where the camera is so low () that it matters."""
    beyond = Close(jnp.zeros_like(distance), jnp.ones_like(distance))
    found: Close = lax.cond(low, classifier.close, lambda _: beyond, distance)
    return found


def _noise(stream: Stream, tick: Array, window: Array, like: Array, count: int) -> Array:
    """Return standard normals for windows by their numbers, any shape, the same as ``Draw.normal_rows`` gives."""
    half = (count + 1) // 2
    pairs = jnp.where(window < half, window, window - half).astype(jnp.uint32)
    return stream.normals_of(tick, pairs, window >= half, like.dtype)


def _persons(own: Any, view: Any, around: Surroundings, tick: Array, size: Array) -> _Shown | None:
    """Return the windows in each picture that show persons not found yet; None in a world without persons."""
    persons = around.state.persons
    if persons is None:
        return None
    count, points = tick.shape[0], 9 * persons.north.shape[0]
    none = jnp.zeros((count, points), jnp.int32)
    nothing = _Shown(none, none, none > 0, none[:, 0], none[:, 0])

    def look() -> _Shown:
        """Return, for each picture, the windows that show persons."""
        row, column, wins = jax.vmap(lambda each, seen, now: each.winners(seen, persons, now, size))(own, view, tick)
        first = jnp.min(jnp.where(wins, row, own.most_rows), axis=1)
        last = jnp.max(jnp.where(wins, row, -1), axis=1)
        return _Shown(row, column, wins, first, last)

    # Most pictures show nobody.
    anybody = jax.vmap(lambda each, seen, now: each.shows(seen, persons, now))(own, view, tick)
    return lax.cond(jnp.any(anybody), look, lambda: nothing)


def _present(shown: _Shown, row: Array, column: Array) -> Array:
    """Return (C,) bool: in this window of row ``row`` () the nearest person has not been found yet."""

    def compare() -> Array:
        """Return the flags (C,) of ``_present``, by comparing the row's windows with those of all persons."""
        here = shown.wins & (shown.row == row)
        return jnp.any(here[:, None] & (shown.column[:, None] == column[None]), axis=0)

    among = (row >= shown.first) & (row <= shown.last)
    return lax.cond(among, compare, lambda: jnp.zeros(column.shape, bool))
