"""The schema of prisms and of a file of buildings, as a scenario has them in its world."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from qrsim.models.scene.prisms import PrismObstacle, edges_of
from qrsim.scenarios.component_schema import Finite, Strict, component_model
from qrsim.scenarios.legs import Corner
from qrsim.scenarios.slots import slot

MOST_OBSTACLES, MOST_CORNERS, MOST_HOLES = 10_000, 1000, 100


# What an obstacle of any kind may say besides its shape.
STEEL: dict[str, tuple[object, object]] = {
    "steel_radius": (
        Finite,
        Field(
            0.0,
            description="radius of the solid steel sphere at its centre that turns a compass as it does [m]; 0: none",
            ge=0,
            le=100,
            json_schema_extra={"unit": "m"},
        ),
    )
}


class _Prism(Strict):
    """Shows the corners as a PrismObstacle has them."""

    if TYPE_CHECKING:
        corners_ned: list[tuple[float, float]]
        holes_ned: list[list[tuple[float, float]]]

    @property
    def _edges(self) -> Any:
        """Edges of the prism's outline and holes, as ``edges_of`` returns them."""
        return edges_of([self.corners_ned, *self.holes_ned])

    @property
    def north(self) -> list[float]:
        """North coordinates of the starts of the prism's edges [m]."""
        return self._edges[0][:, 0].tolist()

    @property
    def east(self) -> list[float]:
        """East coordinates of the starts of the prism's edges [m]."""
        return self._edges[0][:, 1].tolist()

    @property
    def north_to(self) -> list[float]:
        """North coordinates of the ends of the prism's edges [m]."""
        return self._edges[1][:, 0].tolist()

    @property
    def east_to(self) -> list[float]:
        """East coordinates of the ends of the prism's edges [m]."""
        return self._edges[1][:, 1].tolist()


@cache
def prism_model() -> Any:
    """Return the pydantic model of a prism obstacle."""
    ring = list[Corner]
    text = "[north, east] [m] of each corner, in order; the last is joined to the first"
    parts = {
        "corners_ned": (ring, Field(description=text, min_length=3, max_length=MOST_CORNERS)),
        "holes_ned": (list[ring], Field([], description="the same of each hole in it", max_length=MOST_HOLES)),
        "z_min": (Finite, Field(description="top, negative above ground", json_schema_extra={"unit": "m"})),
        "name": (str | None, Field(None, description="for messages", max_length=100)),
    }
    return component_model("prism", PrismObstacle, arrays=parts, base=_Prism, more=STEEL)


def obstacle_slot(choices: Mapping[str, type]) -> object:
    """Return the pydantic annotation of an obstacle of any type in ``choices`` (type name -> class)."""

    @cache
    def make(name: str, kind: type) -> type[Strict]:
        """Return the pydantic model of an obstacle class, cached by class."""
        return component_model(name, kind, more=STEEL)

    return slot(
        lambda: {
            name: prism_model if kind is PrismObstacle else partial(make, name, kind) for name, kind in choices.items()
        }
    )


class MaskSpec(Strict):
    """How finely a world says what its obstacles hide of the sky."""

    pitch: Finite | None = Field(
        None,
        description="side of a cell [m]; default: 1, 2 or 4 m, the finest with a small table",
        ge=0.5,
        le=50,
    )
    azimuths: int = Field(64, description="directions at each cell", ge=16, le=256, strict=True)


class BuildingsSpec(Strict):
    """Buildings from a file, as obstacles; and what obstacles hide of the sky."""

    file: str | None = Field(None, description="a .geojson file with polygons", min_length=1)
    frame: Literal["geodetic", "local"] = Field(
        "geodetic", description="its coordinates: longitude and latitude [deg], or east and north of the site [m]"
    )
    default_height: Finite = Field(
        9.0, description="height [m] of buildings that have neither height nor building:levels", gt=0, le=1000
    )
    trees: Finite | None = Field(
        None,
        description="height [m] of woods and trees of OpenStreetMap without one; default: they are left out",
        gt=0,
        le=1000,
    )
    table: MaskSpec = Field(
        default_factory=lambda: MaskSpec.model_validate({}), description="table of the sky that obstacles hide"
    )
