"""``qrsim mavlink``: what is refused before anything flies, and which sockets it has."""

from __future__ import annotations

import socket
from types import SimpleNamespace

import pytest

from qrsim import cli
from qrsim.apps.mavlink import Mavlink
from qrsim.links.mavlink import ports

BELOW = """
name: one_above_the_other
fleets:
  pair:
    controller: {type: cascade, feed: truth}
    vehicles: [{position_ned: [0, 0, -20]}, {position_ned: [0.5, 0, -10]}]
"""
DEAF = """
name: marks
fleets:
  marks: {vehicle: {type: fixed_point}, controller: {type: none}, vehicles: [{position_ned: [0, 0, -20]}]}
"""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--realtime", "0"], "--realtime 0: expected 0.001 to 1000"),
        (["--realtime", "nan"], "--realtime nan"),
        (["--seed", "-1"], "--seed -1: expected an integer from 0 to 2**63 - 1"),
        (["--first-sysid", "241"], "--first-sysid 241: expected 1 to 240"),
        (["--first-sysid", "238"], "5 vehicles; from system 238 on there are ids for 3 (to 240); give a smaller one"),
        (["--flavour", "px5"], "--flavour px5: expected px4 or ardupilot; did you mean 'px4'?"),
        (["--datum", "ellipsiod"], "--datum ellipsiod: expected sea or ellipsoid; did you mean 'ellipsoid'?"),
        (["--stream-time", "sym"], "--stream-time sym: expected wall or sim; did you mean 'sim'?"),
        (["--gcs", "192.0.2.1"], "--gcs 192.0.2.1: it is another machine, which could fly"),
        (["mavlink_feld"], "did you mean 'mavlink_field'?"),
    ],
)
def test_what_cannot_be_meant_is_refused(words, said, capsys):
    assert cli.main(["mavlink", *words]) == 2
    found = capsys.readouterr()
    assert said in found.err
    assert "Traceback" not in found.err


@pytest.mark.parametrize(
    ("text", "said"),
    [(BELOW, "with vehicles on the ground"), (DEAF, "no vehicle of the scenario can be flown")],
)
def test_scenarios_that_cannot_be_flown_are_refused(text, said, tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    assert cli.main(["mavlink", str(path)]) == 2
    assert said in capsys.readouterr().err


def test_ports_of_fifteen_vehicles():
    found = ports.opened(15, ports.HERE, False, False)
    found.close()
    own = ports.opened(15, ports.HERE, True, True)
    own.close()
    shift = found.onboard - 14580
    # From the tenth vehicle on all speak to one port, as PX4's own simulation does.
    assert [peer - shift for peer in found.peers] == [*range(14540, 14549), *[14549] * 6]
    assert (found.ground - shift, found.tcp, len(found.sockets)) == (18570, 0, 30)
    assert [peer - own.peers[0] for peer in own.peers] == list(range(15))
    assert len(own.sockets) == 31


def test_a_block_that_is_taken_is_passed_over():
    first = ports.opened(3, ports.HERE, True, False)
    try:
        second = ports.opened(3, ports.HERE, True, False)
        second.close()
        assert (second.block, second.onboard - first.onboard, second.ground - first.ground) == (
            first.block + 1,
            100,
            100,
        )
        assert (second.tcp - first.tcp, second.peers[0] - first.peers[0]) == (10, 100)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind((ports.HERE, second.ground + 1))
            third = ports.opened(3, ports.HERE, True, False)
            third.close()
            assert third.block == first.block + 2
    finally:
        first.close()


def test_a_block_that_is_taken_is_said():
    systems = [SimpleNamespace(number=number) for number in (1, 2)]
    world = SimpleNamespace(systems=systems, simulation=SimpleNamespace(size=3))
    third = ports.Ports(2, 14780, 18770, (14740, 14741), 5780, ())
    lines: list[str] = []
    Mavlink()._describe(world, third, ports.HERE, lines.append)
    assert lines == [
        "UDP 14580 and 18570 on, TCP 5760: taken, by another qrsim mavlink for example; these are ports of block 2",
        "a ground station that shows the other vehicles too needs other system ids: --first-sysid",
        "qrsim mavlink: 2 vehicles, systems 1 to 2",
        "programs: UDP 14740 to 14741, from 14780 to 14781",
        "ground station: UDP 127.0.0.1:14550, from 18770 to 18771",
        "TCP: 5780",
        "1 more of the scenario cannot be flown, and are no systems",
    ]
