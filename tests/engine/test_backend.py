"""Programs by the one interface: the same by both compilers, and what one refuses goes to the other."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.engine import settings
from qrsim.engine.backend import Extent, Function, Specialised, Worlds
from qrsim.engine.layout import Shared
from qrsim.engine.llvm import program as code_generator
from qrsim.engine.programs import forget
from qrsim.errors import CompilerWarning

SINGLE = np.dtype(np.float32)
SHARED = {"gain": np.float32(10.0)}


@pytest.fixture(autouse=True)
def _anew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("QRSIM_COMPILATION_CACHE", "off")
    monkeypatch.setitem(settings._chosen, "compiler", None)
    forget()
    yield
    forget()


@pytest.fixture(params=["llvm", "xla"])
def compiler(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("QRSIM_COMPILER", request.param)
    return str(request.param)


def first(shared: Any, own: Any) -> Any:
    """Return x = gain + what is given, of one world, and the tick at which it was last advanced."""
    return {"x": shared["gain"] + own[1], "tick": jnp.int32(-1)}


def following(shared: Any, own: Any, state: Any, tick: Any) -> Any:
    """Add the number of the tick, the world's own constant and what is given."""
    pushes = [push.astype(jnp.float32) for push in jax.tree.leaves(own)]
    return {"x": state["x"] + tick.astype(jnp.float32) + sum(pushes, jnp.float32(0.0)), "tick": tick}


def sorting(shared: Any, own: Any, state: Any, tick: Any) -> Any:
    """Do the same, in a way that the package's own code generator does not take."""
    return following(shared, own, state, tick) | {"x": jnp.sort(following(shared, own, state, tick)["x"])}


START, TICK, SORT = Function("first", first), Function("following", following), Function("sorting", sorting)


def given(*numbers: float) -> Any:
    return np.array(numbers, np.float32)[:, None]


def worlds(count: int, tick: Function = TICK, constant: Any = ()) -> Worlds:
    return Worlds(START, tick, SHARED, Extent(1, SINGLE, count), constant)


def x_of(some: Worlds) -> list[float]:
    return np.asarray(some.get(lambda state: state["x"])).ravel().tolist()


def test_worlds_start_and_advance(compiler: str) -> None:
    """Three ticks from number 4 on: 4 + 5 + 6, three times a constant of 0.25 or 0.5, and three pushes of 1."""
    some = worlds(2, constant=[given(0.25, 0.5)])
    assert not some.started
    some.begin(given(1.0, 2.0))
    assert x_of(some) == [11.0, 12.0]
    some.advance(4, 3, given(1.0, 1.0))
    assert x_of(some) == [11.0 + 15.0 + 0.75 + 3.0, 12.0 + 15.0 + 1.5 + 3.0]
    assert some.get(lambda state: state["tick"]).tolist() == [6, 6]
    # Given nothing, which is another program; and then as before.
    some.advance(7, 1, ())
    some.advance(8, 1, given(-8.0, 0.0))
    assert x_of(some) == [29.75 + 7.25 + 0.25, 31.5 + 7.5 + 8.5]
    assert (some.compiler, some.refused) == (compiler, "")
    doubled = some.map(lambda state: 2.0 * state["x"], lambda state: state)
    assert np.asarray(doubled).ravel().tolist() == [74.5, 95.0]


def test_long_flights_of_worlds_in_several_vectors(compiler: str) -> None:
    """The ticks 0 to 4999 add up to 12 497 500, which single precision holds exactly."""
    some = worlds(35)
    some.begin(given(*range(35)))
    some.advance(0, 5000, ())
    assert x_of(some) == [10.0 + number + 12_497_500.0 for number in range(35)]


def test_some_start_again_and_the_others_go_on(compiler: str) -> None:
    """35 worlds, which with XLA are started two at a time, and side by side in lanes with machine code."""
    some = worlds(35)
    every = np.arange(35)
    some.prepare(given(0.0), given(0.0))
    begun = some.begin_some(every, given(*range(35)), lambda state: state["x"])
    assert begun.ravel().tolist() == [10.0 + number for number in range(35)]
    some.advance(0, 1, given(*([1.0] * 35)))
    again = some.begin_some(np.array([3, 30, 7]), given(0.5, 1.5, 2.5), lambda state: (state["x"], state["tick"]))
    assert again[0].ravel().tolist() == [10.5, 11.5, 12.5]
    assert again[1].tolist() == [-1, -1, -1]
    expected = [11.0 + number for number in range(35)]
    expected[3], expected[30], expected[7] = 10.5, 11.5, 12.5
    assert x_of(some) == expected
    # As many, others and fewer again, of the same program: what they were given last time is not taken.
    once = some.begin_some(np.array([34, 0]), given(4.0, 6.0), lambda state: state["x"])
    expected[34], expected[0] = 14.0, 16.0
    assert (once.ravel().tolist(), x_of(some)) == ([14.0, 16.0], expected)
    # What the start before returned is the caller's.
    assert again[0].ravel().tolist() == [10.5, 11.5, 12.5]
    # More than a vector of them, and then one.
    most = some.begin_some(every[:20], given(*range(100, 120)), lambda state: state["x"])
    expected[:20] = [110.0 + number for number in range(20)]
    one = some.begin_some(np.array([19]), given(-10.0), lambda state: state["x"])
    expected[19] = 0.0
    assert (most.ravel().tolist(), one.ravel().tolist()) == ([110.0 + number for number in range(20)], [0.0])
    assert x_of(some) == expected
    other = worlds(35)
    other.prepare(given(0.0), given(0.0))
    other.restore(jax.tree.map(np.array, some.get(lambda state: state)))
    other.advance(0, 1, given(*([0.0] * 35)))
    assert x_of(other) == expected


def test_one_world(compiler: str) -> None:
    shared, extent = Shared.of(SHARED), Extent(1, SINGLE)
    start = Specialised(START, shared, extent, compiler).program(np.float32([1.0]))
    state, layout = start.start(), start.layout
    ticks = Specialised(TICK, shared, extent, compiler)
    state = ticks.program((), layout).run(state, 1, 2)
    assert layout is not None
    assert layout.unpack(state)["x"].tolist() == [14.0]
    state, rows = ticks.program(np.float32([0.5]), layout).record(state, 0, 3, 5)
    assert layout.unpack(rows)["x"].tolist() == [[14.5], [16.0], [18.5]]
    assert layout.unpack(state)["x"].tolist() == [18.5]
    # A user's command may be of the other kind of numbers; it is another program, not another meaning of the bits.
    state = ticks.program(np.int32([2]), layout).run(state, 0, 1)
    assert layout.unpack(state)["x"].tolist() == [20.5]


def test_what_is_refused_goes_to_xla_with_one_warning(caplog: pytest.LogCaptureFixture) -> None:
    some = worlds(2, SORT)
    some.begin(given(1.0, 2.0))
    assert some.compiler == "llvm"
    with caplog.at_level(logging.DEBUG, "qrsim.engine"), pytest.warns(CompilerWarning) as warned:
        some.advance(1, 2, ())
    assert len(warned) == 1
    assert "'sort'" in str(warned[0].message)
    assert "test_backend.py" in str(warned[0].message)
    assert "'sorting' is compiled by XLA, because of" in caplog.text
    assert x_of(some) == [14.0, 15.0]
    assert some.compiler == "xla"
    assert "'sort'" in some.refused
    # What starts again does so by the compiler that flies it.
    some.begin(given(1.0, 2.0))
    some.advance(1, 2, ())
    assert x_of(some) == [14.0, 15.0]


def test_both_functions_are_of_one_compiler_where_they_are_prepared() -> None:
    some = worlds(2, SORT)
    with pytest.warns(CompilerWarning, match="'sort'") as warned:
        some.prepare(given(0.0), ())
    assert len(warned) == 1
    some.begin_some(np.arange(2), given(1.0, 2.0), lambda state: state)
    assert isinstance(some.get(lambda state: state["x"]), jax.Array)


def test_a_fault_of_the_code_generator_goes_to_xla_with_one_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(text: str, tier: str) -> bytes:
        raise RuntimeError("a fault for a test")

    monkeypatch.setattr(code_generator, "machine_code", fails)
    some = worlds(2)
    with pytest.warns(CompilerWarning, match=r"RuntimeError: a fault for a test") as warned:
        some.begin(given(1.0, 2.0))
    assert len(warned) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        some.advance(1, 2, ())
    assert x_of(some) == [14.0, 15.0]
    assert "an error of the code generator itself" in some.refused
    # Another start in this process: the reason is kept, and nobody is told twice.
    other = worlds(2)
    other.begin(given(1.0, 2.0))
    assert other.refused == some.refused


def test_what_goes_wrong_in_a_function_is_its_authors(compiler: str) -> None:
    def fails(shared: Any, own: Any) -> Any:
        raise KeyError("a mistake of its author")

    some = Worlds(Function("fails", fails), TICK, SHARED, Extent(1, SINGLE, 2))
    with pytest.raises(KeyError, match="a mistake of its author"):
        some.begin(given(1.0, 2.0))
