"""Handlers of requests to a world that clients share: one function per type, which sends exactly one reply."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from qrsim.errors import UsageError
from qrsim.links.contracts import Order
from qrsim.links.reference.kinds import order_of
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.roles import Client, Host
from qrsim.links.reference.sharing import Sharing, Subscription
from qrsim.links.shared.plant import checked_silence

MOST_RATE_HZ = 1e6


def _shared_world(client: Client) -> Sharing:
    """Return the world that all clients of this server share."""
    found = client.server.sharing
    assert isinstance(found, Sharing)
    return found


def has_no_owner(server: Host, name: str) -> UsageError:
    """Return the error for a request (``name``) that is refused in a shared world, since nobody owns it."""
    return UsageError(
        f"{name}: this server's world is shared by its clients (--pace {server.options.pace}); CLAIM vehicles of it, "
        "and send COMMANDs"
    )


def _checked_names(names: Sequence[object]) -> list[str]:
    """Return vehicle names as texts; raises UsageError for bytes that are not UTF-8."""
    if not all(isinstance(name, str) for name in names):
        raise UsageError("message: a text is not UTF-8")
    return [str(name) for name in names]


async def claim(client: Client, message: Message) -> None:
    """Claim vehicles for the client, as CLAIM asks, and send the names of all that it has claimed."""
    sharing, request = _shared_world(client), message.claim
    session, default = sharing.session, client.server.options.silence
    silence = None
    if request.HasField("on_silence") or request.HasField("hold"):
        (does,) = _checked_names([request.on_silence if request.HasField("on_silence") else default.does])
        after = request.hold if request.HasField("hold") else default.after
        silence = checked_silence(does, after, "CLAIM: on_silence")
    vehicles = sharing.claim(client, _checked_names(request.vehicle), silence)
    plant = session.plant
    found = pb.Claimed(
        client=client.number,
        vehicle=vehicles,
        scenario=session.scenario.name,
        seed=session.seed,
        pace=session.pace,
        factor=session.pacer.factor,
        time_step=session.time_step,
        tick=plant.now,
        on_silence=(silence or default).does,
        hold=(silence or default).after,
    )
    client.send(Message(type=Message.CLAIMED, claimed=found))


async def release(client: Client, message: Message) -> None:
    """Give a client's claimed vehicles back to their scenario's guidance, and acknowledge it."""
    _shared_world(client).release(client, _checked_names(message.release.vehicle))
    client.acknowledge()


async def command(client: Client, message: Message) -> None:
    """Take a client's orders for its vehicles; with pace "barrier", wait until the world has reached the client's next
    tick."""
    sharing, request = _shared_world(client), message.command
    orders = [order_of(order) for order in request.order]
    _check_one_order(orders)
    now = sharing.session.plant.now
    source = request.computed_from if request.HasField("computed_from") else None
    if source is not None and source > now:
        raise UsageError(f"COMMAND: computed_from {source}: the world is at tick {now}")
    until = request.until_tick if request.HasField("until_tick") else None
    if request.HasField("ticks"):
        if until is not None or not request.ticks:
            raise UsageError(f"COMMAND: ticks {request.ticks}; allowed: from 1, without until_tick")
        until = now + request.ticks
    if sharing.session.pace == "barrier":
        await sharing.meet(client, orders, source, until)
        client.send_frame(sharing.sensed(client, None, request.truth))
        return
    if until is not None:
        raise UsageError(
            "COMMAND: until_tick and ticks are for --pace barrier; this world runs by itself (--pace free), and an "
            "order is flown until the next one"
        )
    tick = sharing.order(client, orders, source)
    client.send(Message(type=Message.COMMANDED, commanded=pb.Commanded(tick=tick)))


def _check_one_order(orders: Sequence[Order]) -> None:
    """Raise UsageError if a vehicle gets two orders in one message."""
    for name, count in Counter(order.vehicle for order in orders).items():
        if count > 1:
            raise UsageError(f"COMMAND: '{name}' is given {count} orders; one is allowed")


async def subscribe(client: Client, message: Message) -> None:
    """Start or stop pushing vehicles' time-stamped sensor readings to the client."""
    sharing, request = _shared_world(client), message.subscribe
    if request.stop:
        sharing.subscribe(client, None)
        client.acknowledge()
        return
    session = sharing.session
    rate = request.rate if request.HasField("rate") else MOST_RATE_HZ
    if not (math.isfinite(rate) and rate > 0.0):
        raise UsageError(f"SUBSCRIBE: rate {rate:g} Hz; allowed: above 0")
    rows = tuple(session.plant.latches.row(name) for name in _checked_names(request.vehicle))
    every = max(1, round(1.0 / (min(rate, MOST_RATE_HZ) * session.time_step)))
    sharing.subscribe(client, Subscription(rows or None, every, request.truth))
    client.acknowledge()


async def get_status(client: Client, message: Message) -> None:
    """Send who controls each vehicle, and the age of its last order."""
    session = _shared_world(client).session
    plant = session.plant
    time = plant.now * session.time_step
    report = pb.Pacing(**vars(session.pacer.report()))
    found = pb.Status(pace=session.pace, tick=plant.now, t=time, pacing=report)
    for name, now in plant.controlled.items():
        optional = {"source_tick": now.source_tick, "arrival_tick": now.arrival_tick, "age": plant.age(name)}
        if now.silent_since is not None:
            optional["silent_since"] = now.silent_since * session.time_step
        given = {key: value for key, value in optional.items() if value is not None}
        holder = plant.claims.holder(name)
        found.vehicle.add(name=name, client=holder, flies=now.flies, misses=now.misses, **given)
    client.send(Message(type=Message.STATUS, status=found))
