"""How satellites are seen.

The mappings (G14) and (G15) of docs/explanation/models/gnss.md, and where rays cross the shell.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.gnss.sight import sight_of, system_numbers

# [deg]; the last is below the lowest at which mappings are computed, a sine of 0.05.
ELEVATIONS = (90.0, 45.0, 15.0, 5.0, 3.0, 1.0)
# What compiles these programs in the least time.
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
AZIMUTH = math.radians(30.0)


def test_systems_have_numbers() -> None:
    """GPS, Galileo, GLONASS, BeiDou; all others are like the last."""
    assert system_numbers("GERCJSG").tolist() == [0, 1, 2, 3, 3, 3, 0]


@pytest.fixture(scope="module")
def seen() -> Any:
    """Satellites at 20000 km, as NumPy arrays."""
    elevation = np.radians(ELEVATIONS)
    level = 2e7 * np.cos(elevation)
    places: Any = (level * math.cos(AZIMUTH), level * math.sin(AZIMUTH), -2e7 * np.sin(elevation))
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, jax.jit(sight_of, compiler_options=QUICK)(Vec3(*places)))


@pytest.mark.parametrize("i", range(6))
def test_mappings(seen: Any, i: int) -> None:
    """A shell 350 km above an Earth of 6371 km, and the troposphere of DO-229D."""
    sine = max(math.sin(math.radians(ELEVATIONS[i])), 0.05)
    share = 6371.0 / 6721.0 * math.sqrt(1.0 - sine**2)
    assert seen.elevation[i] == pytest.approx(math.radians(ELEVATIONS[i]), abs=2e-6)
    assert seen.ionosphere[i] == pytest.approx(1.0 / math.sqrt(1.0 - share**2), rel=1e-9)
    assert seen.troposphere[i] == pytest.approx(1.001 / math.sqrt(0.002001 + sine**2), rel=1e-9)


@pytest.mark.parametrize("i", range(1, 5))
def test_where_a_ray_crosses_the_shell(seen: Any, i: int) -> None:
    """Angles of a triangle: at the Earth's centre it is what 90 degrees, elevation and the angle at the shell leave.

    Its arc sine is a series of three terms, whose rest is below 2e-5 of it.
    """
    elevation = math.radians(ELEVATIONS[i])
    at_shell = math.asin(6371.0 / 6721.0 * math.cos(elevation))
    over_ground = 6371.0 * (0.5 * math.pi - elevation - at_shell)
    assert seen.pierce_north[i] == pytest.approx(over_ground * math.cos(AZIMUTH), rel=2e-5)
    assert seen.pierce_east[i] == pytest.approx(over_ground * math.sin(AZIMUTH), rel=2e-5)


def test_a_satellite_in_the_zenith_is_above_the_site(seen: Any) -> None:
    assert abs(seen.pierce_north[0]) < 1e-6
    assert abs(seen.pierce_east[0]) < 1e-6
