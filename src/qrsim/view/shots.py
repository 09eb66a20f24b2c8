"""What a picture shows: from where, how large, and which layers; by words that a user can type."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.view.overlay import SOUTH
from qrsim.view.scene import Scene
from qrsim.world.state import World

# Where the camera is, from what it looks at, NED; "above" has north up.
DIRECTIONS = {
    "south": SOUTH,
    "north": (0.85, 0.3, -0.45),
    "east": (0.3, 0.85, -0.45),
    "west": (-0.3, -0.85, -0.45),
    "above": (-0.02, 0.0, -1.0),
}
# Cameras that go with a vehicle.
RIDES = ("chase", "onboard")
# A view of all that vehicles may fly in, and how far from it the camera is, in diagonals of it.
AREA, FAR = "area", 0.8
# From a vehicle that is looked at, in spans as it is drawn.
CLOSE = 5.0
SMALLEST, LARGEST = 100, 8192
WIDTH, HEIGHT = 1280, 800


@dataclass(frozen=True)
class Camera:
    """From where a picture is taken.

    Attributes:
        vehicle: that is in the middle; None: all are in the picture.
        direction: one of DIRECTIONS, or AREA, or with a vehicle one of RIDES; None: that of the page.
    """

    vehicle: str | None = None
    direction: str | None = None

    @staticmethod
    def parsed(text: str, vehicles: Iterable[str]) -> Camera:
        """Parse the camera option: VEHICLE, DIRECTION (such as north), VEHICLE:DIRECTION or "area".

        Raises:
            UsageError: there is no such vehicle, or no such direction.
        """
        vehicles = tuple(vehicles)
        name, colon, direction = text.rpartition(":")
        if not colon:
            if text in vehicles:
                return Camera(text)
            if text in (*DIRECTIONS, AREA):
                return Camera(None, text)
            raise UsageError(f"--camera {text}: no such view{did_you_mean(text, (*DIRECTIONS, AREA, *vehicles))}")
        if name not in vehicles:
            raise UsageError(f"--camera {text}: no vehicle '{name}'{did_you_mean(name, vehicles)}")
        known = (*DIRECTIONS, *RIDES)
        if direction not in known:
            raise UsageError(f"--camera {text}: no direction '{direction}'{did_you_mean(direction, known)}")
        return Camera(name, direction)

    def aim(self, scene: Scene, world: World | None = None) -> None:
        """Set the first view of a scene's pages to this camera; the scene must have drawn a frame."""
        if self.vehicle is not None and scene.frame is not None:
            number = scene.cast.names.index(self.vehicle)
            scene.choose(number)
            at = np.nan_to_num(scene.frame.position_ned[number])
            scene.look(at, CLOSE * scene.stage.span, DIRECTIONS.get(self.direction or "", SOUTH))
            if self.direction in RIDES:
                scene.overlay.ride(number, self.direction)
        elif self.direction == AREA:
            corners = _corners(scene, world)
            low, high = corners.min(axis=0), corners.max(axis=0)
            scene.look(0.5 * (low + high), FAR * float(np.linalg.norm(high - low)))
        elif self.direction is not None:
            scene.look_from(DIRECTIONS[self.direction])


def _corners(scene: Scene, world: World | None) -> NumpyArray:
    """Return corners (2, 3) NED [m] of the area if it is a known box; else the vehicles' starts (n, 3)."""
    area = None if world is None else world.area
    if area is None or not area.is_box:
        return scene.cast.start_ned
    return np.array([[float(getattr(area, f"{axis}_{end}")) for axis in "xyz"] for end in ("min", "max")])


def parsed_size(text: str) -> tuple[int, int]:
    """Parse a picture size such as "1920x1080" to width and height [pixels].

    Raises:
        UsageError: it is no size, or too small or too large.
    """
    found = re.fullmatch(r"(\d{1,9})[xX](\d{1,9})", text.strip())
    size = tuple(int(side) for side in found.groups()) if found else (0, 0)
    if not all(SMALLEST <= side <= LARGEST for side in size):
        raise UsageError(f"--size {text}: expected WIDTHxHEIGHT of {SMALLEST} to {LARGEST} pixels, such as 1920x1080")
    return size[0], size[1]


def parsed_layers(text: str, shown: dict[str, bool]) -> dict[str, bool]:
    """Return layer -> whether it is shown: only the named ones, or all shown at first but those after "-".

    Args:
        text: such as "vehicles, true paths", "-poles, -gusts" or "all".
        shown: title of each layer, and whether it is shown at first.

    Raises:
        UsageError: there is no such layer, or names with and without "-" are mixed.
    """
    words = [word.strip() for word in text.split(",") if word.strip()]
    less = [word.startswith("-") for word in words]
    if not words or len(set(less)) > 1:
        raise UsageError(f"--layers {text}: expected names of layers, separated by commas, or all of them after '-'")
    if words == ["all"]:
        return dict.fromkeys(shown, True)
    names = [word.removeprefix("-").strip() for word in words]
    for name in names:
        if name not in shown:
            raise UsageError(f"--layers {text}: no layer '{name}'{did_you_mean(name, (*shown, 'all'))}")
    return {title: (on and title not in names) if less[0] else title in names for title, on in shown.items()}
