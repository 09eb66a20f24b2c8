"""A picture from above on the ground: a GeoTIFF or an MBTiles file of this machine, draped over the terrain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.errors import UsageError, shortened
from qrsim.extras import require
from qrsim.files.in_child import Child, ChildError
from qrsim.files.user_files import check_file
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.terrain_files.gdal import SETTINGS
from qrsim.models.site import Site
from qrsim.view.frame import Cast
from qrsim.view.ground import corners_of, surface
from qrsim.view.image_files import Bounds, read_geotiff, read_mbtiles
from qrsim.view.layers import Layer, Stage
from qrsim.world.state import World

IMAGE = "image"
# Format of a file by the end of its name, and the largest file.
READERS: dict[str, Callable[[str, Bounds, tuple[int, int]], NumpyArray]] = {
    ".tif": read_geotiff,
    ".tiff": read_geotiff,
    ".mbtiles": read_mbtiles,
}
LARGEST_FILE = 2**40
# Pixels along the longer side, and how far around the scene it reaches, in diagonals of the scene.
PIXELS, AROUND = 1536, 1.5


@dataclass(frozen=True)
class Imagery:
    """A picture and its place.

    Attributes:
        pixels: red, green, blue and opacity (rows, columns, 4); row 0 is its north.
        bounds: south, west, north, east [deg].
        outline: south-western and north-eastern corner (2, 2), north and east [m].
        site: origin of the NED frame.
    """

    pixels: NumpyArray
    bounds: Bounds
    outline: Floats
    site: Site


def read_imagery(path: Path, cast: Cast, world: World | None) -> Imagery:
    """Read the part of an aerial image file that covers the scene.

    Args:
        path: of the file, .tif, .tiff or .mbtiles.
        cast: of the scene, with its site.
        world: what there is; None where that is not known.

    Raises:
        UsageError: the file cannot be read, or does not show the place of the run.
        OSError: there is no such file.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise UsageError(f"--image {path}: expected a name that ends in {', '.join(READERS)}")
    if cast.site is None:
        raise UsageError(f"--image {path}: the run does not say where on the Earth it took place")
    if reader is read_geotiff:
        require("terrain", f"--image {path}", "rasterio")
    checked = check_file(path, LARGEST_FILE)
    if str(checked.absolute()).startswith("/vsi"):
        raise UsageError(f"--image {path}: begins with /vsi, which GDAL takes for a virtual file; move it elsewhere")
    site, outline = Site.from_degrees(*cast.site), _outline(cast, world)
    parts = [np.linspace(outline[0, axis], outline[1, axis], 9) for axis in (0, 1)]
    edge = np.array([(north, east, 0.0) for north in parts[0] for east in parts[1]])
    latitude, longitude, _ = (np.degrees(part) for part in site.ned_to_geodetic(edge))
    bounds = tuple(map(float, (latitude.min(), longitude.min(), latitude.max(), longitude.max())))
    sides = outline[1] - outline[0]
    rows, columns = np.maximum(2, np.round(PIXELS * sides / sides.max())).astype(int).tolist()
    try:
        with Child(settings=SETTINGS) as child:
            pixels = child.call(reader, str(checked.absolute()), bounds, (rows, columns))
    except UsageError as error:
        raise UsageError(f"--image {path}: {error}") from None
    except ChildError as error:
        raise UsageError(f"--image {path}: cannot be read: {shortened(str(error), 200)}") from None
    return Imagery(pixels, bounds, outline, site)  # type: ignore[arg-type]


def _outline(cast: Cast, world: World | None) -> Floats:
    """Return two corners (2, 2) [m] of the ground that an image covers: around the scene; on terrain, in the area."""
    around = AROUND * cast.extent
    low, high = cast.centre[:2] - around, cast.centre[:2] + around
    found = None if world is None or world.ground.at_zero else corners_of(world.area)
    if found is not None:
        low, high = np.maximum(low, found[0].min(axis=0)), np.minimum(high, found[0].max(axis=0))
    return np.stack([low, high])


class Image(Layer):
    """A picture on the ground, a little above it."""

    title = IMAGE
    every = 1000.0

    def __init__(self, stage: Stage, imagery: Imagery):
        self._imagery = imagery
        super().__init__(stage)

    def begin(self) -> None:
        """Add the ground's surface to the scene with the aerial image on it."""
        from PIL import Image as Picture
        from trimesh import Trimesh
        from trimesh.visual.material import PBRMaterial
        from trimesh.visual.texture import TextureVisuals

        own = self._imagery
        corners, faces = surface(self.stage.ground or FlatGround(), (own.outline, 0.0, 0.0), 0.0)
        uv = places_in(own, corners)
        corners[:, 2] -= 0.5 * self.stage.lift
        opaque = bool((own.pixels[..., 3] == 255).all())
        picture = Picture.fromarray(own.pixels[..., :3] if opaque else own.pixels)
        if opaque:
            # In which format it is sent.
            picture.format = "JPEG"
        material: Any = PBRMaterial(
            baseColorTexture=picture,
            metallicFactor=0.0,
            roughnessFactor=1.0,
            doubleSided=True,
            alphaMode="OPAQUE" if opaque else "MASK",
        )  # type: ignore[no-untyped-call]
        visual: Any = TextureVisuals(uv=uv, material=material)  # type: ignore[no-untyped-call]
        mesh = Trimesh(corners, faces, visual=visual, process=False)
        self.stage.scene.add_mesh_trimesh(f"{self.path}/picture", mesh, cast_shadow=False, receive_shadow=False)


def places_in(imagery: Imagery, corners: Floats) -> Floats:
    """Return image coordinates (V, 2) from left and bottom, 0 to 1, of the points ``corners`` (V, 3) NED [m]."""
    south, west, north, east = imagery.bounds
    latitude, longitude, _ = imagery.site.ned_to_geodetic(corners * [1.0, 1.0, 0.0])
    across = (np.degrees(longitude) - west) / (east - west)
    return np.column_stack([across, (np.degrees(latitude) - south) / (north - south)])
