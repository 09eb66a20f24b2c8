"""The words of a picture: camera, size and layers."""

from __future__ import annotations

import pytest

from qrsim.errors import UsageError
from qrsim.view.shots import Camera, parsed_layers, parsed_size

SHOWN = {"vehicles": True, "true paths": True, "gusts": True, "GNSS positions": False}
NAMES = ("pelicans_0", "pelicans_1", "mouse")


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("above", Camera(None, "above")),
        ("area", Camera(None, "area")),
        ("mouse", Camera("mouse")),
        ("pelicans_1:east", Camera("pelicans_1", "east")),
    ],
)
def test_a_camera_is_a_direction_a_vehicle_or_both(text: str, meant: Camera):
    assert Camera.parsed(text, NAMES) == meant


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("abov", "no such view; did you mean 'above'?"),
        ("mousse", "no such view; did you mean 'mouse'?"),
        ("pelican_1:east", "no vehicle 'pelican_1'; did you mean 'pelicans_1'?"),
        ("mouse:eats", "no direction 'eats'; did you mean 'east'?"),
        ("", "no such view; known: south, north, east, west, above, area"),
    ],
)
def test_a_wrong_camera_is_refused_with_the_right_name(text: str, said: str):
    with pytest.raises(UsageError) as error:
        Camera.parsed(text, NAMES)
    assert said in str(error.value)


def test_sizes():
    assert parsed_size("1920x1080") == (1920, 1080)
    assert parsed_size("100X8192") == (100, 8192)
    for wrong in ("1920", "0x0", "99x100", "100x8193", "-5x100", "1920x1080x3", "a x b", "1e3x100", ""):
        with pytest.raises(UsageError, match="expected WIDTHxHEIGHT of 100 to 8192 pixels, such as 1920x1080"):
            parsed_size(wrong)


def test_layers_are_those_named_or_all_but_those():
    assert parsed_layers("vehicles, true paths", SHOWN) == {
        "vehicles": True,
        "true paths": True,
        "gusts": False,
        "GNSS positions": False,
    }
    # What is hidden at first stays hidden.
    assert parsed_layers("-gusts", SHOWN) == {
        "vehicles": True,
        "true paths": True,
        "gusts": False,
        "GNSS positions": False,
    }
    assert all(parsed_layers("all", SHOWN).values())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("vehicle", "no layer 'vehicle'; did you mean 'vehicles'?"),
        ("-gust", "no layer 'gust'; did you mean 'gusts'?"),
        ("vehicles,-gusts", "expected names of layers, separated by commas, or all of them after '-'"),
        (" , ", "expected names of layers"),
    ],
)
def test_wrong_layers_are_refused_with_the_right_name(text: str, said: str):
    with pytest.raises(UsageError) as error:
        parsed_layers(text, SHOWN)
    assert said in str(error.value)
