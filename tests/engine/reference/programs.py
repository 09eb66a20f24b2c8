"""Random programs over every primitive that the code generator takes, and over some that it does not."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from qrsim.core.fastmath import rounded
from qrsim.core.nearest import nearest_squared
from qrsim.core.primitives import KERNELS
from qrsim.core.symmetric import Term, lowered, size_of, times, transformed

SIZES = (1, 2, 3, 5, 8, 16, 17, 21)
_MODES = ("clip", "fill", "drop", "promise_in_bounds")


class Draw:
    """A program under construction: arrays by kind of number ("f", "i", "u", "b"), from which more are made.

    Args:
        choose: numbers at random, as of ``random.Random``.
        pool: the arrays to begin with.
        size: the extent that most axes have.
    """

    def __init__(self, choose: random.Random, pool: dict[str, list[Any]], size: int):
        self.choose, self.pool, self.size = choose, pool, size
        self.floats, self.words = pool["f"][0].dtype, pool["i"][0].dtype

    def put(self, *arrays: Any) -> None:
        """Add arrays."""
        for array in arrays:
            self.pool[{"f": "f", "i": "i", "u": "u", "b": "b"}[np.dtype(array.dtype).kind]].append(array)

    def some(self, kind: str, shape: tuple[int, ...] | None = None, axes: int = 0) -> Any:
        """Return an array of a kind, of a shape or with so many axes at least; often one that was made lately."""
        found = [a for a in self.pool[kind] if a.ndim >= axes and (shape is None or a.shape == shape)]
        if not found:
            return self.shaped(self.choose.choice(self.pool[kind]), shape or (self.size,) * axes)
        return self.choose.choice(found[-4:] if self.choose.random() < 0.4 else found)

    def shaped(self, array: Any, shape: tuple[int, ...]) -> Any:
        """Return numbers of an array in another shape."""
        if array.shape == shape:
            return array
        if array.ndim == 0 or (array.ndim == 1 and shape and array.shape[0] in (1, shape[-1])):
            return jnp.broadcast_to(array, shape)
        flat = array.reshape(-1)
        return lax.broadcast_in_dim(flat[self.choose.randrange(flat.shape[0])], shape, ())

    def like(self, array: Any, kind: str | None = None) -> Any:
        """Return an array of the same shape, of a kind (default: the same)."""
        return self.shaped(self.some(kind or np.dtype(array.dtype).kind, None), array.shape)

    def tame(self, array: Any, limit: float = 4.0) -> Any:
        """Return numbers brought into a range."""
        return jnp.clip(array, -limit, limit)

    def place(self, shape: tuple[int, ...]) -> Any:
        """Return whole numbers about the range of an index, some of them out of it."""
        return self.shaped(self.some("i"), shape) % (self.size + 3) - 1


Maker = Callable[[Draw], None]
_TWO = {"add": lax.add, "sub": lax.sub, "mul": lax.mul, "div": lax.div, "rem": lax.rem, "max": lax.max, "min": lax.min}
_BITS = {"and": lax.bitwise_and, "or": lax.bitwise_or, "xor": lax.bitwise_xor}
_COMPARE = {"eq": lax.eq, "ne": lax.ne, "lt": lax.lt, "le": lax.le, "gt": lax.gt, "ge": lax.ge}
_SHIFT = (lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic)
_PLAIN = (lax.neg, lax.abs, lax.sign, lax.square)
_STEPS = (lax.floor, lax.ceil, lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO),
          lambda x: lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN))  # fmt: skip
_SMOOTH = (lax.sin, lax.cos, lax.tanh, lax.atan, jnp.exp, jnp.exp2, jnp.expm1, lax.sinh, lax.cosh, lax.tan, lax.sqrt,
           lax.rsqrt, lax.log, lax.log1p, lax.asin, lax.acos)  # fmt: skip


def _arithmetic(draw: Draw) -> None:
    kind = draw.choose.choice("ffffiu")
    a = draw.some(kind)
    draw.put(draw.choose.choice(list(_TWO.values()))(a, draw.like(a)))


def _sums_of_products(draw: Draw) -> None:
    a = draw.some("f")
    b, c, d = (draw.like(a) for _ in range(3))
    sign = draw.choose.choice((1.0, -1.0))
    draw.put(draw.choose.choice([
        lambda: a * b + c * d, lambda: a * b - c * d, lambda: a * b - b * a, lambda: a * b + c, lambda: c - a * b,
        lambda: (a * b) - jnp.max(a * b) * sign, lambda: rounded(a * b) + c, lambda: a * b + rounded(c * d),
        lambda: a * a + b * b + c * c, lambda: (p := a * b) - lax.max(p, c),
    ])())  # fmt: skip


def _unary(draw: Draw) -> None:
    kind = draw.choose.choice("ffi")
    draw.put(draw.choose.choice(_PLAIN)(draw.some(kind)))


def _unsigned(draw: Draw) -> None:
    a = draw.some("u")
    b = draw.like(a)
    draw.put(draw.choose.choice([
        lambda: a + b, lambda: a * b, lambda: lax.rem(a, b), lambda: lax.div(a, b), lambda: lax.max(a, b),
        lambda: lax.sign(a), lambda: jnp.where(a > b, a, b), lambda: lax.clamp(a, b, lax.max(a, b)),
    ])())  # fmt: skip


def _steps(draw: Draw) -> None:
    x = draw.some("f")
    draw.put(draw.choose.choice(_STEPS)(x), lax.is_finite(x))


def _library(draw: Draw) -> None:
    draw.put(draw.choose.choice(_SMOOTH)(draw.some("f")))


def _powers(draw: Draw) -> None:
    x = draw.some("f")
    y = draw.tame(draw.like(x))
    draw.put(draw.choose.choice([
        lambda: lax.pow(x, y), lambda: lax.pow(lax.abs(x), y), lambda: lax.atan2(x, y),
        lambda: lax.integer_pow(x, draw.choose.choice((0, 1, 2, 3, 4, 5, -1, -2, -3))),
        lambda: lax.integer_pow(draw.some("i"), draw.choose.choice((0, 2, 3))),
    ])())  # fmt: skip


def _divisions(draw: Draw) -> None:
    x = draw.some("f")
    known = draw.choose.choice((3.0, 0.1, 1e-40, 1e38, 2.0**127, 0.0, float("inf"), 49.0, 0.25))
    shared = draw.shaped(draw.pool["f"][0], x.shape)
    draw.put(x / draw.choose.choice([jnp.asarray(known, x.dtype), shared]))
    i = draw.some("i")
    draw.put(draw.choose.choice((lax.div, lax.rem))(i, draw.choose.choice([draw.like(i), jnp.full_like(i, 7)])))


def _integers(draw: Draw) -> None:
    kind = draw.choose.choice("iu")
    a = draw.some(kind)
    draw.put(draw.choose.choice([*_BITS.values(), *_SHIFT])(a, draw.like(a)))
    draw.put(lax.shift_left(a, jnp.full_like(a, draw.choose.choice((0, 3, 31, 32)))), lax.bitwise_not(a))


def _logic(draw: Draw) -> None:
    a = draw.some("b")
    draw.put(draw.choose.choice(list(_BITS.values()))(a, draw.like(a)), lax.bitwise_not(a))


def _comparisons(draw: Draw) -> None:
    kind = draw.choose.choice("ffiub")
    a = draw.some(kind)
    draw.put(draw.choose.choice(list(_COMPARE.values()))(a, draw.like(a)))


def _choices(draw: Draw) -> None:
    kind = draw.choose.choice("fffiub")
    a = draw.some(kind)
    draw.put(jnp.where(draw.like(a, "b"), a, draw.like(a)))


def _clamps(draw: Draw) -> None:
    a = draw.some(draw.choose.choice("ffi"))
    low = draw.like(a)
    draw.put(lax.clamp(low, a, lax.max(low, draw.like(a))), jnp.clip(a, -1, 2))


def _conversions(draw: Draw) -> None:
    kind = draw.choose.choice("ffiub")
    to = draw.choose.choice([draw.floats, draw.words, jnp.uint32, jnp.bool_])
    x = draw.some(kind)
    if kind == "f" and draw.choose.random() < 0.3:
        x = x * jnp.asarray(1e9, x.dtype)
    draw.put(lax.convert_element_type(x, to))


def _bits(draw: Draw) -> None:
    if draw.floats == jnp.float32:
        draw.put(lax.bitcast_convert_type(draw.some("f"), draw.choose.choice((jnp.int32, jnp.uint32))))
        whole = draw.choose.choice([0x3F800000 + draw.some("i") % 99, draw.some("i")])
        draw.put(lax.bitcast_convert_type(whole, jnp.float32))
    draw.put(lax.bitcast_convert_type(draw.some("u"), jnp.int32).astype(draw.words))


def _reductions(draw: Draw) -> None:
    kind = draw.choose.choice("fffiub")
    x = draw.some(kind, axes=1)
    axes = tuple(sorted(draw.choose.sample(range(x.ndim), draw.choose.randint(1, x.ndim))))
    if kind == "b":
        draw.put(draw.choose.choice((jnp.any, jnp.all))(x, axes))
    else:
        one = {"f": 1.0, "i": 1, "u": 1}[kind]
        near = jnp.where(x == x, jnp.clip(x, -one if kind != "u" else 0, one), x)
        draw.put(draw.choose.choice([
            lambda: jnp.sum(x, axes, dtype=x.dtype), lambda: lax.reduce_prod(near, axes), lambda: jnp.max(x, axes),
            lambda: jnp.min(x, axes),
        ])())  # fmt: skip


def _places_of_extremes(draw: Draw) -> None:
    x = draw.some(draw.choose.choice("ffib"), axes=1)
    axis = draw.choose.randrange(x.ndim)
    how = draw.choose.choice((lax.argmax, lax.argmin))
    place = how(x, axis, draw.words)
    draw.put(place)
    if x.ndim == 1:
        draw.put(draw.choose.choice((x[place], x.at[place].get(mode=draw.choose.choice(_MODES[:2])))))


def _running(draw: Draw) -> None:
    x = draw.some(draw.choose.choice("ffi"), axes=1)
    how = draw.choose.choice((lax.cumsum, lax.cumprod, lax.cummax, lax.cummin))
    if how is lax.cumprod:
        x = jnp.clip(x, -1, 1)
    draw.put(how(x, draw.choose.randrange(x.ndim), reverse=draw.choose.random() < 0.5))


def _shapes(draw: Draw) -> None:
    kind = draw.choose.choice("ffib")
    x = draw.some(kind, axes=1)
    found = draw.choose.choice([
        lambda: x.reshape(-1), lambda: x.reshape(x.shape[::-1]), lambda: x.T, lambda: x[None], lambda: x[..., None, :],
        lambda: jnp.squeeze(x), lambda: x[..., : max(1, x.shape[-1] // 2)], lambda: x[..., -1:], lambda: x[0],
        lambda: jnp.broadcast_to(x[..., :1], x.shape), lambda: x[None, ..., 0],
        lambda: jnp.expand_dims(x, x.ndim), lambda: x[x.shape[0] // 2 :],
    ])()  # fmt: skip
    if found.ndim <= 3 and found.size:
        draw.put(found)


def _joining(draw: Draw) -> None:
    x = draw.some(draw.choose.choice("ffib"), axes=1)
    if x.ndim > 2 or x.size > 200:
        return
    y = draw.like(x)
    axis = draw.choose.randrange(x.ndim)
    parts = [x, y, x[:1] if axis == 0 else x]
    draw.choose.shuffle(parts)
    found = jnp.concatenate(parts, axis)
    draw.put(*jnp.unstack(found, axis=axis)[:2])
    if x.size < 50:
        draw.put(jnp.tile(y, (2,) * y.ndim))
    draw.put(jnp.stack([x, y, x], draw.choose.randrange(x.ndim + 1)), found)
    draw.put(*jnp.split(found, [1, max(2, found.shape[axis] // 2)], axis)[1:2] if found.shape[axis] > 3 else ())


def _counting(draw: Draw) -> None:
    shape = draw.choose.choice([(draw.size,), (2, draw.size), (draw.size, 2), (1,)])
    dtype = draw.choose.choice([draw.words, jnp.uint32, draw.floats])
    draw.put(lax.broadcasted_iota(dtype, shape, draw.choose.randrange(len(shape))))


def _parts_from_anywhere(draw: Draw) -> None:
    x = draw.some(draw.choose.choice("ffib"), axes=1)
    starts = [draw.shaped(draw.some("i"), ()) for _ in x.shape]
    sizes = [draw.choose.choice((1, max(1, extent // 2), extent)) for extent in x.shape]
    draw.put(lax.dynamic_slice(x, starts, sizes))


def _gathers(draw: Draw) -> None:
    x = draw.some(draw.choose.choice("fffiub"), axes=1)
    shape = draw.choose.choice([(), (draw.size,), (2,), (2, draw.size)])
    index = tuple(draw.place(shape) for _ in x.shape)
    mode = draw.choose.choice(_MODES)
    if mode == "promise_in_bounds":
        index = tuple(jnp.abs(i) % extent for i, extent in zip(index, x.shape, strict=True))
    if draw.choose.random() < 0.2:
        index = tuple(i.astype(jnp.uint32) for i in index)
    fill = {"f": 0.25, "i": -7, "u": 7, "b": False}[np.dtype(x.dtype).kind]
    more = {"fill_value": fill} if mode == "fill" and draw.choose.random() < 0.5 else {}
    draw.put(x.at[index].get(mode=mode, **more))
    if x.ndim == 2 and draw.choose.random() < 0.5:
        along = draw.place(x.shape[:1])[:, None]
        draw.put(jnp.take_along_axis(x, along, 1, mode=draw.choose.choice(("clip", "fill")))[:, 0])


def _scatters(draw: Draw) -> None:
    x = draw.some(draw.choose.choice("fffi"), axes=1)
    shape = draw.choose.choice([(), (draw.size,), (3,)])
    index = tuple(draw.place(shape) for _ in x.shape)
    mode = draw.choose.choice(("clip", "drop", "drop", "promise_in_bounds"))
    if mode == "promise_in_bounds":
        index = tuple(jnp.abs(i) % extent for i, extent in zip(index, x.shape, strict=True))
    new = draw.shaped(draw.some(np.dtype(x.dtype).kind), shape)
    how = draw.choose.choice(("set", "add", "min", "max", "multiply"))
    draw.put(getattr(x.at[index], how)(new, mode=mode))


def _segments(draw: Draw) -> None:
    x = draw.some("f", axes=1)
    if x.ndim == 1:
        draw.put(jax.ops.segment_sum(x, draw.place(x.shape), draw.size), jnp.linalg.norm(x))


def _branches(draw: Draw) -> None:
    x = draw.some("f")
    y, z = draw.like(x), draw.some("i")
    which = draw.choose.choice([draw.shaped(draw.some("b"), ()), draw.shaped(draw.some("i"), ()) > 0])
    kind = draw.choose.randrange(3)

    def first() -> Any:
        return (x * y + x, z) if kind else (y, z + 1)

    def second() -> Any:
        return lax.cond(jnp.sum(z) % 2 == 0, lambda: (y - x, z * 3), lambda: (x, z)) if kind == 2 else (x, z - 1)

    draw.put(*lax.cond(which, first, second))


def _loops(draw: Draw) -> None:
    x = draw.some("f")
    y, turns = draw.like(x), jnp.abs(draw.shaped(draw.some("i"), ())) % 5
    kind = draw.choose.randrange(4)

    def body(carry: Any) -> Any:
        left, a, b, total = carry
        if kind == 0:
            a, b = b, a * 0.5
        elif kind == 1:
            a = jnp.where(a > b, a, b + 0.25)
        elif kind == 2 and a.ndim == 1:
            a = a.at[left % a.shape[0]].add(b[0])
        else:
            b = lax.cond(left % 2 == 0, lambda: b + a, lambda: b)
        return left - 1, a, b, total + left

    left, a, b, total = lax.while_loop(lambda carry: carry[0] > 0, body, (turns, x, y, jnp.zeros((), draw.words)))
    draw.put(left, a, b, total)


def _counted_loops(draw: Draw) -> None:
    """Make a loop of a fixed number of turns: few are written out, more are a loop."""
    x = draw.some("f")
    y, turns, kind = draw.like(x), draw.choose.randrange(8), draw.choose.randrange(3)

    def body(turn: Any, carry: Any) -> Any:
        a, b, total = carry
        if kind == 0:
            a, b = b, a * 0.5
        elif kind == 1:
            a = jnp.where(a > b, a, b + 0.25 * turn.astype(x.dtype))
        else:
            b = lax.cond(turn % 2 == 0, lambda: b + x, lambda: b)
        return a, b, total + turn.astype(draw.words)

    draw.put(*lax.fori_loop(0, turns, body, (x, y, jnp.zeros((), draw.words))))


def _nested_loops(draw: Draw) -> None:
    turns, x = jnp.abs(draw.shaped(draw.some("i"), ())) % 4, draw.shaped(draw.some("f"), ())

    def outer(carry: Any) -> Any:
        left, value = carry
        # Without a limit of its own for worlds that do not take this branch.
        count = lax.cond(
            left % 2 == 0,
            lambda: lax.while_loop(lambda c: c != left, lambda c: c + 1, jnp.zeros((), draw.words)),
            lambda: left,
        )
        return left - 1, value + count.astype(value.dtype)

    draw.put(*lax.while_loop(lambda carry: carry[0] > 0, outer, (turns, x)))


def _neighbours(draw: Draw) -> None:
    x = draw.some("f", (draw.size,))
    y, z = draw.like(x), draw.like(x)
    reach = jnp.asarray(draw.choose.choice((0.3, 1.0, 50.0)), x.dtype)
    if draw.choose.random() < 0.3:
        count = draw.choose.choice((128, 144))
        spread = jnp.arange(count, dtype=x.dtype) % 13
        x, y, z = (spread * f + jnp.resize(part, (count,)) for f, part in ((1.0, x), (-2.0, y), (0.5, z)))
        # What is put back is as short as the rest.
        draw.put(lax.min(nearest_squared(x, y, z, reach), reach * reach)[: draw.size])
        return
    draw.put(lax.min(nearest_squared(x, y, z, reach), reach * reach))


def _halves(draw: Draw) -> None:
    """Make a half of a symmetric matrix, and let one or two operations follow each other on it."""
    size = draw.choose.choice((2, 3, 5))
    first = draw.some("f", (draw.size,))
    half = jnp.stack([draw.tame(draw.like(first)) for _ in range(size * (size + 1) // 2)])
    for _ in range(draw.choose.randrange(1, 3)):
        half = draw.choose.choice((_lowered_half, _transformed_half))(draw, half, first)
        draw.put(times(half, _factors(draw, size, first)), half)


def _factors(draw: Draw, size: int, like: Any) -> dict[int, Any]:
    """Return numbers by their rows; some are one, which costs nothing."""
    rows = draw.choose.sample(range(size), draw.choose.randint(1, size))
    return {row: jnp.ones_like(like) if draw.choose.random() < 0.2 else draw.tame(draw.like(like)) for row in rows}


def _lowered_half(draw: Draw, half: Any, like: Any) -> Any:
    """Return the half minus the outer products of columns, of which one may be the matrix's own."""
    size = size_of(half.shape[0])
    column = jnp.stack([draw.tame(draw.like(like)) for _ in range(size)])
    own = times(half, _factors(draw, size, like))
    return lowered(half, draw.choose.choice(([column], [own], [column, own], [own, column, 0.25 * own])))


def _transformed_half(draw: Draw, half: Any, like: Any) -> Any:
    """Return F P F' + Q, by factors and by known numbers."""
    size, scales = size_of(half.shape[0]), (1.0, -1.0, 0.25, 0.1)
    factors = [draw.tame(draw.like(like)) for _ in range(2)]
    above = [(i, j) for i in range(size) for j in range(i + 1, size)]
    places = sorted(draw.choose.sample(above, draw.choose.randint(0, min(4, len(above)))))
    terms = [Term(i, j, draw.choose.choice(scales), draw.choose.choice((None, 0, 1))) for i, j in places]
    return transformed(half, terms, factors, _factors(draw, size, like))


def _kernels(draw: Draw) -> None:
    words = draw.some("u", (draw.size,))
    for kernel in KERNELS.values():
        if "float32" in (*kernel.takes, *kernel.gives) and draw.floats != np.float32:
            continue
        # Scalars among the arguments are spread.
        arguments = [
            draw.like(words, "u" if kind == "uint32" else "f")
            if i % 2
            else draw.some("u" if kind == "uint32" else "f", ())
            for i, kind in enumerate(kernel.takes)
        ]
        for result in kernel(*arguments):
            draw.put(
                draw.tame(result) if np.dtype(result.dtype).kind == "f" and draw.floats == result.dtype else result
            )


def _derivatives(draw: Draw) -> None:
    x = draw.some("f", (draw.size,))
    y = draw.like(x)
    draw.put(jax.grad(lambda v: jnp.sum(v * v * y + rounded(v * y)))(x))
    draw.put(jax.vmap(lambda a, b: a * b + jnp.where(a > b, a, 1.0))(x, y))
    draw.put(jax.checkpoint(lambda v: v * 2.0 + y)(x), _CUSTOM[0](x), _CUSTOM[1](x))
    draw.put(lax.optimization_barrier(x), lax.stop_gradient(y), jnp.array(x, copy=True))


@jax.custom_jvp
def _with_own_derivative(x: Any) -> Any:
    return x * 0.5


_with_own_derivative.defjvp(lambda primals, tangents: (_with_own_derivative(*primals), tangents[0]))


@jax.custom_vjp
def _with_own_gradient(x: Any) -> Any:
    return x + 0.25


_with_own_gradient.defvjp(lambda x: (_with_own_gradient(x), None), lambda kept, given: (given,))
_CUSTOM = (_with_own_derivative, _with_own_gradient)


def _handed_over(draw: Draw) -> None:
    """Make something that is XLA's to compute."""
    x = draw.some("f", (draw.size,))
    draw.put(draw.choose.choice([
        lambda: jnp.sort(x), lambda: jnp.outer(x, x) @ x, lambda: lax.scan(lambda c, v: (c + v, c), x[0], x)[1],
        lambda: x[::-1], lambda: jnp.pad(x, 1), lambda: lax.reduce_precision(x, 5, 10),
        lambda: x.astype(jnp.float16).astype(x.dtype), lambda: jnp.stack([x, x])[draw.place((2,))].sum(0),
        lambda: x.at[0].apply(jnp.sin), lambda: lax.nextafter(x, x + 1.0), lambda: x[::2],
        lambda: lax.switch(draw.shaped(draw.some("i"), ()), [lambda: x, lambda: x + 1.0, lambda: x * 2.0]),
    ])())  # fmt: skip


MAKERS: tuple[Maker, ...] = (
    _arithmetic, _sums_of_products, _unary, _unsigned, _steps, _library, _powers, _divisions, _integers, _logic,
    _comparisons, _choices, _clamps, _conversions, _bits, _reductions, _places_of_extremes, _running, _shapes, _joining,
    _counting, _parts_from_anywhere, _gathers, _scatters, _segments, _branches, _loops, _counted_loops,
    _nested_loops, _neighbours, _derivatives,
)  # fmt: skip
# What a program may be about; the rest of it is made of the others.
FEATURED: tuple[Maker, ...] = (*MAKERS, _kernels)
# Later than FEATURED, whose programs are numbered.
HALVES: Maker = _halves
HANDED_OVER: Maker = _handed_over


def numbers(choose: random.Random, shape: tuple[int, ...], dtype: Any) -> Any:
    """Return numbers: mostly few and dyadic, so that they tie; zeros of both signs, some infinite ones and NaN."""
    count, kind = int(np.prod(shape)), np.dtype(dtype).kind
    if kind == "b":
        found: list[Any] = [choose.random() < 0.5 for _ in range(count)]
    elif kind == "u":
        found = [choose.choice((0, 1, 2, 5, 2**31, 2**32 - 1, choose.randrange(2**32))) for _ in range(count)]
    elif kind == "i":
        found = [
            choose.choice((0, 1, 2, 3, -1, -2, 7, choose.randrange(-30, 30)))
            if choose.random() < 0.97
            else choose.choice((-(2**31), 2**31 - 1))
            for _ in range(count)
        ]
    else:
        odd = choose.random() < 0.3
        found = [
            choose.choice((float("inf"), -float("inf"), float("nan"), -0.0)) if odd and choose.random() < 0.15
            else choose.randrange(-12, 13) * 0.25 if choose.random() < 0.6 else choose.uniform(-3.0, 3.0)
            for _ in range(count)
        ]  # fmt: skip
    return np.array(found, dtype).reshape(shape)


class Program:
    """A random program: a closed jaxpr of (shared, state, tick), and numbers for some worlds.

    Args:
        choose: what it is made of.
        featured: one of FEATURED (or HANDED_OVER) that it has in any case; None for none.
        length: how many makers it has.
        double: in double precision, which has to be switched on around.
    """

    def __init__(self, choose: random.Random, featured: Maker | None, length: int, double: bool = False):
        floats = np.dtype(np.float64 if double else np.float32)
        self.size = size = choose.choice(SIZES)
        self.shared = {"p": numbers(choose, (size,), floats), "c": numbers(choose, (), np.int32)}
        wide = choose.choice((1, 2, 3))
        shapes = {
            "x": ((size,), floats), "y": ((wide, size), floats), "s": ((), floats), "i": ((size,), np.int32),
            "k": ((), np.int32), "u": ((size,), np.uint32), "b": ((size,), np.bool_), "g": ((size, wide), floats),
            "v": ((2, wide, 2), floats),
        }  # fmt: skip
        self.worlds = [
            {name: numbers(choose, shape, dtype) for name, (shape, dtype) in shapes.items()} for _ in range(3)
        ]
        makers = [choose.choice(MAKERS) for _ in range(length)]
        if featured is not None:
            makers[choose.randrange(length)] = featured

        def function(shared: Any, state: Any, tick: Any) -> Any:
            pool = {
                "f": [shared["p"], state["x"], state["y"], state["s"], state["g"], state["v"]],
                "i": [state["i"], state["k"], shared["c"], tick], "u": [state["u"]], "b": [state["b"]],
            }  # fmt: skip
            draw = Draw(choose, pool, size)
            for make in makers:
                make(draw)
            return {name: self._next(draw, name, state[name], np.dtype(dtype)) for name, (_, dtype) in shapes.items()}

        self.closed = jax.make_jaxpr(function)(self.shared, self.worlds[0], np.int32(0))

    @staticmethod
    def _next(draw: Draw, name: str, before: Any, dtype: Any) -> Any:
        """Return what a leaf of the state becomes: what was made, in its shape."""
        kind = dtype.kind
        made = draw.choose.choice(draw.pool[kind][-6:])
        if made.ndim == before.ndim + 1 and made.shape[1:] == before.shape:
            found = made[0]
        elif made.ndim and before.ndim == 0:
            found = made.reshape(-1)[0] if kind == "b" else jnp.max(made)
        else:
            found = draw.shaped(made, before.shape)
        found = found.astype(dtype)
        # So that nothing is infinite after a few ticks.
        return draw.tame(found, 64.0) if kind == "f" and draw.choose.random() < 0.5 else found
