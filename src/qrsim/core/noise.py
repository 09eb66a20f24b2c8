"""Counter-based, named randomness, and exact Ornstein-Uhlenbeck updates.

Every draw is a function of (seed, world, stream name, vehicle id, tick). Nothing is split or carried, so
an added vehicle, sensor or world changes no other draw, a run resumes from any tick and a batch can be
cut anywhere. The generator is Threefry-2x32 with 13 rounds (Salmon, Moraes, Dror, Shaw, "Parallel random
numbers: as easy as 1, 2, 3", SC 2011: the fewest rounds that pass BigCrush); normals by Box and Muller.
The integer words are the same everywhere, and in single precision so are the normals, bit for bit, in every
program on one kind of processor, compiled or not.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array, lax

from qrsim.core.fastmath import exp, log, log_f32, rounded, sincos_ratio, sine_ratio
from qrsim.core.primitives import Kernel
from qrsim.core.tree import quantity, record, setting

ROUNDS = 13
# No normal is larger: the root of -2 log of the least uniform number.
LARGEST_NORMAL = 6.67
_ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)
_PARITY = 0x1BD11BDA


def threefry2x32(key: tuple[Array, Array], counter: tuple[Array, Array], rounds: int = ROUNDS) -> tuple[Array, Array]:
    """Return two random uint32 words from a key and a counter of two words each, by Threefry-2x32.

    Args:
        key: two uint32 arrays, broadcastable against the counter.
        counter: two uint32 arrays of a common shape.
        rounds: 13 in the simulator; 20 is the generator's conservative form.
    """
    words = (*key, *counter)
    # On the host, words that are known before a program runs are not worth compiling.
    if rounds not in _THREEFRY or all(isinstance(word, np.ndarray | np.generic) for word in words):
        return _threefry(*words, rounds=rounds)
    first, second = _THREEFRY[rounds](*(jnp.asarray(word) for word in words))
    return first, second


def _threefry(*words: Array, rounds: int) -> tuple[Array, Array]:
    """Return two random uint32 words from key and counter, two words each (Threefry-2x32, Salmon et al. 2011)."""
    key, counter = words[:2], words[2:]
    schedule = (key[0], key[1], key[0] ^ key[1] ^ np.uint32(_PARITY))
    x0, x1 = counter[0] + schedule[0], counter[1] + schedule[1]
    for i in range(rounds):
        x0 = x0 + x1
        rotation = _ROTATIONS[i % 8]
        x1 = ((x1 << np.uint32(rotation)) | (x1 >> np.uint32(32 - rotation))) ^ x0
        if i % 4 == 3:
            group = i // 4 + 1
            x0 = x0 + schedule[group % 3]
            x1 = x1 + schedule[(group + 1) % 3] + np.uint32(group)
    return x0, x1


_THREEFRY = {
    rounds: Kernel(f"threefry_{rounds}", ("uint32",) * 4, ("uint32",) * 2, partial(_threefry, rounds=rounds))
    for rounds in (ROUNDS, 20)
}


def _box_muller(words: tuple[Array, Array], dtype: jnp.dtype) -> tuple[Array, Array]:
    """Return two independent standard normals, of magnitude 6.66 at most, from a pair of random uint32 words.

    In single precision every operation is rounded on its own, so the result is the same in whatever program it is
    computed.
    """
    if dtype != jnp.float32:
        return _normals(*words, dtype=dtype)
    cosine, sine = _NORMALS(*words)
    return cosine, sine


def _normals(*words: Array, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Return two independent standard normals from two random uint32 words, by the Box-Muller transform."""
    radius, angle = _polar(*words, dtype=dtype)
    sine, cosine, scale = sincos_ratio(angle, rounded)
    # Divisions last, because XLA on a CPU repeats anything cheaper inside every consumer of the result: with
    # multiplications a step would compute its words some thirty times over.
    return radius * cosine / scale, radius * sine / scale


def _polar(*words: Array, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Return the radius and the angle [rad] of two normals from two random words."""
    # Shifted to 31 bits because signed conversion is one vector instruction everywhere.
    uniform = ((words[0] >> 1).astype(jnp.int32).astype(dtype) + 0.5) * 2.0**-31
    # The angle lies in [-pi, pi): all 32 bits, read as a signed number.
    angle = rounded(lax.bitcast_convert_type(words[1], jnp.int32).astype(dtype) * (math.pi * 2.0**-31))
    logarithm = log_f32(uniform, rounded) if dtype == jnp.float32 else log(uniform)
    return jnp.sqrt(jnp.maximum(-2.0 * logarithm, 0.0)), angle


def _one_normal(first: Array, second: Array, quarters: Array) -> tuple[Array]:
    """Return a tuple of the first (quarters 1) or second (0) of the two float32 normals of two random words."""
    radius, angle = _polar(first, second, dtype=jnp.dtype(jnp.float32))
    part, scale = sine_ratio(angle, quarters, rounded)
    return (radius * part / scale,)


_NORMALS = Kernel("normals", ("uint32",) * 2, ("float32",) * 2, partial(_normals, dtype=jnp.dtype(jnp.float32)))
_NORMAL = Kernel("one_normal", ("uint32", "uint32", "int32"), ("float32",), _one_normal)


@lru_cache(maxsize=1024)
def _hashes(names: tuple[str, ...]) -> npt.NDArray[np.uint32]:
    """Return two uint32 hash words (K, 2) of each of K stream names."""
    digests = b"".join(hashlib.sha256(name.encode()).digest()[:8] for name in names)
    return np.frombuffer(digests, "<u4").reshape(-1, 2)


@record
class Key:
    """The 64-bit key of a family of streams."""

    high: Array = quantity(doc="uint32")
    low: Array = quantity(doc="uint32")

    @staticmethod
    def root(seed: int | Array, world: int | Array = 0) -> Key:
        """Return the random key of one world of a batch, from the seed and the world's index.

        Args:
            seed: 0 <= seed < 2**63, or its low and high words as an array (2,) of uint32.
            world: index of the world in its batch, 0 <= world < 2**32.
        """
        if isinstance(seed, int) and isinstance(world, int):
            # On the host: what is known before a program runs is not worth compiling.
            words: list[Any] = [np.array([word], np.uint32) for word in (seed & 0xFFFFFFFF, seed >> 32, world, 0)]
            high, low = threefry2x32((words[0], words[1]), (words[2], words[3]), 20)
            return Key(high[0], low[0])
        if isinstance(seed, int):
            low, high = jnp.uint32(seed & 0xFFFFFFFF), jnp.uint32(seed >> 32)
        else:
            low, high = seed[0], seed[1]
        return Key(*threefry2x32((low, high), (jnp.asarray(world, jnp.uint32), jnp.uint32(0)), 20))

    @staticmethod
    def roots(seeds: npt.NDArray[np.int64], worlds: npt.NDArray[np.int64]) -> Key:
        """Return the random keys (B,) of many worlds from their seeds and indices, computed by NumPy."""
        words: list[Any] = [
            part.astype(np.uint32) for part in (seeds & 0xFFFFFFFF, seeds >> 32, worlds, np.zeros_like(worlds))
        ]
        high, low = threefry2x32((words[0], words[1]), (words[2], words[3]), 20)
        return Key(high, low)

    def streams(self, names: Sequence[str]) -> StreamKeys:
        """Return the keys of the random streams with these names, (K,) words, or (B, K) if this key is of B worlds."""
        hashes = _hashes(tuple(names))
        library = np if isinstance(self.high, np.ndarray | np.generic) else jnp
        shape = (*np.shape(self.high), len(names))
        key = tuple(library.broadcast_to(library.asarray(word)[..., None], shape) for word in (self.high, self.low))
        counter = tuple(library.broadcast_to(library.asarray(hashes[:, i]), shape) for i in (0, 1))
        return StreamKeys(*threefry2x32((key[0], key[1]), (counter[0], counter[1]), 20))

    def families(self, groups: Sequence[Sequence[str]]) -> tuple[StreamKeys, ...]:
        """Return the stream keys of each group of stream names, all computed in one call."""
        every = self.streams([name for names in groups for name in names])
        ends = np.cumsum([len(names) for names in groups]).tolist()
        parts = [slice(end - len(names), end) for names, end in zip(groups, ends, strict=True)]
        return tuple(StreamKeys(every.high[..., part], every.low[..., part]) for part in parts)

    def stream(self, name: str, ids: Array) -> Stream:
        """Return the random stream ``name`` for the vehicles (or satellites) with identifiers ``ids``, uint32 (n,)."""
        return self.streams([name]).stream(0, ids)


@record
class StreamKeys:
    """The keys of K streams; constant during an episode, so they are computed once, at its start."""

    high: Array = quantity(doc="(K,) uint32")
    low: Array = quantity(doc="(K,) uint32")

    def stream(self, index: int, ids: Array) -> Stream:
        """Return the random stream with number ``index`` for vehicles (or satellites) ``ids``, uint32 (n,)."""
        return Stream(self.high[index], self.low[index], ids)


@record
class Stream:
    """One named stream: normals for each id at each tick."""

    high: Array = quantity(doc="uint32 key word")
    low: Array = quantity(doc="uint32 key word")
    ids: Array = quantity(doc="(n,) uint32: what the draws belong to")

    def words(self, tick: Array, index: Array | int) -> tuple[Array, Array]:
        """Return the two random uint32 words (n,) of draw number ``index`` at a tick."""
        return threefry2x32((self.high, self.low + jnp.asarray(index, jnp.uint32)), self._counter(tick))

    def _counter(self, tick: Array) -> tuple[Array, Array]:
        """Return the generator's counter words, tick and ids, each broadcast to (n,)."""
        return jnp.broadcast_to(jnp.asarray(tick).astype(jnp.uint32), self.ids.shape), self.ids

    def normals(self, tick: Array, count: int, dtype: jnp.dtype) -> tuple[Array, ...]:
        """Return ``count`` arrays (n,) of independent standard normals, the same at each call for the same tick."""
        drawn: list[Array] = []
        for pair in range((count + 1) // 2):
            drawn.extend(_box_muller(self.words(tick, pair), dtype))
        return tuple(drawn[:count])

    def normal_rows(self, tick: Array, rows: int, dtype: jnp.dtype, first: int = 0) -> Array:
        """Return independent standard normals (rows, n) at a tick, such as one row for each satellite or channel.

        They come in pairs from pair ``first`` on: calls at one tick that must be independent use different pairs.
        """
        index = jnp.uint32(first) + jnp.arange((rows + 1) // 2, dtype=jnp.uint32)[:, None]
        shape = (index.shape[0], *self.ids.shape)
        counter = tuple(jnp.broadcast_to(word, shape) for word in self._counter(tick))
        words = threefry2x32((self.high, jnp.broadcast_to(self.low + index, shape)), (counter[0], counter[1]))
        return jnp.concatenate(_box_muller(words, dtype), axis=0)[:rows]

    def normal_pairs(self, tick: Array, pairs: Array, dtype: jnp.dtype) -> tuple[Array, Array]:
        """Return two independent standard normals (K, n) at a tick for each draw number in ``pairs`` (K,) uint32."""
        return _box_muller(self._words_of(tick, pairs), dtype)

    def normals_of(self, tick: Array, pairs: Array, second: Array, dtype: jnp.dtype) -> Array:
        """Return the first or ``second`` normal (...) of each draw number in ``pairs`` (...), of a one-id stream."""
        words = self.words(tick, pairs)
        if dtype != jnp.float32:
            return jnp.where(second, *_box_muller(words, dtype)[::-1])
        normal: Array = _NORMAL(*words, jnp.where(second, 0, 1))[0]
        return normal

    def uniform_pairs(self, tick: Array, pairs: Array, dtype: jnp.dtype) -> tuple[Array, Array]:
        """Return two uniform numbers (K, n) of mean 0 and variance 1 for each draw number in ``pairs`` (K,) uint32.

        They cost half as much as normals, and a sum of many is as good.
        """
        scale = math.sqrt(3.0) * 2.0**-31
        first, second = (lax.bitcast_convert_type(word, jnp.int32) for word in self._words_of(tick, pairs))
        return first.astype(dtype) * scale, second.astype(dtype) * scale

    def _words_of(self, tick: Array, pairs: Array) -> tuple[Array, Array]:
        """Return two random uint32 words (K, n) at a tick for each draw number in ``pairs`` (K,) and each id."""
        shape = (*pairs.shape, *self.ids.shape)
        counter = tuple(jnp.broadcast_to(word, shape) for word in self._counter(tick))
        key = jnp.broadcast_to((self.low + pairs)[:, None], shape)
        return threefry2x32((self.high, key), (counter[0], counter[1]))


@record
class Draw:
    """A stream at a tick, in the run's precision, drawn on demand."""

    stream: Stream = quantity()
    tick: Array = quantity(doc="() uint32")
    like: Array = quantity(doc="() array whose dtype the normals take")
    most: int | None = setting(default=None, doc="normals that its component declares; None: any number")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (n,) of the arrays drawn: one number for each id of the stream."""
        return self.stream.ids.shape

    def normals(self, count: int) -> tuple[Array, ...]:
        """Return ``count`` arrays (n,) of independent standard normals, of this draw's stream and tick.

        Raises:
            ValueError: these are more than the component declares.
        """
        _check_count(count, self.most)
        return self.stream.normals(self.tick, count, self.like.dtype)

    def normal_rows(self, rows: int, first: int = 0) -> Array:
        """Return independent standard normals (rows, n), from draw number ``first`` on; see ``Stream.normal_rows``."""
        return self.stream.normal_rows(self.tick, rows, self.like.dtype, first)

    def normal_pairs(self, pairs: Array) -> tuple[Array, Array]:
        """Return two standard normals (K, n) for each draw number in ``pairs`` (K,); see ``Stream.normal_pairs``."""
        return self.stream.normal_pairs(self.tick, pairs, self.like.dtype)

    def uniform_pairs(self, pairs: Array) -> tuple[Array, Array]:
        """Return two uniform numbers (K, n), mean 0 and variance 1, for each of ``pairs``, as ``Stream`` does."""
        return self.stream.uniform_pairs(self.tick, pairs, self.like.dtype)

    def alone(self, number: int) -> Draw:
        """Return a draw (1,) of the same stream and tick for one id, ``number``, such as for errors that all share."""
        ids = jnp.full((1,), number, jnp.uint32)
        return Draw(Stream(self.stream.high, self.stream.low, ids), self.tick, self.like, self.most)


class Noise(Protocol):
    """Source of a component's randomness: a Draw or a Drawn."""

    def normals(self, count: int) -> tuple[Array, ...]:
        """Return ``count`` arrays (n,) of independent standard normals."""
        ...


@record
class Drawn:
    """Normals drawn ahead, handed to a component in place of a Draw."""

    rows: tuple[Array, ...] = quantity(doc="each (n,)")

    def normals(self, count: int) -> tuple[Array, ...]:
        """Return the first ``count`` of the stored arrays (n,) of standard normals; raise ValueError if too few."""
        _check_count(count, len(self.rows))
        return self.rows[:count]


def _check_count(count: int, most: int | None) -> None:
    """Raise ValueError if ``count`` exceeds ``most``, the number of normals that a component has declared."""
    if most is not None and count > most:
        raise ValueError(f"a component that declares {most} normals per step asked for {count}")


def draw_together(streams: Sequence[Stream], counts: Sequence[int], tick: Array, like: Array) -> list[Drawn]:
    """Return the standard normals of several streams at a tick, ``counts`` of each, drawn in one call for speed.

    Args:
        streams: all with the same ids (n,).
        counts: how many normals each needs.
        tick: () integer.
        like: () array whose dtype the normals take.
    """
    pairs = [(count + 1) // 2 for count in counts]
    if sum(pairs) == 0:
        return [Drawn(()) for _ in streams]
    high = jnp.stack([stream.high for stream, pair in zip(streams, pairs, strict=True) for _ in range(pair)])
    low = jnp.stack(
        [stream.low + jnp.uint32(i) for stream, pair in zip(streams, pairs, strict=True) for i in range(pair)]
    )
    ids = streams[0].ids
    shape = (sum(pairs), *ids.shape)
    counter = (jnp.broadcast_to(tick.astype(jnp.uint32), shape), jnp.broadcast_to(ids, shape))
    key = (jnp.broadcast_to(high[:, None], shape), jnp.broadcast_to(low[:, None], shape))
    cosines, sines = _box_muller(threefry2x32(key, counter), like.dtype)
    drawn, row = [], 0
    for count, pair in zip(counts, pairs, strict=True):
        normals = [half[row + i] for i in range(pair) for half in (cosines, sines)]
        drawn.append(Drawn(tuple(normals[:count])))
        row += pair
    return drawn


def ou_decay(dt: float | Array, time_constant: Array) -> tuple[Array, Array]:
    """Return (a, sqrt(1 - a^2)), a = exp(-dt/tau): decay and noise factors of an exact Ornstein-Uhlenbeck update.

    The square root loses digits where dt << tau, so 1 - a^2 comes from its own series there (2 x - 2 x^2 +
    4/3 x^3 - 2/3 x^4, relative error below 2e-9 for x < 0.01).
    """
    x = jnp.asarray(dt / time_constant)
    decay = exp(-x)
    series = x * (2.0 - x * (2.0 - x * (4.0 / 3.0 - x * (2.0 / 3.0))))
    return decay, jnp.sqrt(jnp.where(x < 0.01, series, 1.0 - decay * decay))


def ou_step(value: Array, normal: Array, dt: float | Array, std: Array, time_constant: Array) -> Array:
    """Return an Ornstein-Uhlenbeck process one exact step dt [s] later (Symington 2014, eq. 10).

    Args:
        value: the process now, any shape.
        normal: standard normal of the same shape.
        dt: interval [s].
        std: stationary standard deviation, in the unit of ``value``.
        time_constant: tau [s].
    """
    decay, spread = ou_decay(dt, time_constant)
    return decay * value + std * spread * normal
