"""The radio of a world: which messages arrive where, and when (docs/howto/radio.md)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from qrsim.core.fastmath import exp
from qrsim.core.host import library_of
from qrsim.core.neighbours import Neighbours, neighbours
from qrsim.core.noise import Draw, Stream, StreamKeys
from qrsim.core.tree import quantity, record, record_of, replace
from qrsim.models.radio.access import starts
from qrsim.models.radio.channel import JITTER_SIGMA, Channel
from qrsim.models.radio.contracts import STREAMS, Exchange, Inbox, Outbox, Radio
from qrsim.models.radio.links import OUT_OF_RANGE, Links, Outcome, error_rate, outcomes, powers
from qrsim.models.radio.propagation import SPEED_OF_LIGHT, ShadowField
from qrsim.models.radio.tables import NOBODY, Heard, first_of, newest, taken
from qrsim.models.scene.uniform import uniform

PACKET, JITTER, BACKOFF = range(len(STREAMS))
# A packet that is late by less than this part of a tick is not late.
_ROUNDING = 1e-3


@record
class Waiting:
    """Messages of each vehicle (n,) that wait for the radio, the oldest first (q)."""

    payload: Array = quantity(doc="(q, D, n) numbers")
    to: Array = quantity(doc="(q, n) int32 number of the only recipient; -1: all")
    since: Array = quantity(doc="(q, n) int32 tick at which it was handed over; -1: none")


@record
class Counts:
    """Packets since the start, of each vehicle (n,) int32."""

    sent: Array = quantity(doc="packets sent")
    heard: Array = quantity(doc="packets received")
    lost_range: Array = quantity(doc="packets lost because they were too weak, with a chance of loss above 90 %")
    lost_noise: Array = quantity(doc="packets lost by chance")
    lost_collision: Array = quantity(doc="packets lost to other transmissions, or its own")
    lost_queue: Array = quantity(doc="messages dropped from its send queue")
    deferred: Array = quantity(doc="periods in which csma found no free time for it")
    overfull: Array = quantity(doc="exchanges with more vehicles within reach than the search has room for")


@record
class NetworkState:
    """Everything of the radio that changes."""

    keys: StreamKeys = quantity(doc="keys of its randomness, constant during an episode")
    field: ShadowField = quantity(doc="shadowing of the episode")
    waiting: Waiting = quantity(doc="messages that wait")
    coming: Heard = quantity(doc="(F K, ...) packets of the last F periods, heard and perhaps on their way")
    table: Heard = quantity(doc="(K, ...) newest message of each sender")
    counts: Counts = quantity(doc="packets since the start")
    links: Links = quantity(doc="links of the last period")


@record
class Network(Channel, Radio):
    """Datagrams between vehicles, over one channel for all."""

    @property
    def period(self) -> float:
        """Time [s] from one exchange of packets to the next."""
        return self.mac.period

    def init(self, draw: Draw, keys: StreamKeys, like: Array) -> NetworkState:
        """Return the network's state at the start; ``draw`` has one id for each wave of the shadowing."""
        queue, shape = self.mac.queue, like.shape
        rows, size = self.inbox.size, self.size
        none = jnp.full((queue, *shape), NOBODY, jnp.int32)
        zero = jnp.zeros(shape, jnp.int32)
        return NetworkState(
            keys=keys,
            field=ShadowField.drawn(draw),
            waiting=Waiting(jnp.zeros((queue, size, *shape), like.dtype), none, none),
            coming=Heard.nothing(rows * self.periods_on_the_way, size, like),
            table=Heard.nothing(rows, size, like),
            counts=Counts(*(zero,) * 8),
            links=Links.nothing(self.inbox.candidates, like),
        )

    def exchange(self, state: NetworkState, now: Exchange) -> NetworkState:
        """Return the network's state after a tick: messages queued and, once a period, each queue's oldest sent."""
        if now.said is not None:
            state = self._queued(state, now.said, now)
        ticks = max(1, round(self.mac.period / now.time_step))
        return lax.cond(now.due % ticks == 0, lambda: self._sent(state, now, ticks), lambda: state)

    def received(self, state: NetworkState, tick: Array, time_step: float) -> Inbox:
        """Return the messages that each vehicle has received by a tick, the newest of each sender."""
        heard = self.heard(state, tick, time_step)
        library = library_of(heard.sender)
        mask = heard.sender != NOBODY
        age = (tick - heard.sent).astype(heard.rssi.dtype) * time_step
        return Inbox(
            payload=library.transpose(heard.payload, (2, 0, 1)),
            sender=heard.sender.T,
            age=library.where(mask, age, library.nan).astype(heard.rssi.dtype).T,
            rssi=library.where(mask, heard.rssi, library.nan).astype(heard.rssi.dtype).T,
            mask=mask.T,
        )

    def heard(self, state: NetworkState, tick: Array, time_step: float) -> Heard:
        """Return the newest received message of each sender, newest first, none older than ``inbox.forget``."""
        both = state.coming.joined(state.table)
        fresh = (tick - both.sent) <= round(self.inbox.forget / time_step)
        return newest(both, both.known(tick) & fresh, self.inbox.size)

    def last_heard(self, state: NetworkState, senders: slice, tick: Array, time_step: float) -> Array:
        """Return the tick (n,) int32 when the newest message received from ``senders`` was sent; -1 if none was."""
        both = state.coming.joined(state.table)
        counts = both.known(tick) & (both.sender >= senders.start) & (both.sender < senders.stop)
        return jnp.max(jnp.where(counts, both.sent, NOBODY), axis=0)

    def counted(self, state: NetworkState) -> dict[str, Array]:
        """Return the counts of packets since the start by name, such as "sent" and "lost_noise", each (n,)."""
        return dict(vars(state.counts))

    def links(self, state: NetworkState) -> Links:
        """Return the radio links between vehicles in the last period, with each packet's outcome."""
        return state.links

    def handed(self, state: NetworkState, vehicle: int, payload: object, to: int, tick: int) -> NetworkState:
        """Return a state with a message appended to a vehicle's send queue; a full queue drops its oldest message."""
        words, receivers, since = (
            np.array(part) for part in (state.waiting.payload, state.waiting.to, state.waiting.since)
        )
        lost = np.array(state.counts.lost_queue)
        length = int((since[:, vehicle] != NOBODY).sum())
        if length == self.mac.queue:
            lost[vehicle] += 1
            length -= 1
            words[:-1, :, vehicle], receivers[:-1, vehicle] = words[1:, :, vehicle], receivers[1:, vehicle]
            since[:-1, vehicle] = since[1:, vehicle]
        words[length, :, vehicle], receivers[length, vehicle], since[length, vehicle] = payload, to, tick
        waiting = record_of(Waiting, words, receivers, since)
        return replace(state, waiting=waiting, counts=replace(state.counts, lost_queue=lost))

    def _queued(self, state: NetworkState, said: Outbox, now: Exchange) -> NetworkState:
        """Return the state with new messages in the send queues; a full queue drops its oldest message, counted."""
        waiting, queue = state.waiting, self.mac.queue
        here = said.send & now.surfaces.works
        length = jnp.sum((waiting.since != NOBODY).astype(jnp.int32), axis=0, dtype=jnp.int32)
        full = here & (length == queue)
        row = jnp.arange(queue, dtype=jnp.int32)[:, None]
        place = jnp.where(here, jnp.minimum(length, queue - 1), -1)[None]

        def put(rows: Array, new: Array) -> Array:
            """Return the queue ``rows`` with ``new`` at the first free place; a full queue loses its oldest entry."""
            shifted = _shifted(rows, full)
            at = place if rows.ndim == 2 else place[:, None]
            number = row if rows.ndim == 2 else row[:, None]
            return jnp.where(number == at, jnp.broadcast_to(new[None], rows.shape), shifted)

        tick = jnp.broadcast_to(jnp.asarray(now.tick, jnp.int32), here.shape)
        waiting = Waiting(put(waiting.payload, said.payload), put(waiting.to, said.to), put(waiting.since, tick))
        counts = replace(state.counts, lost_queue=state.counts.lost_queue + full.astype(jnp.int32))
        return replace(state, waiting=waiting, counts=counts)

    def _sent(self, state: NetworkState, now: Exchange, ticks: int) -> NetworkState:
        """Return the state after each vehicle has sent its oldest message or a beacon; received ones are in transit."""
        surfaces, limits = now.surfaces, self.inbox
        frame = jnp.asarray(now.tick, jnp.int32) // ticks
        x, y, z = (
            jnp.where(surfaces.works, axis, jnp.nan)
            for axis in (surfaces.position_ned.x, surfaces.position_ned.y, surfaces.position_ned.z)
        )
        near = neighbours(x, y, z, limits.reach, limits.candidates)
        payload, to, since, queued, wants = self._first(state, now)
        wants = wants & surfaces.works
        power = powers(self, state.field, near, surfaces)
        draw = Draw(self._stream(state.keys, BACKOFF, now.ids, 0), frame.astype(jnp.uint32), payload[0, :1])
        begin, sends = starts(self.mac, self.air_time, draw, wants, self._audible(near, power))
        chance = self._chance(state.keys, near, now.ids, frame)
        if now.lost is not None:
            # A packet is lost where its number is below the chance of an error.
            chance = chance - now.lost[None] - now.lost.at[jnp.maximum(near.index, 0)].get(mode="promise_in_bounds")
        links = outcomes(self, near, power, begin, sends, to, chance)
        heard = self._arriving(state, near, links, (payload, since, begin), now, frame)
        table = self.heard(state, now.tick, now.time_step)
        kept = state.coming.sender.shape[0] - limits.size
        coming = heard.joined(jax.tree.map(lambda leaf: leaf[:kept], state.coming))
        waiting = _without_first(state.waiting, queued & sends)
        return replace(
            state,
            waiting=waiting,
            coming=coming,
            table=table,
            links=links,
            counts=_counted(state.counts, links, near, sends, wants),
        )

    def _first(self, state: NetworkState, now: Exchange) -> tuple[Array, Array, Array, Array, Array]:
        """Return each vehicle's next message: payload (D, n), receiver, tick, and (n,) bool: was queued, is sent."""
        waiting = state.waiting
        queued = waiting.since[0] != NOBODY
        payload, to, since = waiting.payload[0], waiting.to[0], waiting.since[0]
        if now.beacons is None:
            return payload, to, since, queued, queued
        payload = jnp.where(queued[None], payload, now.beacons.payload)
        to = jnp.where(queued, to, now.beacons.to)
        since = jnp.where(queued, since, jnp.asarray(now.tick, jnp.int32))
        return payload, to, since, queued, queued | now.beacons.send

    def _audible(self, near: Neighbours, power: Array) -> tuple[Array, Array]:
        """Return the neighbours (K, n) considered by carrier sensing, and (K, n) bool: they are audible to the vehicle.

        A vehicle defers to audible senders; the others are hidden from it.
        """
        above = power - jnp.broadcast_to(self.noise_dbm, power.shape)
        if self.mac.sense == "noise":
            hears = above > 0.0
        else:
            hears = error_rate(self, above, near.squared) <= OUT_OF_RANGE
        return jnp.maximum(near.index, 0), (near.index >= 0) & hears

    @staticmethod
    def _stream(keys: StreamKeys, which: int, ids: object, frame: object) -> Stream:
        """Return the random stream number ``which`` for senders ``ids`` in radio period ``frame``."""
        low = keys.low[which] + jnp.asarray(frame).astype(jnp.uint32)
        return Stream(keys.high[which], low, jnp.asarray(ids, jnp.uint32))

    def _pair(self, keys: StreamKeys, which: int, near: Neighbours, ids: object, frame: Array) -> tuple[Stream, Array]:
        """Return a random stream for pairs (K, n) of vehicles in a period, and the senders' ids, used as ticks."""
        ids = jnp.asarray(ids, jnp.uint32)
        sender = ids.at[jnp.maximum(near.index, 0)].get(mode="promise_in_bounds")
        receiver = jnp.broadcast_to(ids[None], sender.shape)
        return self._stream(keys, which, receiver, frame), sender

    def _chance(self, keys: StreamKeys, near: Neighbours, ids: object, frame: Array) -> Array:
        """Return a uniform random number (K, n) in [0, 1) for each pair of receiver and sender in a period."""
        stream, sender = self._pair(keys, PACKET, near, ids, frame)
        return uniform(Draw(stream, sender, near.squared[0, :1]), 0)

    def _arriving(
        self,
        state: NetworkState,
        near: Neighbours,
        links: Links,
        packets: tuple[Array, Array, Array],
        now: Exchange,
        frame: Array,
    ) -> Heard:
        """Return the table of packets received in a period, the nearest senders' first, with arrival ticks."""
        payload, since, begin = packets
        heard = links.outcome == Outcome.HEARD
        there = jnp.maximum(near.index, 0)
        late = self._late(state.keys, near, begin.at[there].get(mode="promise_in_bounds"), now, frame)
        arrives = jnp.asarray(now.tick, jnp.int32) + jnp.maximum(
            jnp.ceil(late / now.time_step - _ROUNDING).astype(jnp.int32), 1
        )
        sent = since.at[there].get(mode="promise_in_bounds")
        # Only the payloads of received packets are gathered.
        nothing = jnp.zeros((heard.shape[0], 0, heard.shape[1]), payload.dtype)
        found = taken(Heard(nothing, links.sender, sent, arrives, links.rssi), first_of(heard, self.inbox.size))
        speaker = jnp.maximum(found.sender, 0)
        words = jnp.stack([row.at[speaker].get(mode="promise_in_bounds") for row in payload], axis=1)
        return replace(found, payload=jnp.where((found.sender != NOBODY)[:, None], words, 0.0))

    def _late(self, keys: StreamKeys, near: Neighbours, begin: Array, now: Exchange, frame: Array) -> Array:
        """Return the delay (K, n) [s] from the beginning of a period until each packet arrives."""
        stream, sender = self._pair(keys, JITTER, near, now.ids, frame)
        (normal,) = stream.normals(sender, 1, near.squared.dtype)
        distance = jnp.sqrt(jnp.where(near.index >= 0, near.squared, 0.0))
        jitter = self.delay.jitter * exp(JITTER_SIGMA * normal)
        return begin + self.air_time + distance * (1.0 / SPEED_OF_LIGHT) + self.delay.fixed + jitter


def _shifted(rows: Array, where: Array) -> Array:
    """Return queue rows moved up by one, the last one repeated, for vehicles in the mask ``where`` (n,)."""
    moved = jnp.concatenate([rows[1:], rows[-1:]])
    return jnp.where(where[(None,) * (rows.ndim - 1)], moved, rows)


def _without_first(waiting: Waiting, gone: Array) -> Waiting:
    """Return the send queues without their first message for vehicles in the mask ``gone`` (n,)."""
    since = jnp.concatenate([waiting.since[1:], jnp.full_like(waiting.since[:1], NOBODY)])
    return Waiting(
        _shifted(waiting.payload, gone), _shifted(waiting.to, gone), jnp.where(gone[None], since, waiting.since)
    )


def _counted(counts: Counts, links: Links, near: Neighbours, sends: Array, wants: Array) -> Counts:
    """Return the packet counts with those of a period added, by outcome."""

    def of(outcome: int) -> Array:
        """Return each vehicle's (n,) number of links with this outcome."""
        return jnp.sum((links.outcome == outcome).astype(jnp.int32), axis=0, dtype=jnp.int32)

    return replace(
        counts,
        sent=counts.sent + sends.astype(jnp.int32),
        heard=counts.heard + of(Outcome.HEARD),
        lost_range=counts.lost_range + of(Outcome.WEAK),
        lost_noise=counts.lost_noise + of(Outcome.NOISE),
        lost_collision=counts.lost_collision + of(Outcome.COLLISION),
        deferred=counts.deferred + (wants & ~sends).astype(jnp.int32),
        overfull=counts.overfull + near.overfull.astype(jnp.int32),
    )
