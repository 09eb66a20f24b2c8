"""The schemas of mean winds."""

from __future__ import annotations

from functools import cache, partial
from typing import Annotated, Any, Literal

from pydantic import Field

from qrsim.core.tree import record, setting
from qrsim.models.atmosphere.wind import ROUGHNESS_M
from qrsim.models.atmosphere.wind_profile import MOST_ROWS, ProfileRows
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.component_schema import Finite, Strict, component_model
from qrsim.scenarios.slots import Maker, slot

PROFILE, WEATHER = "profile", "weather"


@record
class WeatherFile:
    """The wind over the site from a weather model's file, GRIB or NetCDF; a profile while a scenario is loaded."""

    file: str = setting(doc="GRIB file of GFS, HRRR, ICON (regular) or ERA5, or NetCDF file of ERA5")
    above: Literal["sea", "model"] = setting(
        default="sea",
        doc="reference of levels of pressure: 'sea': heights above the sea less that of the site; 'model': the ground "
        "of the model",
    )
    roughness: float = setting(
        default=ROUGHNESS_M,
        unit="m",
        doc="roughness length of the land, for the wind below the lowest level",
        above=0.0,
        maximum=2.0,
    )
    member: int | None = setting(default=None, unit="1", doc="member of an ensemble; null: the file has one")


def _numbers(text: str, **bounds: float) -> Any:
    """Return pydantic annotation and field, described by ``text``, of a list of numbers within ``bounds``."""
    number = Annotated[float, Field(allow_inf_nan=False, strict=True, **bounds)]
    return list[number], Field([], description=text, max_length=MOST_ROWS)


@cache
def profile_model() -> Any:
    """Return the pydantic model of a wind profile, inline or in a file."""
    rows = {
        "file": (
            str | None,
            Field(None, description="CSV file: height, speed, direction and perhaps time", min_length=1, exclude=True),
        ),
        "heights": _numbers("height above the ground of each row [m]", gt=0.0, le=30_000.0),
        "speeds": _numbers("speed of each row [m/s]", ge=0.0, le=150.0),
        "wind_from_rad": _numbers("bearing the wind comes from, clockwise from north, of each row [rad]"),
        "times": _numbers("time of each row since the start of the run [s]; none: the wind is steady"),
        "levels": (list[str], Field([], description="source of each row, for people", max_length=MOST_ROWS)),
        "model_gust": (Finite | None, Field(None, description="largest gust of the model [m/s], for people", ge=0.0)),
    }
    return component_model(PROFILE, ProfileRows, arrays=rows)


@cache
def _model(name: str, wind: type) -> type[Strict]:
    """Return the pydantic model of a wind class, cached by class."""
    return component_model(name, wind)


def _winds() -> dict[str, Maker]:
    """Return type name -> function that makes its pydantic model, for all winds of the catalogue and weather files."""
    others = {name: partial(_model, name, wind) for name, wind in known.WINDS.items() if wind is not ProfileRows}
    return {**others, PROFILE: profile_model, WEATHER: partial(_model, WEATHER, WeatherFile)}


WindSlot: Any = slot(_winds)
