"""Services of ROS 2 over DDS, for clients of rmw_fastrtps and of rmw_cyclonedds alike.

The first ones name a request by inline parameters of RTPS (rmw_fastrtps_shared_cpp, rmw_request.cpp, rmw_response.cpp),
the others by a header of the payload (rmw_cyclonedds_cpp, serdata.hpp: an identifier of the client, and a number). The
cyclonedds package cannot write the first, so this participant speaks RTPS itself.
"""

from __future__ import annotations

import os
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from uuid import uuid4

from qrsim.links.ros2.rtps import wire as w
from qrsim.links.ros2.rtps.history import Kept, Received
from qrsim.links.ros2.rtps.sockets import Sockets

# Built-in entities: of participants, publications and subscriptions, each a writer and a reader.
_PARTICIPANT = (b"\0\1\0\xc2", b"\0\1\0\xc7")
_PUBLICATIONS = (b"\0\0\3\xc2", b"\0\0\3\xc7")
_SUBSCRIPTIONS = (b"\0\0\4\xc2", b"\0\0\4\xc7")
_BUILTIN = 0x3F  # that this participant has: announcer and detector of each of the three
_WRITER, _READER = b"\x03", b"\x04"  # kinds of entities of users, without keys
_WRITERS = (0x02, 0x03)  # kinds of writers of users, with and without keys
_CYCLONE = b"\x01\x10"
_HEADER = slice(4, 20)
# It says that it is there so often, and is forgotten after so long [s].
_ANNOUNCE_S, _AGAIN_S, _LEASE_S, _SPIN_S = 3.0, 0.25, 60.0, 1e-3
# So many participants are known, and requests wait, at most.
_MOST_PEERS, _MOST_WAITING, _MOST_READERS = 256, 256, 256
# Remote writers whose sequence numbers are remembered, of all participants.
_MOST_WRITERS = 16 * _MOST_PEERS
_ROUNDS = 40


@dataclass
class _Peer:
    """Another participant.

    Attributes:
        meta, user: where its discovery and its readers are reached.
        heard: when, of ``time.monotonic`` [s].
        known: by built-in writer of this participant, the last sequence number that it has.
        left: how often it is still told what it has not confirmed.
    """

    meta: w.Locator
    user: w.Locator
    heard: float
    known: dict[bytes, int] = field(default_factory=dict)
    left: int = _ROUNDS


@dataclass(frozen=True)
class Request:
    """Which request a response is for.

    Attributes:
        inline: parameters of the response.
        header: of its payload.
    """

    inline: bytes
    header: bytes


class RawService:
    """A service, of bytes.

    Attributes:
        reader, writer: GUIDs of its entities.
        waiting: requests, and their messages in CDR.
        readers: GUIDs of clients' readers, and where each is reached.
        left: how often readers are still told what there is, until they have confirmed that they have it.
    """

    def __init__(self, prefix: bytes, number: int):
        entity = number.to_bytes(3, "big")
        self.reader, self.writer = prefix + entity + _READER, prefix + entity + _WRITER
        self.kept = Kept(self.writer[12:])
        self.waiting: deque[tuple[Request, bytes]] = deque(maxlen=_MOST_WAITING)
        self.readers: dict[bytes, w.Locator] = {}
        self.left: dict[bytes, int] = {}

    def forget(self, which: Callable[[bytes], bool]) -> None:
        """Remove the clients' readers for whose GUID ``which`` returns True."""
        for guid in [guid for guid in self.readers if which(guid)]:
            del self.readers[guid]
            self.left.pop(guid, None)


class Services:
    """A participant that answers services.

    Args:
        domain: of DDS.
        prefix: of its GUIDs, 12 bytes that begin with the number of its vendor; None: of no vendor, and random.

    Raises:
        OSError: there is no port, or no multicast.
    """

    def __init__(self, domain: int, prefix: bytes | None = None):
        self._sockets = Sockets(domain)
        self._domain, self._prefix = domain, prefix or b"\0\0" + os.urandom(10)
        self._peers: dict[bytes, _Peer] = {}
        self._received: dict[tuple[bytes, bytes], Received] = {}
        self._services: list[RawService] = []
        # By name of a topic; by entity; and by the GUID of the writer of a client.
        self._by_name: dict[str, RawService] = {}
        self._clients: dict[bytes, RawService] = {}
        self._by_reader: dict[bytes, RawService] = {}
        self._by_writer: dict[bytes, RawService] = {}
        # What others are told of its writers and readers.
        self._told = {
            _PUBLICATIONS[0]: Kept(_PUBLICATIONS[0], 10**6),
            _SUBSCRIPTIONS[0]: Kept(_SUBSCRIPTIONS[0], 10**6),
        }
        self._announced = self._spun = self._repeated = 0.0

    def service(self, name: str, request: str, response: str) -> RawService:
        """Return a new service with a name and the DDS types of request and response.

        Args:
            name: in ROS, such as "/uav/mavros/cmd/arming".
            request, response: names of their types in DDS.
        """
        made = RawService(self._prefix, len(self._services) + 1)
        self._services.append(made)
        self._by_name[f"rr{name}Reply"] = self._by_name[f"rq{name}Request"] = made
        self._by_reader[made.reader[12:]], self._by_writer[made.writer[12:]] = made, made
        # By it clients know which reader and writer belong together.
        identity = f"serviceid={uuid4().hex};".encode()
        for told, guid, topic, kind in (
            (_SUBSCRIPTIONS, made.reader, f"rq{name}Request", request),
            (_PUBLICATIONS, made.writer, f"rr{name}Reply", response),
        ):
            self._told[told[0]].add(w.PL_CDR + self._endpoint(guid, topic, kind, identity))
        return made

    def _endpoint(self, guid: bytes, topic: str, kind: str, identity: bytes) -> bytes:
        """Return the RTPS parameter list that announces a reliable, volatile reader or writer of a topic."""
        places = [(w.UNICAST, w.locator(*place)) for place in self._sockets.own]
        return w.listed(
            (w.ENDPOINT_GUID, guid),
            (w.PARTICIPANT_GUID, self._prefix + b"\0\0\1\xc1"),
            (w.TOPIC, w.text(topic)),
            (w.TYPE, w.text(kind)),
            (w.RELIABILITY, struct.pack("<IiI", 2, 0, 0)),
            (w.DURABILITY, bytes(4)),
            (w.USER_DATA, w.octets(identity)),
            (w.VERSION, b"\2\3"),
            (w.VENDOR, b"\0\0"),
            *places,
        )

    def reply(self, service: RawService, request: Request, cdr: bytes) -> None:
        """Send a response, encoded in CDR, to all clients of a service; the request's identity marks whose it is."""
        payload = cdr[: _HEADER.start] + request.header + cdr[_HEADER.start :]
        sequence = service.kept.add(payload, request.inline)
        for guid, place in service.readers.items():
            parts = service.kept.message(guid[12:], sequence), service.kept.heartbeat(guid[12:])
            self._sockets.send(w.packet(self._prefix, *parts, to=guid[:12]), place)
            service.left[guid] = _ROUNDS

    # ---- what comes in ----

    def spin(self) -> None:
        """Read and answer all packets that have arrived; never waits."""
        now = time.monotonic()
        if now - self._spun < _SPIN_S:
            return
        self._spun = now
        if now - self._announced > _ANNOUNCE_S:
            self._announced = now
            self._sockets.announce(self._presence())
            for prefix in [prefix for prefix, peer in self._peers.items() if now - peer.heard > _LEASE_S]:
                self._forget(prefix)
        for packet in self._sockets.received():
            for message in w.submessages(packet, self._prefix):
                # What is malformed, or of somebody who is not known, is dropped.
                with suppress(struct.error, IndexError, ValueError, KeyError):
                    if message.prefix != self._prefix:
                        self._handle_submessage(message, now)
        if now - self._repeated > _AGAIN_S:
            self._repeated = now
            self._repeat_unconfirmed()

    def _handle_submessage(self, message: w.Submessage, now: float) -> None:
        """Handle a DATA, HEARTBEAT, ACKNACK or GAP submessage; ignore others. ``now``: time [s]."""
        if message.kind == w.DATA:
            self._take_data(message, now)
        elif message.kind == w.HEARTBEAT:
            self._take_heartbeat(message)
        elif message.kind == w.ACKNACK:
            self._take_acknack(message)
        elif message.kind == w.GAP:
            writer = message.body[4:8]
            base, members = w.numbers_at(message, 16)
            received = self._received_from(message.prefix, writer)
            received.skip(w.number_at(message, 8), base - 1)
            for each in members:
                received.skip(each, each)

    def _received_from(self, prefix: bytes, writer: bytes) -> Received:
        """Return the received sequence numbers of a remote writer; raises KeyError for an unknown or surplus writer."""
        known = self._received.get((prefix, writer))
        if known is None:
            if prefix not in self._peers or len(self._received) >= _MOST_WRITERS:
                raise KeyError
            known = self._received[prefix, writer] = Received()
        return known

    def _take_data(self, message: w.Submessage, now: float) -> None:
        """Handle a DATA submessage: discovery of participants or endpoints, or a service request."""
        reader, writer, sequence = message.body[4:8], message.body[8:12], w.number_at(message, 12)
        inline, payload = w.data_parts(message)
        if writer == _PARTICIPANT[0]:
            self._store_peer(message, inline, payload, now)
        elif writer in (_PUBLICATIONS[0], _SUBSCRIPTIONS[0]):
            if self._received_from(message.prefix, writer).take(sequence):
                self._store_endpoint(message.prefix, inline, payload)
        else:
            service = self._service_of(message.prefix, reader, writer)
            if self._received_from(message.prefix, writer).take(sequence):
                self._take_request(service, message, inline, payload)

    def _service_of(self, prefix: bytes, reader: bytes, writer: bytes) -> RawService:
        """Return the service that a DATA submessage is for, by its reader, or, if that is unknown, by its writer."""
        return self._clients[prefix + writer] if reader == w.UNKNOWN_ENTITY else self._by_reader[reader]

    def _store_peer(self, message: w.Submessage, inline: list[tuple[int, bytes]], payload: bytes, now: float) -> None:
        """Store another participant from its announcement and announce this one to it; remove one that leaves."""
        if (w.STATUS, w.GONE) in inline:
            self._forget(message.prefix)
            return
        found, little = w.parameters(payload), payload[1:2] == b"\3"
        places = [
            [place for value in found.get(kind, []) if (place := w.locator_of(value, little)) is not None]
            for kind in (w.METATRAFFIC, w.DEFAULT_UNICAST)
        ]
        domain = found.get(w.DOMAIN)
        if (
            not places[0]
            or not places[1]
            or (domain and struct.unpack("<I" if little else ">I", domain[0][:4])[0] != self._domain)
        ):
            return
        peer = self._peers.get(message.prefix)
        if peer is not None:
            peer.heard = now
        elif len(self._peers) < _MOST_PEERS:
            peer = self._peers[message.prefix] = _Peer(
                self._nearest_locator(places[0]), self._nearest_locator(places[1]), now
            )
            self._sockets.send(self._presence(), peer.meta)
            self._sockets.announce(self._presence())
            self._announce_to(message.prefix, peer, again=False)

    def _nearest_locator(self, places: list[w.Locator]) -> w.Locator:
        """Return a remote participant's address that is in one of this machine's networks, else its first one."""
        nets = {address.rpartition(".")[0] for address, _ in self._sockets.own}
        return next((place for place in places if place[0].rpartition(".")[0] in nets), places[0])

    def _forget(self, prefix: bytes) -> None:
        """Remove a remote participant and its clients; ``prefix``: first 12 bytes of their GUIDs."""
        self._peers.pop(prefix, None)
        self._received = {key: value for key, value in self._received.items() if key[0] != prefix}
        self._clients = {guid: service for guid, service in self._clients.items() if guid[:12] != prefix}
        for service in self._services:
            service.forget(lambda guid: guid[:12] == prefix)

    def _store_endpoint(self, prefix: bytes, inline: list[tuple[int, bytes]], payload: bytes) -> None:
        """Store, or remove, a remote client's reader or writer from its announcement."""
        found, little = w.parameters(payload), payload[1:2] == b"\3"
        guid = (found.get(w.ENDPOINT_GUID) or [bytes(16)])[0][:16]
        if any(identifier == w.STATUS and value[3:4] in (b"\1", b"\2", b"\3") for identifier, value in inline):
            self._clients.pop(guid, None)
            for service in self._services:
                service.forget(lambda other: other == guid)
            return
        own = self._by_name.get(w.text_of(found[w.TOPIC][0], little))
        if own is None or guid[:12] != prefix:
            return
        if guid[15] in _WRITERS:
            if len(self._clients) < _MOST_PEERS * len(self._services):
                self._clients[guid] = own
        elif len(own.readers) < _MOST_READERS:
            places = [place for value in found.get(w.UNICAST, []) if (place := w.locator_of(value, little)) is not None]
            own.readers[guid] = self._nearest_locator(places) if places else self._peers[prefix].user
            # Its request may have been answered before.
            own.left[guid] = _ROUNDS

    def _take_request(
        self, service: RawService, message: w.Submessage, inline: list[tuple[int, bytes]], payload: bytes
    ) -> None:
        """Queue a service request together with the identity that its response must carry."""
        if message.vendor == _CYCLONE:
            header, cdr = payload[_HEADER], payload[: _HEADER.start] + payload[_HEADER.stop :]
            service.waiting.append((Request(b"", header), cdr))
            return
        # A client of Fast DDS names its reader, so that the response can wait for it; else its writer is it.
        known = next((value for identifier, value in inline if identifier in (w.RELATED, w.RELATED_BEFORE)), b"")
        client = known[: w.GUID_SIZE]
        if len(client) < w.GUID_SIZE or client in (bytes(16), client[:12] + w.UNKNOWN_ENTITY):
            client = message.prefix + message.body[8:12]
        identity = client + w.number(w.number_at(message, 12))
        answer = w.listed((w.RELATED, identity), (w.RELATED_BEFORE, identity))
        service.waiting.append((Request(answer, b""), payload))

    def _take_heartbeat(self, message: w.Submessage) -> None:
        """Answer a remote writer's HEARTBEAT with the sequence numbers that are missing here."""
        reader, writer = message.body[:4], message.body[4:8]
        is_builtin = writer in (_PUBLICATIONS[0], _SUBSCRIPTIONS[0])
        if is_builtin:
            reader = _PUBLICATIONS[1] if writer == _PUBLICATIONS[0] else _SUBSCRIPTIONS[1]
        else:
            reader = self._service_of(message.prefix, reader, writer).reader[12:]
        first, last = w.number_at(message, 8), w.number_at(message, 16)
        answer = self._received_from(message.prefix, writer).answer(reader, writer, first, last)
        peer = self._peers[message.prefix]
        place = peer.meta if is_builtin else peer.user
        self._sockets.send(w.packet(self._prefix, answer, to=message.prefix), place)

    def _take_acknack(self, message: w.Submessage) -> None:
        """Send a remote reader the messages that its ACKNACK asks for, and note which it has received."""
        reader, writer = message.body[:4], message.body[4:8]
        base, missing = w.numbers_at(message, 8)
        peer = self._peers[message.prefix]
        if writer in self._told:
            kept, place = self._told[writer], peer.meta
            peer.known[writer] = max(peer.known.get(writer, 0), base - 1)
        else:
            service = self._by_writer[writer]
            guid = message.prefix + reader
            kept, place = service.kept, service.readers[guid]
            if base > kept.last:
                service.left.pop(guid, None)
        parts = [kept.message(reader, each) for each in missing if each <= kept.last]
        if parts:
            self._sockets.send(w.packet(self._prefix, *parts, kept.heartbeat(reader), to=message.prefix), place)

    # ---- what goes out ----

    def _presence(self) -> bytes:
        """Return the RTPS packet that announces this participant to others."""
        places = [
            (kind, w.locator(*place)) for kind in (w.METATRAFFIC, w.DEFAULT_UNICAST) for place in self._sockets.own
        ]
        payload = w.PL_CDR + w.listed(
            (w.VERSION, b"\2\3"),
            (w.VENDOR, b"\0\0"),
            (w.PARTICIPANT_GUID, self._prefix + b"\0\0\1\xc1"),
            (w.DOMAIN, struct.pack("<I", self._domain)),
            (w.BUILTIN, struct.pack("<I", _BUILTIN)),
            (w.LEASE, struct.pack("<iI", int(_LEASE_S), 0)),
            (w.USER_DATA, w.octets(b"enclave=/;")),
            *places,
        )
        return w.packet(self._prefix, w.data(_PARTICIPANT[1], _PARTICIPANT[0], 1, payload))

    def _announce_to(self, prefix: bytes, peer: _Peer, again: bool) -> None:
        """Announce all services to another participant, in full unless ``again``, and request its announcements."""
        for writer, reader in (_PUBLICATIONS, _SUBSCRIPTIONS):
            kept = self._told[writer]
            for part in () if again else kept.all(reader):
                self._sockets.send(w.packet(self._prefix, part, to=prefix), peer.meta)
            # The acknowledgement names the announcements received so far; the other sends the missing ones.
            asked = self._received_from(prefix, writer).answer(reader, writer, 1, 0)
            self._sockets.send(w.packet(self._prefix, kept.heartbeat(reader), asked, to=prefix), peer.meta)

    def _repeat_unconfirmed(self) -> None:
        """Send announcements, and heartbeats of responses, again if others have not acknowledged them."""
        for prefix, peer in self._peers.items():
            behind = any(peer.known.get(writer, 0) < kept.last for writer, kept in self._told.items())
            if behind and peer.left:
                peer.left -= 1
                self._announce_to(prefix, peer, again=True)
        for service in self._services:
            for guid, left in list(service.left.items()):
                self._sockets.send(
                    w.packet(self._prefix, service.kept.heartbeat(guid[12:]), to=guid[:12]), service.readers[guid]
                )
                service.left[guid] = left - 1
                if left == 1:
                    del service.left[guid]

    def close(self) -> None:
        """Announce that this participant leaves the network, and close its sockets."""
        payload = w.PL_CDR + w.listed((w.PARTICIPANT_GUID, self._prefix + b"\0\0\1\xc1"))
        inline = w.listed((w.STATUS, w.GONE))
        self._sockets.announce(
            w.packet(self._prefix, w.data(_PARTICIPANT[1], _PARTICIPANT[0], 2, payload, inline, is_key=True))
        )
        self._sockets.close()
