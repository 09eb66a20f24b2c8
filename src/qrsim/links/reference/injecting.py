"""Handlers of requests that let something fail, or change the wind; each sends exactly one ACK."""

from __future__ import annotations

import contextlib
from dataclasses import replace

from qrsim.errors import UsageError
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.roles import Client
from qrsim.links.reference.sharing import Sharing
from qrsim.scenarios.live_requests import Request, apply
from qrsim.simulation.injections import OK, plain_target, targets_of
from qrsim.world.state import World


async def inject(client: Client, message: Message) -> None:
    """Apply a fault or a change of the weather that an INJECT message requests, and acknowledge it."""
    await _apply_request(client, "INJECT", request_of(message.inject))


async def clear(client: Client, message: Message) -> None:
    """End the injected faults that a CLEAR message names, and acknowledge it."""
    asked = message.clear
    target = asked.target if asked.HasField("target") else None
    _check_texts([*asked.vehicle, target or ""])
    await _apply_request(client, "CLEAR", Request(target, OK, tuple(asked.vehicle) or None))


def request_of(asked: pb.Inject) -> Request:
    """Convert an INJECT message to an injection request; raises UsageError for invalid texts and numbers given
    twice."""
    _check_texts([asked.target, asked.kind, asked.field, *asked.vehicle, *(each.name for each in asked.number)])
    numbers: dict[str, object] = {"field": asked.field} if asked.HasField("field") else {}
    for each in asked.number:
        if each.name in numbers:
            raise UsageError(f"INJECT: {each.name[:60]} is given twice")
        numbers[each.name] = each.value
    at = asked.at if asked.HasField("at") else None
    duration = asked.duration if asked.HasField("duration") else None
    return Request(asked.target, asked.kind, tuple(asked.vehicle) or None, at, duration, numbers)


def _check_texts(texts: list[object]) -> None:
    """Raise UsageError unless all texts of a message are UTF-8 (protobuf gives others as bytes)."""
    # What is not UTF-8 comes as bytes.
    if not all(isinstance(text, str) for text in texts):
        raise UsageError("message: a text is not UTF-8")


async def _apply_request(client: Client, what: str, request: Request) -> None:
    """Apply an injection request to the client's session or to its claimed vehicles, and acknowledge it; ``what``:
    message name."""
    session, sharing = client.required_session(), client.server.sharing
    still: contextlib.AbstractAsyncContextManager[object] = contextlib.nullcontext()
    if sharing is not None:
        request, still = _claimed_request(client, sharing, what, request), sharing.lock
    async with still:
        asked_by = f"tcp:{client.number}"
        done = await client.server.run(session, lambda: apply(session.simulation, request, asked_by))
    client.acknowledge(note=done)


def _claimed_request(client: Client, sharing: Sharing, what: str, request: Request) -> Request:
    """Return an injection request for the client's claimed vehicles only, by default those with the target; ``what``:
    message name.

    Raises:
        UsageError: one is not claimed by it, or the request is for the whole world and the operator does not allow it.
    """
    if request.of_world:
        if not client.server.options.allow_inject:
            raise UsageError(f"{what}: the wind is that of all clients; its operator has to allow it (--allow-inject)")
        return request
    claims = sharing.session.plant.claims
    for name in request.vehicles or ():
        claims.check_own(client.number, name, what)
    if request.vehicles is not None:
        return request
    mine = claims.of(client.number)
    if not mine:
        raise UsageError(f"{what}: this client has claimed no vehicle; CLAIM first")
    having = _vehicles_with(sharing.session.simulation.world, request.target)
    return replace(request, vehicles=tuple(name for name in mine if name in having) or mine)


def _vehicles_with(world: World, target: str | None) -> set[str]:
    """Return the names of the vehicles that have a sensor or part (``target``); all names without a target."""
    fleets = [fleet for fleet in world.fleets if target is None or plain_target(target) in targets_of(fleet)]
    return {name for fleet in fleets for name in fleet.vehicle_names}
