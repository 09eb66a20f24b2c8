"""Links of the radio on the page: which halves are drawn, where, and in which colours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from tests.view.test_interference_layer import Watched
from tests.view.test_scene import PLACES, cast, frame

from qrsim.runs.colours import WIND
from qrsim.view import shapes
from qrsim.view.frame import Links
from qrsim.view.layers import Stage
from qrsim.view.radio import RadioLinks, halves
from qrsim.view.server import start_server

# Vehicle 0 hears 1 well, and 2 badly and not this time; 1 has no chance to hear 2; nobody sends to 2.
LINKS = Links(
    sender=np.array([[1, 2, -1], [2, -1, -1]]),
    error=np.array([[0.0, 0.99, 0.0], [0.75, 0.0, 0.0]]),
    outcome=np.array([[1, 2, 0], [3, 0, 0]]),
)


@pytest.fixture
def layer() -> Iterator[RadioLinks]:
    server = start_server(0)
    yield RadioLinks(Stage(server.scene, cast(PLACES), 2.0))
    server.stop()


def test_a_link_is_drawn_from_who_hears_to_half_way() -> None:
    start, vector, arrives, heard = halves(LINKS, PLACES, np.ones(3, bool))
    assert start.tolist() == [[0.0, 0.0, -10.0], [0.0, 0.0, -10.0]]
    assert vector.tolist() == [[15.0, 0.0, 0.0], [0.0, 20.0, -5.0]]
    assert arrives.tolist() == [1.0, 0.25]
    assert heard.tolist() == [True, False]
    # Who has stopped neither sends nor hears.
    assert len(halves(LINKS, PLACES, np.array([True, False, True]))[0]) == 1
    assert len(halves(LINKS, PLACES, np.array([False, True, True]))[0]) == 0


def test_who_loses_more_than_98_of_100_packets_is_no_link() -> None:
    faint = Links(np.array([[1, 2, 0]]), np.array([[0.979, 0.981, 0.999]]), np.full((1, 3), 2))
    assert halves(faint, PLACES, np.ones(3, bool))[2].tolist() == [pytest.approx(0.021)]


def test_a_lost_packet_is_thin_and_a_good_link_dark(layer: RadioLinks) -> None:
    layer._handle = watched = Watched()
    layer.draw(frame(PLACES))
    assert watched.sent == [], "nothing is known of a radio"
    layer.draw(replace(frame(PLACES), links=LINKS))
    sent = dict(watched.sent)
    # Room for all pairs of three; a vehicle is 2 m wide.
    assert sent["batched_scales"].shape == (6, 3)
    np.testing.assert_allclose(
        sent["batched_scales"][:3], [[15.0, 0.18, 0.18], [np.hypot(20.0, 5.0), 0.06, 0.06], [0.0, 0.0, 0.0]], rtol=1e-6
    )
    assert sent["batched_colors"][0].tolist() == shapes.linear(WIND[4].astype(np.uint8)).tolist()
    assert sent["batched_colors"][1].tolist() == shapes.linear(WIND[1].astype(np.uint8)).tolist()
    assert sent["batched_positions"].dtype == np.float64
