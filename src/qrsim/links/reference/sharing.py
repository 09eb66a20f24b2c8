"""One world for several clients: its clock, or the barrier that they meet at, and who is told what."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from qrsim.errors import UsageError
from qrsim.links.contracts import Order, Silence
from qrsim.links.pacing import Metronome
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.roles import Client, Host
from qrsim.links.reference.session import MOST_TICKS, SHORT_S
from qrsim.links.reference.shared_session import SharedSession

# Bytes that wait for a reader: with more it misses what is sensed meanwhile, rather than to hear old news.
MOST_STALE = 1 << 16


@dataclass
class Subscription:
    """What a client wants to be pushed.

    Attributes:
        rows: numbers of vehicles; None: those that it has claimed.
        every: ticks between two.
        truth: with true states.
        last: tick of the last one.
        missed: so many it was too slow for.
    """

    rows: tuple[int, ...] | None
    every: int
    truth: bool
    last: int = -(2**62)
    missed: int = 0


@dataclass
class Waiting:
    """A client at the barrier: until which tick it wants to go, and what tells it that the world is there."""

    until: int
    there: asyncio.Future[Any]


class Sharing:
    """The world of a server whose clients share it.

    Args:
        server: whose it is.
        session: begun.
        timeout: of the barrier, in seconds of the wall clock; 0: it waits for ever.

    Attributes:
        lock: held while the world moves.
    """

    def __init__(self, server: Host, session: SharedSession, timeout: float):
        self._server, self.session, self._timeout = server, session, timeout
        self.lock = asyncio.Lock()
        self._subscriptions: dict[Client, Subscription] = {}
        self._waiting: dict[int, Waiting] = {}
        self._claimed = asyncio.Event()
        self._mover: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._late = False
        self._clock = asyncio.create_task(self._run_free()) if session.pace == "free" else None

    def end(self) -> None:
        """Cancel the asyncio tasks that advance the shared world."""
        for task in (self._clock, self._mover):
            if task is not None:
                task.cancel()
        if self._timer is not None:
            self._timer.cancel()

    # ---- claims ----

    def claim(self, client: Client, names: Sequence[str], silence: Silence | None) -> tuple[str, ...]:
        """Claim vehicles for a client, and return the names of all that it has; raises UsageError if one cannot be
        claimed."""
        plant = self.session.plant
        new = plant.claim(client.number, names, silence)
        if new:
            self._server.say(f"client {client.number} flies {_quoted_names(new)}")
        if not self._claimed.is_set():
            # The clock begins with the first claim.
            self.session.start_clock()
            self._claimed.set()
        return plant.claims.of(client.number)

    def release(self, client: Client, names: Sequence[str] = ()) -> None:
        """Give a client's vehicles (default: all) back to their scenario's guidance; raises UsageError for others'
        vehicles."""
        found = self.session.plant.release(client.number, names)
        if found:
            self._server.say(f"client {client.number} releases {_quoted_names(found)}")
        self._advance_if_ready()

    def forget(self, client: Client) -> None:
        """Release the vehicles of a client that has disconnected."""
        self._subscriptions.pop(client, None)
        self._waiting.pop(client.number, None)
        found = self.session.plant.lose(client.number)
        if found:
            self._server.say(f"client {client.number} has gone from {_quoted_names(found)}")
        self._advance_if_ready()

    def check_alone(self, client: Client, what: str) -> None:
        """Raise UsageError if another client has claimed vehicles, so that ``client`` may not do ``what`` to the whole
        world."""
        claims = self.session.plant.claims
        for other in claims.holders:
            if other != client.number:
                raise UsageError(
                    f"{what}: client {other} flies {_quoted_names(claims.of(other))} in this world, "
                    "which would be disturbed"
                )

    # ---- orders ----

    def order(self, client: Client, orders: Sequence[Order], source_tick: int | None) -> int:
        """Queue a client's orders, and return the tick at which they take effect; ``source_tick``: of their readings;
        raises UsageError for bad ones."""
        plant = self.session.plant
        plant.check(client.number, orders)
        plant.order(orders, source_tick)
        return plant.now + 1

    async def meet(self, client: Client, orders: Sequence[Order], source_tick: int | None, until: int | None) -> None:
        """Queue a client's orders and wait at the barrier until the world is at tick ``until``; raises UsageError for
        bad ones.

        Raises:
            UsageError: an order is wrong, the client has claimed nothing, or the tick is no later one; or it leaves.
        """
        plant = self.session.plant
        plant.check(client.number, orders)
        if not plant.claims.of(client.number):
            raise UsageError("COMMAND: this client has claimed no vehicle; CLAIM first")
        now = plant.now
        until = now + 1 if until is None else until
        if until > now + MOST_TICKS:
            raise UsageError(f"COMMAND: until_tick {until} is {until - now} ticks away; allowed: up to {MOST_TICKS}")
        if until <= now and not self._timeout:
            raise UsageError(f"COMMAND: until_tick {until}: the world is at tick {now} already")
        plant.order(orders, source_tick)
        plant.heard_until(client.number, until)
        if until <= now:
            return
        waiting = self._waiting[client.number] = Waiting(until, asyncio.get_running_loop().create_future())
        self._advance_if_ready()
        leaving = asyncio.ensure_future(client.leaving.wait())
        try:
            await asyncio.wait({waiting.there, leaving}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            leaving.cancel()
        if not waiting.there.done():
            self._waiting.pop(client.number, None)
            raise UsageError("COMMAND: the client closes the connection")
        waiting.there.result()

    def _agreed_tick(self) -> int | None:
        """Return the tick to which all clients at the barrier let the world advance; None while one is missing."""
        if not self._waiting:
            return None
        claims = self.session.plant.claims
        missing = [holder for holder in claims.holders if holder not in self._waiting]
        if missing and not self._late:
            return None
        for holder in missing:
            self.session.plant.missed(holder)
        self._late = False
        return min(waiting.until for waiting in self._waiting.values())

    def _advance_if_ready(self) -> None:
        """Advance the world if all clients wait at the barrier; else start the timeout for the missing ones."""
        if self.session.pace != "barrier" or (self._mover is not None and not self._mover.done()):
            return
        until = self._agreed_tick()
        if until is not None:
            self._stop_timer()
            self._mover = asyncio.create_task(self._advance_agreed(until))
        elif self._waiting and self._timeout and self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(self._timeout, self._on_timeout)

    def _on_timeout(self) -> None:
        """Advance the world without the clients that have not come to the barrier in time."""
        self._timer, self._late = None, True
        self._advance_if_ready()

    def _stop_timer(self) -> None:
        """Cancel the timeout of the barrier."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    async def _advance_agreed(self, until: int | None) -> None:
        """Advance the world to the agreed tick, answer the clients that wait for it, and repeat while all agree."""
        session, plant = self.session, self.session.plant
        try:
            while until is not None:
                async with self.lock:
                    while session.simulation.tick < until:
                        actions = plant.begin()
                        await self._advance_ticks(actions, session.piece(actions, until - session.simulation.tick))
                        plant.now = session.simulation.tick
                wait = session.pacer.wait_s(session.time)
                if wait > 0.0:
                    await asyncio.sleep(wait)
                self._publish()
                for number, waiting in list(self._waiting.items()):
                    if waiting.until <= plant.now:
                        del self._waiting[number]
                        if not waiting.there.done():
                            waiting.there.set_result(None)
                until = self._agreed_tick()
        except Exception as error:
            self._server.report_bug(error)
            for waiting in self._waiting.values():
                if not waiting.there.done():
                    waiting.there.set_exception(error)
            self._waiting.clear()
        self._mover = None
        self._advance_if_ready()

    # ---- the clock ----

    async def _run_free(self) -> None:
        """Advance the world at its pace, without waiting for clients, from the first claim on."""
        await self._claimed.wait()
        session = self.session
        try:
            async with self.lock:
                actions = session.plant.begin()
            while True:
                pacer = session.pacer
                assert isinstance(pacer, Metronome)
                # Also where it is late: others have their turn.
                await asyncio.sleep(max(0.0, pacer.until_s(session.time + session.time_step)))
                async with self.lock:
                    if session.pacer is not pacer:
                        actions = session.plant.begin()
                        continue
                    await self._advance_ticks(actions, 1)
                    self._publish()
                    actions = session.plant.begin()
                    pacer.ended(session.time)
        except Exception as error:
            self._server.report_bug(error)

    async def _advance_ticks(self, actions: object, ticks: int) -> None:
        """Advance the world by some ticks with the fleets' actions, in the session's thread if that takes long."""
        session = self.session
        if session.expected_s(actions, ticks) < SHORT_S:
            session.advance(actions, ticks)
        else:
            await asyncio.get_running_loop().run_in_executor(session.thread, session.advance, actions, ticks)

    # ---- what is told ----

    def subscribe(self, client: Client, subscription: Subscription | None) -> None:
        """Start or stop (None) pushing time-stamped sensor readings to a client."""
        if subscription is None:
            self._subscriptions.pop(client, None)
        else:
            self._subscriptions[client] = subscription

    def sensed(self, client: Client, rows: Sequence[int] | None, truth: bool) -> bytes:
        """Return the READINGS message for the vehicles at ``rows``, by default those that the client has claimed;
        ``truth``: with true states."""
        return self.session.sensed.frame(Message.READINGS, self._selected_rows(client, rows), truth)

    def _selected_rows(self, client: Client, rows: Sequence[int] | None) -> Sequence[int]:
        """Return ``rows``, or, for None, the rows of the vehicles that a client has claimed."""
        plant = self.session.plant
        return [plant.latches.row(name) for name in plant.claims.of(client.number)] if rows is None else rows

    def _publish(self) -> None:
        """Push readings to all subscribed clients; a client that reads too slowly misses them."""
        tick = self.session.simulation.tick
        for client, wanted in self._subscriptions.items():
            if 0 <= tick - wanted.last < wanted.every:
                continue
            wanted.last = tick
            if client.backlog > MOST_STALE:
                wanted.missed += 1
                continue
            rows = self._selected_rows(client, wanted.rows)
            client.send_frame(self.session.sensed.frame(Message.SENSED, rows, wanted.truth, wanted.missed))
        self._server.broadcast(self.session)


def _quoted_names(names: Sequence[str]) -> str:
    """Return up to eight names in quotes as text, with the number of further names."""
    shown = ", ".join(f"'{name}'" for name in names[:8])
    return f"{shown} and {len(names) - 8} more" if len(names) > 8 else shown
