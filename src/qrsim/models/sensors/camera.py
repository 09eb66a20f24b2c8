"""Downward camera with a person classifier (docs/explanation/models/sensors.md).

A reading is only where and when a picture was taken. The picture itself, some thousand windows, is a function of that,
of the persons and the ground, and of the noise of its tick; ``develop`` computes it for whoever looks at it, so that
a world whose vehicles have cameras is as fast as one without.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw, Noise, Stream
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Rotation, Vec3, rotation
from qrsim.models.scene.contents import Surroundings
from qrsim.models.scene.persons import PersonsState
from qrsim.models.sensors import camera_windows
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.sensors.person_classifier import Close, PersonClassifier

# Corners of a person, in halves of its side.
_CORNERS = ((-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5))


class TakesPictures(Protocol):
    """Method of sensors with ``takes_pictures``, in addition to their contract."""

    def develop(self, reading: object, around: Surroundings, stream: Stream, size: Array) -> Picture:
        """Return the last picture of each vehicle (n,): a score for each window of ground; see ``Camera.develop``."""
        ...


@record
class CameraReading:
    """Position and time of the last picture."""

    taken_at_ned: Vec3 = quantity(unit="m", doc="true position of the camera")
    taken_attitude: Euler = quantity(unit="rad", doc="true attitude of the camera")
    picture: Array = quantity(unit="1", doc="number of the picture, the first is 0")


@record
class Picture:
    """The classifier's ratios for the windows of a picture, for each vehicle (n,); R x C windows at most.

    Windows beyond the grid of a picture, and corners beyond theirs, are NaN.
    """

    ratio: Array = quantity(doc="(n, R, C) log-likelihood ratio of a person being in the window, rows down the picture")
    north: Array = quantity(unit="m", doc="(n, R + 1, C + 1) corners of the windows on the ground")
    east: Array = quantity(unit="m", doc="(n, R + 1, C + 1) corners of the windows on the ground")
    rows: Array = quantity(doc="(n,) int32 rows of the grid")
    columns: Array = quantity(doc="(n,) int32 columns of the grid")
    seen: Array = quantity(doc="(n, R, C) bool: a missing person is in the window; the truth, for evaluation only")


@record
class View:
    """View of one camera on the ground, every field ()."""

    position: Vec3
    direction: Rotation
    rows: Array
    columns: Array
    width: Array
    height: Array
    left: Array
    top: Array


@record
class Camera(Sensor):
    """A camera that points straight down, with a classifier: a log-likelihood ratio for each window of the picture.

    Camera x is body y, camera y is minus body x, camera z is body z. A window is as large as a person looks in the
    middle of the picture, so a picture has the more windows the higher it is taken.
    """

    focal_length: Array = parameter(default=2280.0, unit="1", doc="focal length in pixels", above=0.0)
    principal_x: Array = parameter(default=640.0, unit="1", doc="principal point in pixels from the left")
    principal_y: Array = parameter(default=480.0, unit="1", doc="principal point in pixels from the top")
    classifier: PersonClassifier = quantity(default=PersonClassifier(), doc="distribution of the scores")
    width: int = setting(default=1280, unit="1", doc="width of a picture in pixels", minimum=1, maximum=20_000)
    height: int = setting(default=960, unit="1", doc="height of a picture in pixels", minimum=1, maximum=20_000)
    most_columns: int = setting(
        default=90, unit="1", doc="largest number of columns of windows; 90 suffice up to 80 m", minimum=1, maximum=1000
    )
    most_rows: int = setting(
        default=68, unit="1", doc="largest number of rows of windows; 68 suffice up to 80 m", minimum=1, maximum=1000
    )
    period: float = setting(
        default=1.0, unit="s", doc="interval between pictures, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude")
    noisy: ClassVar[bool] = True
    takes_pictures: ClassVar[bool] = True

    def init(self, draw: Noise, position_ned: Vec3, attitude: Euler) -> tuple[Array, CameraReading]:
        """Return the number of the first picture, 0, and the reading: this number and the pose of the camera."""
        number = jnp.zeros_like(position_ned.x)
        return number, CameraReading(position_ned, attitude, number)

    def restart(
        self, state: Array, draw: Noise, since: Array, position_ned: Vec3, attitude: Euler
    ) -> tuple[Array, CameraReading]:
        """Return the last picture's number, and a reading with the poses after ``set_state`` has moved vehicles."""
        return state, CameraReading(position_ned, attitude, state)

    def step(self, state: Array, draw: Noise, position_ned: Vec3, attitude: Euler) -> tuple[Array, CameraReading]:
        """Return the next picture's number, and the reading: this number and the pose of the camera."""
        number = state + 1.0
        return number, CameraReading(position_ned, attitude, number)

    def develop(self, reading: CameraReading, around: Surroundings, stream: Stream, size: Array) -> Picture:
        """Return the last picture of each vehicle (n,): a person score for each window (about ``size`` [m]) of ground.

        Args:
            reading: where and when.
            around: the world; persons count as it was when the picture was taken.
            stream: of the camera's noise, of vehicles (n,).
            size: side of a person [m].
        """
        tick = self.tick_of(reading, around)

        def one(camera: Camera, reading: CameraReading, tick: Array, identity: Array) -> Picture:
            """Return the picture of one vehicle, by the random numbers of its tick and identity."""
            noise = jnp.zeros((self.most_rows * self.most_columns, 1), reading.picture.dtype)
            if self.noisy:
                draw = Draw(Stream(stream.high, stream.low, identity[None]), tick, reading.picture)
                noise = draw.normal_rows(self.most_rows * self.most_columns)
            return camera._develop(reading, around, tick, noise.reshape(self.most_rows, self.most_columns), size)

        return jax.vmap(one)(self.for_each(reading), reading, tick, stream.ids)

    def ratios(self, reading: CameraReading, around: Surroundings, stream: Stream, size: Array, to: Array) -> Array:
        """Return only the log-likelihood ratios (n, R, C) of ``develop``, put into ``to``; 0 outside a picture's grid.

        Args:
            reading, around, stream, size: see ``develop``.
            to: zeros (n, R, C).
        """
        return camera_windows.ratios(self, reading, around, stream, size, to)

    def frame(self, reading: CameraReading, around: Surroundings, size: Array) -> tuple[Array, Array]:
        """Return each last picture's rows and columns (n, 2) int32, and its corners (n, 4, 2) [m] on the ground.

        The grid is rows and columns. Corners are north and east [m] on the ground: upper left, upper right, lower
        right, lower left. Those of a vehicle that has stopped are NaN, and its grid is 0.

        Args:
            reading, around, size: see ``develop``.
        """

        def one(camera: Camera, reading: CameraReading) -> tuple[Array, Array]:
            """Return one vehicle's picture grid (rows, columns) and its corners on the ground."""
            view = camera.view(reading, around, size)
            zero = jnp.zeros_like(view.rows)
            row = jnp.stack([zero, zero, view.rows, view.rows])
            column = jnp.stack([zero, view.columns, view.columns, zero])
            corner = camera._on_ground(view, view.left + column * view.width, view.top + row * view.height)
            corners = jnp.stack([corner.x, corner.y], axis=-1)
            grid = jnp.stack([view.rows, view.columns])
            return jnp.where(jnp.isfinite(corners[0, :1]), grid, 0.0).astype(jnp.int32), corners

        return jax.vmap(one)(self.for_each(reading), reading)

    def for_each(self, reading: CameraReading) -> Camera:
        """Return the camera with every parameter broadcast to one value for each vehicle (n,)."""
        return jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf), reading.picture.shape), self)

    def tick_of(self, reading: CameraReading, around: Surroundings) -> Array:
        """Return the ticks (n,) int32 at which the last pictures were taken."""
        ticks = max(1, round(self.period / around.time_step))
        # A vehicle that has stopped has no picture any more, and no number.
        number = jnp.where(jnp.isfinite(reading.picture), reading.picture, 0.0).astype(jnp.int32)
        return number * ticks

    def _develop(self, reading: CameraReading, around: Surroundings, tick: Array, noise: Array, size: Array) -> Picture:
        """Return one vehicle's picture, from a standard normal (R, C) for each of its ground windows."""
        view = self.view(reading, around, size)
        row = jnp.arange(self.most_rows + 1).astype(noise.dtype)[:, None]
        column = jnp.arange(self.most_columns + 1).astype(noise.dtype)[None, :]
        corners = self._on_ground(view, view.left + column * view.width, view.top + row * view.height)
        present = jnp.zeros(noise.shape, bool)
        if around.state.persons is not None:
            present = self._present(view, around.state.persons, tick, size)
        middle = self._on_ground(view, *self.middle(view, row[:-1], column[:, :-1]))
        ratio = self.ratio(view, around, middle, present, noise, self.classifier.close)
        in_grid = (row[:-1] < view.rows) & (column[:, :-1] < view.columns)
        shown = (row <= view.rows) & (column <= view.columns)
        return Picture(
            jnp.where(in_grid, ratio, jnp.nan),
            jnp.where(shown, corners.x, jnp.nan),
            jnp.where(shown, corners.y, jnp.nan),
            view.rows.astype(jnp.int32),
            view.columns.astype(jnp.int32),
            present & in_grid,
        )

    def middle(self, view: View, row: Array, column: Array) -> tuple[Array, Array]:
        """Return pixel coordinates (x, y) of windows' centres, for their rows and columns (...) in the grid."""
        return view.left + (column + 0.5) * view.width, view.top + (row + 0.5) * view.height

    def ratio(
        self,
        view: View,
        around: Surroundings,
        middle: Vec3,
        present: Array,
        noise: Array,
        close: Callable[[Array], Close],
    ) -> Array:
        """Return the log-likelihood ratios of windows of one picture.

        Args:
            view: of the camera.
            around: the world.
            middle: of their middle on the ground (...) [m].
            present: (...) bool, whether a missing person is in each.
            noise: normals (...).
            close: ``PersonClassifier.close``; its result has no meaning beyond ``near``, but for a rise of 1.
        """
        distance, ground = (middle - view.position).norm(), around.ground_class(middle)
        near = close(distance)
        laws = self.classifier.person(distance, ground, near), self.classifier.none(distance, ground, near)
        means, stds = zip(*laws, strict=True)
        score = jnp.where(present, *means) + jnp.where(present, *stds) * noise
        # The picture of a vehicle that has stopped is NaN, because its pose is.
        return self.classifier.ratio(score, distance, ground, near) + 0.0 * distance

    def view(self, reading: CameraReading, around: Surroundings, size: Array) -> View:
        """Return one camera's projection onto the ground, with its grid of windows of about ``size`` [m]."""
        position, direction = around.over_ground(reading.taken_at_ned), rotation(reading.taken_attitude)
        axis = position + direction.down * (-position.z / direction.down.z)
        pixels = [
            self._in_picture(position, direction, axis.x + north * size, axis.y + east * size)
            for north, east in _CORNERS
        ]
        doubled = sum(
            x * next_y - next_x * y for (x, y), (next_x, next_y) in zip(pixels, [*pixels[1:], pixels[0]], strict=True)
        )
        side = jnp.sqrt(0.5 * jnp.abs(doubled))

        def cut(length: int, most: int) -> tuple[Array, Array, Array]:
            """Return number and length [pixels] of windows along one side of a picture, and the margin."""
            count = jnp.clip(jnp.round(length / side), 1.0, most)
            window = jnp.floor(length / count)
            return count, window, jnp.floor(0.5 * (length - window * jnp.floor(length / window)))

        columns, width, left = cut(self.width, self.most_columns)
        rows, height, top = cut(self.height, self.most_rows)
        return View(position, direction, rows, columns, width, height, left, top)

    def _in_picture(self, position: Vec3, direction: Rotation, north: Array, east: Array) -> tuple[Array, Array]:
        """Return pixel coordinates (x, y) of points on the ground, north and east [m]."""
        seen = direction.to_body(Vec3(north - position.x, east - position.y, -position.z + 0.0 * north))
        return (
            self.principal_x + self.focal_length * seen.y / seen.z,
            self.principal_y - self.focal_length * seen.x / seen.z,
        )

    def _on_ground(self, view: View, x: Array, y: Array) -> Vec3:
        """Return the points on the ground shown by pixels; x (1, C) or (R, C), y (R, 1) or (R, C)."""
        return self.shown(view, self.right(x) + 0.0 * y, self.ahead(y) + 0.0 * x)

    def right(self, x: Array) -> Array:
        """Return the slopes (...) to the right of the rays of pixels x (...)."""
        return (x - self.principal_x) / self.focal_length

    def ahead(self, y: Array) -> Array:
        """Return the slopes (...) ahead of the rays of pixels y (...)."""
        return -(y - self.principal_y) / self.focal_length

    def shown(self, view: View, right: Array, ahead: Array) -> Vec3:
        """Return the points (...) on the ground that rays with slopes (...) meet [m]."""
        ray = view.direction.to_ned(Vec3(ahead, right, jnp.ones_like(right)))
        reach = -view.position.z / ray.z
        return Vec3(view.position.x + reach * ray.x, view.position.y + reach * ray.y, jnp.zeros_like(reach))

    def shows(self, view: View, persons: PersonsState, tick: Array) -> Array:
        """Return () bool: the picture shows the centre of a person who has not been found by ``tick``."""
        here = self._in_frame(*self._in_picture(view.position, view.direction, persons.north, persons.east))
        return jnp.any(here & persons.missing(tick))

    def winners(self, view: View, persons: PersonsState, tick: Array, size: Array) -> tuple[Array, Array, Array]:
        """Return windows (Q,) of persons, as row and column, and (Q,) bool: the person nearest its centre is missing.

        A window is named for each of nine points of each person; the nearest of them counts.
        """
        row, column, nearness, missing = self._points(view, persons, tick, size)
        same = (row[:, None] == row[None]) & (column[:, None] == column[None])
        nearest = jnp.min(jnp.where(same, nearness[None], jnp.inf), axis=1)
        return row, column, jnp.isfinite(nearness) & (nearness == nearest) & missing

    def _points(self, view: View, persons: PersonsState, tick: Array, size: Array) -> tuple[Array, Array, Array, Array]:
        """Return row, column, squared distance to the window's centre, and missing (Q,), for nine points a person.

        Points that are in no window are infinitely far, in a row and a column beyond the last.
        """
        x, y = self._in_picture(view.position, view.direction, persons.north, persons.east)
        here = persons.there & self._in_frame(x, y)
        corners = [
            self._in_picture(view.position, view.direction, persons.north + north * size, persons.east + east * size)
            for north, east in _CORNERS
        ]
        points = [(x, y), *corners]
        points += [
            ((corners[i][0] + corners[i - 1][0] + x) / 3.0, (corners[i][1] + corners[i - 1][1] + y) / 3.0)
            for i in range(4)
        ]
        xs, ys = (jnp.concatenate([point[axis] for point in points]) for axis in (0, 1))
        here, middle_x, middle_y, missing = (
            jnp.concatenate([part] * len(points)) for part in (here, x, y, persons.missing(tick))
        )
        column, row = jnp.floor((xs - view.left) / view.width), jnp.floor((ys - view.top) / view.height)
        inside = (column >= 0.0) & (column < view.columns) & (row >= 0.0) & (row < view.rows)
        occupies = here & inside & self._in_frame(xs, ys)
        across = (middle_x - view.left) / view.width - column - 0.5
        down = (middle_y - view.top) / view.height - row - 0.5
        nearness = jnp.where(occupies, across * across + down * down, jnp.inf)
        row = jnp.where(occupies, row, self.most_rows).astype(jnp.int32)
        column = jnp.where(occupies, column, self.most_columns).astype(jnp.int32)
        return row, column, nearness, missing

    def _present(self, view: View, persons: PersonsState, tick: Array, size: Array) -> Array:
        """Return (R, C) bool: the person nearest a window's centre has not been found by ``tick``."""
        row, column, nearness, missing = self._points(view, persons, tick, size)
        window = row, column
        nearest = jnp.full((self.most_rows, self.most_columns), jnp.inf, nearness.dtype)
        nearest = nearest.at[window].min(nearness, mode="drop")
        first = nearness == nearest.at[window].get(mode="fill", fill_value=0.0)
        wins = jnp.isfinite(nearness) & first & missing
        return jnp.zeros(nearest.shape, bool).at[window].max(wins, mode="drop")

    def _in_frame(self, x: Array, y: Array) -> Array:
        """Return whether pixel coordinates are within the picture."""
        return (x >= 0.0) & (x < self.width) & (y >= 0.0) & (y < self.height)


@record
class IdealCamera(Camera):
    """A camera with a classifier that always gives the mean score."""

    noisy: ClassVar[bool] = False
