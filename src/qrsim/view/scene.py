"""The scene of a page: its layers, and the camera with the vehicle it follows."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
from viser import ViserServer

from qrsim.core.arrays import Floats
from qrsim.view.air import AIR, Air, air_layers
from qrsim.view.cameras import camera_layers
from qrsim.view.contents import contents_layers
from qrsim.view.differences import difference_layers
from qrsim.view.ellipsoids import ellipsoid_layers
from qrsim.view.frame import Cast, Frame
from qrsim.view.ground import Area, Ground, Obstacles, keep_out_layers
from qrsim.view.imagery import Image, Imagery
from qrsim.view.interference import interference_layers
from qrsim.view.jets import wake_layers
from qrsim.view.labels import LabelStates
from qrsim.view.layers import Ghosts, Gusts, Layer, Names, Poles, Stage, Vehicles, Wind
from qrsim.view.overlay import SOUTH, Overlay
from qrsim.view.paint import Paint
from qrsim.view.paths import EstimatedPaths, Paths, Routes
from qrsim.view.radio import radio_layers
from qrsim.view.rays import ray_layers
from qrsim.view.task import task_layers
from qrsim.view.thermals import thermal_layers
from qrsim.world.state import World

# Spans of a drawn vehicle [m]: that of a Pelican, and the largest of a few; of many, a part of the room that each has.
SMALLEST_SPAN, LARGEST_SPAN, SHARE_OF_ROOM, MANY = 0.65, 12.0, 0.35, 50
# Lag of a browser [s] that spares it nothing; how much less often it may come to; what is left of that a frame later.
LAG_S, MOST_STRAIN, STRAIN_LEFT = 0.15, 16.0, 0.99
# Lags of a slow browser between two of its things beside the vehicles: what it waits for holds one of them at most.
SPARED = 1.25
GOLDEN = 0.618034


class Scene:
    """Everything that is drawn of one world, in NED.

    Args:
        server: of the page.
        cast: who is in it.
        world: what there is; None where that is not known, and only vehicles and ground are drawn.
        title: of the page, beside "qrsim".
        imagery: picture of the ground; None: none.

    Attributes:
        cast: who is in it.
        layers: what can be shown or hidden, by title.
        overlay: what browsers draw over it by themselves.
        frame: the last one drawn; None before the first.
        lag_s: returns how far behind the slowest browser is [s].
    """

    def __init__(
        self, server: ViserServer, cast: Cast, world: World | None, title: str = "", imagery: Imagery | None = None
    ):
        self._server = server
        self.cast = cast
        self.frame: Frame | None = None
        self.lag_s: Callable[[], float] = lambda: 0.0
        self._strain, self._spared_at = 1.0, 0.0
        # Drawn by one thread, changed by those of the panel.
        self._lock = threading.RLock()
        scene = server.scene
        scene.set_up_direction((0.0, 0.0, -1.0))
        hilly = world is not None and not world.ground.at_zero
        scene.add_light_ambient("/light", intensity=0.8 if hilly else 1.2)
        scene.configure_default_lights(enabled=not hilly, cast_shadow=False)
        if hilly:
            # A low sun in the north-west, as on maps: it shades the slopes.
            scene.add_light_directional("/light/sun", intensity=3.4, position=(1.0, -1.0, -1.0))
        scene.add_frame("/world", show_axes=False)
        self.stage = Stage(scene, self.cast, _span(cast), ground=None if world is None else world.ground)
        self.vehicles = Vehicles(self.stage)
        self.paths = (Paths(self.stage), EstimatedPaths(self.stage))
        others, names, states = (Poles, Ghosts, Wind, Gusts), Names(self.stage), LabelStates(self.stage)
        moving = [*self.paths, *(layer(self.stage) for layer in others), names, states, *difference_layers(self.stage)]
        solid: list[Layer] = []
        if world is not None:
            solid = [Area(self.stage, world), *keep_out_layers(self.stage, world), Obstacles(self.stage, world)]
            solid += contents_layers(self.stage, world)
            solid += [*camera_layers(self.stage, world), *air_layers(self.stage, world)]
            solid += [*interference_layers(self.stage, world), *radio_layers(self.stage, world)]
            solid += [*ellipsoid_layers(self.stage, world), *ray_layers(self.stage, world)]
            solid += [*wake_layers(self.stage, world), *thermal_layers(self.stage, world)]
        solid += [*task_layers(self.stage, cast.places), *([Routes(self.stage)] if any(map(len, cast.routes)) else [])]
        ground = Ground(self.stage, world)
        picture = [] if imagery is None else [Image(self.stage, imagery)]
        layers: list[Layer] = [ground, *picture, *solid, self.vehicles, *moving]
        self.layers = {layer.title: layer for layer in layers}
        marked = (ground.north, ground.cell)
        self.overlay = Overlay(server, self.stage, self.vehicles.bodies, self.layers, title, marked)
        names.tell, states.tell = self.overlay.say, self.overlay.states
        # Parts of the way to their next drawing, spread so that not all are due at the same frame.
        self._due = [1.0 - GOLDEN * number % 1.0 for number in range(len(layers))]
        self._look()

    def _look(self) -> None:
        """Set the first view of pages opened later: from the south, with all starts, routes and paths."""
        # Vehicles leave where they start; what they fly in is seen as a whole.
        self._begin(self.cast.centre, self.cast.extent * (1.15 if self.cast.around is None else 0.8))
        self._server.initial_camera.near, self._server.initial_camera.far = 0.1, max(1000.0, 20.0 * self.cast.extent)

    def look(self, at: Floats, distance: float, from_ned: tuple[float, float, float] = SOUTH) -> None:
        """Make new pages view the point ``at`` (3,) NED [m] from a distance [m]; camera in direction ``from_ned``."""
        self._begin(at, distance, from_ned)
        self.overlay.hold()

    def _begin(self, at: Floats, distance: float, from_ned: tuple[float, float, float] = SOUTH) -> None:
        """Set the camera of new pages at ``distance`` [m] from the point ``at``, in direction ``from_ned`` of it."""
        camera = self._server.initial_camera
        camera.up = (0.0, 0.0, -1.0)
        camera.look_at = tuple(at)
        camera.position = tuple(np.asarray(at) + distance * np.array(from_ned))

    def look_from(self, direction: tuple[float, float, float]) -> None:
        """Make new pages view all vehicles from a camera in this direction (NED) of them."""
        self._begin(self.cast.centre, self.cast.extent, direction)
        self.overlay.look_from(direction)

    def draw(self, frame: Frame, everything: bool = False) -> None:
        """Draw the layers that are due for this frame; ``everything``: all visible ones.

        Args:
            frame: what to show.
            everything: also what is otherwise drawn at some frames only.
        """
        with self._lock, self._server.atomic():
            everything, self.frame = everything or self.frame is None, frame
            for paths in self.paths:
                paths.note(frame)
            strain, waiting = self._strained(), []
            for number, layer in enumerate(self.layers.values()):
                # Not all at the same frame.
                self._due[number] += 1.0 if everything else 1.0 / (layer.every * (strain if layer.every > 1.0 else 1.0))
                if (layer.root.visible or layer.always) and self._due[number] >= 1.0:
                    if strain > 1.0 and layer.every > 1.0 and not everything:
                        waiting.append((number, layer))
                    else:
                        self._draw(number, layer)
            if waiting and time.perf_counter() - self._spared_at > SPARED * self.lag_s():
                self._spared_at = time.perf_counter()
                self._draw(*max(waiting, key=lambda late: self._due[late[0]]))

    def _draw(self, number: int, layer: Layer) -> None:
        """Draw layer ``number`` at the present frame, and count its next drawing from now."""
        self._due[number] %= 1.0
        assert self.frame is not None
        layer.draw(self.frame)

    def _strained(self) -> float:
        """Return the factor, at least 1, by which slow browsers lower the drawing rate of layers except vehicles."""
        self._strain = min(MOST_STRAIN, max(1.0, self.lag_s() / LAG_S, STRAIN_LEFT * self._strain))
        return self._strain

    def show(self, title: str, visible: bool) -> None:
        """Show or hide the layer with this title; hidden layers are not drawn."""
        layer = self.layers[title]
        with self._lock:
            layer.root.visible = visible
            if (visible or layer.always) and self.frame is not None:
                layer.draw(self.frame)

    def colour(self, paint: Paint | None) -> None:
        """Colour vehicles and true paths by a quantity; None: each vehicle in its usual colour."""
        with self._lock, self._server.atomic():
            self.stage.paint = paint
            self.overlay.paint(None if paint is None else paint.told())
            self.paths[0].repaint()
            if self.frame is not None:
                for layer in (self.vehicles, self.paths[0]):
                    layer.draw(self.frame)

    @property
    def air(self) -> Air | None:
        """Layer of wind arrows on a plane; None in a world with the same wind everywhere."""
        found = self.layers.get(AIR)
        return found if isinstance(found, Air) else None

    def show_air(self, height: float, shows: str) -> None:
        """Set the height [m] of the plane of wind arrows, and whether they show gusts (GUST) or all wind (WHOLE)."""
        layer = self.air
        if layer is None:
            return
        with self._lock, self._server.atomic():
            layer.height, layer.shows = height, shows
            if layer.root.visible and self.frame is not None:
                layer.draw(self.frame)

    def resize(self, span: float) -> None:
        """Set the drawn size of a vehicle [m], and scale arrows with it."""
        self.stage.span = span
        if self.frame is not None:
            self.draw(self.frame, everything=True)

    def choose(self, *vehicles: int) -> None:
        """Set which vehicles' details, such as satellite lines and camera pictures, are drawn."""
        with self._lock:
            self.stage.chosen = frozenset(vehicles)
            for layer in self.layers.values():
                if layer.of_chosen and (layer.root.visible or layer.always) and self.frame is not None:
                    layer.draw(self.frame)

    def nearest(self, origin: object, direction: object) -> int | None:
        """Return the number of the vehicle at the smallest angle from a ray of the camera; None without vehicles."""
        if self.frame is None:
            return None
        away = self.frame.position_ned - np.asarray(origin)
        along = away @ np.asarray(direction)
        across = np.linalg.norm(away - along[:, None] * np.asarray(direction), axis=1)
        angle = np.where(along > 0.0, np.arctan2(across, along), np.inf)
        return int(np.argmin(np.nan_to_num(angle, nan=np.inf)))


def _span(cast: Cast) -> float:
    """Return the size [m] at which vehicles are drawn at first."""
    largest = LARGEST_SPAN
    if cast.size > MANY:
        room = float(np.sqrt(np.prod(np.ptp(cast.start_ned[:, :2], axis=0)) / cast.size))
        largest = max(SMALLEST_SPAN, SHARE_OF_ROOM * room)
    return float(np.clip(cast.extent / 15.0, SMALLEST_SPAN, largest))
