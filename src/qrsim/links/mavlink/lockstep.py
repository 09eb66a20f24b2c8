"""A world that waits for the clients that fly its vehicles by set-points, and so flies the same in every run."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress

from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.system import System

# So long a client is waited for, and as often vehicles that stand at the start say that they are there [s].
PATIENCE_S = 1.0


class Lockstep:
    """Has the world stand until each client has sent a set-point newer than the last ATTITUDE that it was sent.

    The world begins when every vehicle that takes any has had a first set-point. Who sends none for ``PATIENCE_S`` is
    waited for again from its next one on.

    Args:
        systems: of all vehicles.
        say: told one line of what happens.
    """

    def __init__(self, systems: Sequence[System], say: Callable[[str], None]):
        self._systems, self._say = systems, say
        self._news = asyncio.Event()

    def heard(self) -> None:
        """Wake the coroutine that waits for frames; called when a frame has arrived."""
        self._news.set()

    async def begun(self) -> None:
        """Wait until some client sends set-points to every vehicle that takes them."""
        self._say("lock-step: the world stands until every vehicle has a set-point")
        flown = [system for system in self._systems if system.stack.takes_setpoints]
        while not all(any(link.flies for link in system.links) for system in flown):
            for system in self._systems:
                system.present()
            await self._heard(PATIENCE_S)

    async def answered(self) -> None:
        """Wait until all clients that fly a vehicle have sent the set-point for this step; give up late ones after
        PATIENCE_S."""
        loop = asyncio.get_running_loop()
        until = loop.time() + PATIENCE_S
        while owing := self._owing():
            left = until - loop.time()
            if left <= 0.0:
                self._give_up(owing)
                return
            await self._heard(left)

    def _owing(self) -> list[tuple[System, Link]]:
        """Return the (vehicle, link) pairs whose client has not sent the set-point for this step yet."""
        return [(system, link) for system in self._systems for link in system.links if link.flies and link.owes]

    def _give_up(self, owing: list[tuple[System, Link]]) -> None:
        """Stop waiting for clients that have not sent a set-point in time, and log that."""
        for system, link in owing:
            link.flies = False
            self._say(
                f"t = {system.view.seen.time:.10g} s, '{system.name}': no set-point for {PATIENCE_S:g} s; the world "
                "goes on without waiting for it, until the next one"
            )

    async def _heard(self, seconds: float) -> None:
        """Wait until any frame arrives, at most ``seconds`` [s]."""
        self._news.clear()
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._news.wait()
