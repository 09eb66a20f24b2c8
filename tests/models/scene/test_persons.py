"""Persons: where they lie, and the rule by which they are found."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.persons import Persons, PersonsState
from qrsim.models.scene.terrain import CLEAR, CLUTTER, OCCLUSION

AREA = cast(BoxArea(-100.0, 100.0, -50.0, 50.0, -80.0, 0.0), np.float32)  # type: ignore[arg-type]


def many(persons: Persons, cells: Any, episodes: int = 200) -> PersonsState:
    """Persons (episodes, P)."""
    persons = cast(persons, np.float32)

    def place(seed: Any) -> PersonsState:
        ids = jnp.arange(persons.most, dtype=jnp.uint32)
        stream = Key.root(jnp.stack([seed, jnp.uint32(0)])).stream("persons", ids)
        return persons.init(Draw(stream, jnp.int32(0), jnp.zeros((), jnp.float32)), cells, AREA)

    found: PersonsState = jax.jit(jax.vmap(place))(jnp.arange(episodes, dtype=jnp.uint32))
    return found


def test_five_to_ten_lie_uniformly_in_the_inner_part() -> None:
    found = many(Persons(), jnp.full((1, 1), CLEAR, jnp.int32), 1000)
    counts = np.asarray(found.there).sum(axis=1)
    assert set(counts) == set(range(5, 11))
    north, east = np.asarray(found.north), np.asarray(found.east)
    assert np.abs(north).max() < 80.0
    assert np.abs(east).max() < 40.0
    # Four standard errors of the variance of 10 000 uniform numbers.
    np.testing.assert_allclose([north.var(), east.var()], [160.0**2 / 12.0, 80.0**2 / 12.0], rtol=4.0 * 0.009)


def test_they_lie_on_the_ground_that_the_chances_say() -> None:
    cells = jnp.asarray(np.random.default_rng(0).choice([CLEAR, CLUTTER, OCCLUSION], (20, 20), p=[0.9, 0.07, 0.03]))
    found = many(Persons(on_clutter=0.3, on_occlusion=0.2), cells.astype(jnp.int32), 400)  # type: ignore[arg-type]
    row = np.floor((np.asarray(found.north) + 100.0) / 10.0).astype(int)
    column = np.floor((np.asarray(found.east) + 50.0) / 5.0).astype(int)
    on = np.asarray(cells)[row, column]
    for number, chance in ((CLEAR, 0.5), (CLUTTER, 0.3), (OCCLUSION, 0.2)):
        assert abs((on == number).mean() - chance) < 4.0 * np.sqrt(chance * (1.0 - chance) / on.size)


@pytest.mark.long
def test_where_there_is_no_such_ground_they_lie_anywhere() -> None:
    found = many(Persons(on_occlusion=1.0), jnp.full((4, 4), CLEAR, jnp.int32))  # type: ignore[arg-type]
    assert np.isfinite(np.asarray(found.north)).all()


def test_a_person_is_found_by_a_slow_vehicle_that_is_near_and_flies() -> None:
    here, absent = [True, True, True, True, False], -1
    state = PersonsState(
        jnp.array([0.0, 30.0, 60.0, 90.0, 0.0]), jnp.zeros(5), jnp.array(here), jnp.array([absent] * 3 + [7, absent])
    )
    # 4.9 m away slowly, 4.9 m away too fast, 5.1 m away, at one found before, and one that has stopped at the second.
    north = jnp.array([4.0, 34.0, 64.2, 90.0, 30.0])
    position = Vec3(north, jnp.zeros(5), -jnp.full(5, 2.83))
    speed, valid = jnp.array([0.1, 0.11, 0.0, 0.0, 0.0]), jnp.array([True, True, True, True, False])
    after = cast(Persons(), np.float32).step(state, position, speed, valid, jnp.int32(50))
    assert list(np.asarray(after.found_tick)) == [50, absent, absent, 7, absent]
    assert list(np.asarray(after.missing())) == [False, True, True, False, False]
    assert list(np.asarray(after.missing(jnp.int32(49)))) == [True, True, True, False, False]
