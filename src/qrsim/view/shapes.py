"""Meshes, directions and colours of what is drawn; meshes are (V, 3) corners and (F, 3) triangles."""

from __future__ import annotations

import math

import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.models.vehicles.contracts import Outline
from qrsim.runs.colours import RATIO, VEHICLES, WIND, on_scale

Mesh = tuple[Floats, Floats]

PALETTE = VEHICLES
_CUBE_FACES = np.array(
    [
        (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
        (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5),
    ]
)  # fmt: skip
# Triangles of an icosahedron with the corners (-+a, +-b, 0), and those of the two cyclic shifts of their axes.
_ICOSAHEDRON = (
    (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2),
    (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10),
    (8, 6, 7), (9, 8, 1),
)  # fmt: skip


def merged(*meshes: Mesh) -> Mesh:
    """Merge meshes, each (vertices, faces), into one mesh."""
    firsts = np.cumsum([0, *(len(corners) for corners, _ in meshes)])
    faces = [triangles + first for (_, triangles), first in zip(meshes, firsts[:-1], strict=True)]
    return np.concatenate([corners for corners, _ in meshes]), np.concatenate(faces)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """Return the mesh of a box between two opposite corners."""
    corners = np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return corners, _CUBE_FACES


def disc(x: float, y: float, z: float, radius: float, corners: int = 10) -> Mesh:
    """Return the mesh of a flat disc that faces up (-z)."""
    angles = np.arange(corners) * 2.0 * math.pi / corners
    rim = np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles), np.full(corners, z)], axis=1)
    i = np.arange(corners)
    return np.vstack([rim, [(x, y, z)]]), np.stack([i, np.roll(i, -1), np.full(corners, corners)], axis=1)


def prism(radius: float, z_min: float, z_max: float, corners: int = 24) -> Mesh:
    """Return the mesh of an upright cylinder about the z axis."""
    low, faces_low = disc(0.0, 0.0, z_min, radius, corners)
    high, faces_high = disc(0.0, 0.0, z_max, radius, corners)
    i, j = np.arange(corners), np.roll(np.arange(corners), -1)
    above = corners + 1
    sides = np.concatenate([np.stack([i, j, j + above], axis=1), np.stack([i, j + above, i + above], axis=1)])
    return np.concatenate([low, high]), np.concatenate([faces_low, faces_high + above, sides])


def cone(x_min: float, x_max: float, radius: float, corners: int = 8) -> Mesh:
    """Return the mesh of a cone along x, its base at ``x_min`` and its tip at ``x_max``."""
    angles = np.arange(corners) * 2.0 * math.pi / corners
    rim = np.stack([np.full(corners, x_min), radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    i = np.arange(corners)
    faces = [
        np.stack([i, np.roll(i, -1), np.full(corners, corners)], axis=1),
        np.stack([np.roll(i, -1), i, np.full(corners, corners + 1)], axis=1),
    ]
    return np.vstack([rim, [(x_max, 0.0, 0.0)], [(x_min, 0.0, 0.0)]]), np.concatenate(faces)


def quadrotor() -> Mesh:
    """Return the mesh of a quadrotor of span 1 in body axes (x ahead, y right, z down), with a beak at its nose."""
    reach, rotor, high = 0.34, 0.16, -0.06
    rotors = [disc(x, y, high, rotor) for x, y in ((reach, 0.0), (-reach, 0.0), (0.0, reach), (0.0, -reach))]
    arms = [box((-reach, -0.02, -0.04), (reach, 0.02, 0.0)), box((-0.02, -reach, -0.04), (0.02, reach, 0.0))]
    return merged(*rotors, *arms, box((-0.1, -0.07, -0.06), (0.1, 0.07, 0.06)), cone(0.08, 0.65, 0.06))


def multirotor(rotors: tuple[tuple[float, float, float], ...], radius: float) -> Mesh:
    """Return the mesh of a multirotor of span 1 in body axes, with an arm to each rotor hub and a beak at its nose.

    Args:
        rotors: positions of the hubs [m].
        radius: of the rotors [m].
    """
    hubs = np.array(rotors, np.float64)
    span = 2.0 * float(np.max(np.hypot(hubs[:, 0], hubs[:, 1]) + radius))
    parts = [box((-0.1, -0.07, -0.06), (0.1, 0.07, 0.06)), cone(0.08, 0.5, 0.06)]
    for x, y, z in hubs / span:
        parts.append(disc(x, y, z - 0.02, radius / span))
        parts.append(_arm(x, y, z))
    return merged(*parts)


def _arm(x: float, y: float, z: float) -> Mesh:
    """Return the mesh of a flat arm from the origin to a rotor hub at (x, y, z)."""
    length = max(math.hypot(x, y), 1e-9)
    corners, faces = box((0.0, -0.02, -0.02), (1.0, 0.02, 0.02))
    across = np.array([-y / length, x / length, 0.0])
    placed = (
        corners[:, :1] * np.array([x, y, z]) + corners[:, 1:2] * across + corners[:, 2:] * np.array([0.0, 0.0, 1.0])
    )
    return placed, faces


def mast() -> Mesh:
    """Return the mesh of a box with an antenna on it, 0.8 high, with a beak that points forwards."""
    antenna = box((-0.02, -0.02, -0.8), (0.02, 0.02, -0.1))
    return merged(
        box((-0.12, -0.12, -0.2), (0.12, 0.12, 0.0)), antenna, disc(0.0, 0.0, -0.8, 0.15), cone(0.1, 0.3, 0.05)
    )


def car() -> Mesh:
    """Return the mesh of a car of length 1 in body axes, wheels at z = 0, with a beak that points forwards."""
    body = box((-0.45, -0.2, -0.3), (0.4, 0.2, -0.12))
    cabin = box((-0.3, -0.16, -0.42), (0.12, 0.16, -0.3))
    beak, faces = cone(0.38, 0.6, 0.09)
    wheels = [box((x - 0.13, y - 0.05, -0.26), (x + 0.13, y + 0.05, 0.0)) for x in (-0.28, 0.28) for y in (-0.25, 0.25)]
    return merged(body, cabin, (beak - np.array([0.0, 0.0, 0.21]), faces), *wheels)


def plane() -> Mesh:
    """Return the mesh of an aeroplane of span 1 in body axes (x ahead, y right, z down): inverted V tail, two booms."""
    wing = (
        np.array(
            [
                (0.1, 0.0, -0.04),
                (0.04, 0.5, -0.06),
                (-0.06, 0.5, -0.06),
                (-0.08, 0.0, -0.04),
                (-0.06, -0.5, -0.06),
                (0.04, -0.5, -0.06),
            ]
        ),
        np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]),
    )
    tail = (
        np.array(
            [
                (-0.4, -0.09, -0.02),
                (-0.48, -0.09, -0.02),
                (-0.48, 0.0, -0.14),
                (-0.42, 0.0, -0.14),
                (-0.4, 0.09, -0.02),
                (-0.48, 0.09, -0.02),
            ]
        ),
        np.array([(0, 1, 2), (0, 2, 3), (3, 2, 5), (3, 5, 4)]),
    )
    booms = [box((-0.48, y - 0.008, -0.035), (0.0, y + 0.008, -0.015)) for y in (-0.09, 0.09)]
    fuselage = box((-0.16, -0.04, -0.05), (0.18, 0.04, 0.04))
    return merged(wing, tail, *booms, fuselage, cone(0.17, 0.34, 0.045))


_OTHERS = {"mast": mast, "car": car, "plane": plane}


def looks(outline: Outline | None) -> Mesh:
    """Return the mesh of a vehicle's shape, of span 1 in body axes; None: a quadrotor."""
    if outline is None:
        return quadrotor()
    return multirotor(outline.rotors, outline.rotor_radius) if outline.rotors else _OTHERS[outline.kind]()


def arrow() -> Mesh:
    """Return the mesh of an arrow of length 1 along x."""
    return merged(box((0.0, -0.12, -0.12), (0.7, 0.12, 0.12)), cone(0.65, 1.0, 0.35))


def ball() -> Mesh:
    """Return the mesh of a ball of radius 1, an icosahedron whose triangles are divided into four, twice.

    The package trimesh has one too, and takes most of a second to import.
    """
    short, long = math.sqrt(0.5 - math.sqrt(0.05)), math.sqrt(0.5 + math.sqrt(0.05))
    corners = np.array([(x * short, y * long, 0.0) for y in (1, -1) for x in (-1, 1)])
    corners = np.vstack([np.roll(corners, turns, axis=1) for turns in range(3)])
    faces = np.array(_ICOSAHEDRON)
    for _ in range(2):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)[:, ::-1]
        ends, middle = np.unique(edges, axis=0, return_inverse=True)
        (a, b, c), (ab, bc, ca) = faces.T, len(corners) + middle.reshape(-1, 3).T
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        middles = corners[ends].mean(axis=1)
        corners = np.vstack([corners, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
    return corners.astype(np.float32), faces.astype(np.uint32)


def funnel(narrow: float) -> Mesh:
    """Return the mesh of an open cone of length 1 along x, of radius ``narrow`` at the origin and 1 at its end."""
    angles = np.arange(16) * 2.0 * math.pi / 16
    rim = np.stack([np.zeros(16), np.cos(angles), np.sin(angles)], axis=1)
    corners = np.vstack([narrow * rim, rim + np.array([1.0, 0.0, 0.0])])
    i, j = np.arange(16), np.roll(np.arange(16), -1)
    return corners, np.concatenate([np.stack([i, j, j + 16], axis=1), np.stack([i, j + 16, i + 16], axis=1)])


def pin() -> Mesh:
    """Return the mesh of a cone of height 1 with its tip at the origin, pointing down."""
    corners, faces = cone(-1.0, 0.0, 0.25, 12)
    return corners[:, [1, 2, 0]], faces


def along(direction: Floats) -> Floats:
    """Return unit quaternions (n, 4), w first, that rotate the x axis to directions (n, 3) of any length."""
    length = np.linalg.norm(direction, axis=1)
    unit = direction / np.maximum(length, 1e-9)[:, None]
    # The half-way rotation between (1, 0, 0) and the unit vector; straight back it is half a turn about z.
    quaternion = np.stack([1.0 + unit[:, 0], np.zeros(len(unit)), -unit[:, 2], unit[:, 1]], axis=1)
    norm = np.linalg.norm(quaternion, axis=1)
    back = norm < 1e-6
    quaternion[back], norm[back] = (0.0, 0.0, 0.0, 1.0), 1.0
    return quaternion / norm[:, None]


def linear(colours: object) -> NumpyArray:
    """Convert sRGB colours (..., 3), 0 to 255, to the linear colours of viser's mesh instances (IEC 61966-2-1)."""
    share = np.asarray(colours, np.float64) / 255.0
    found = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.round(255.0 * found).astype(np.uint8)


def speed_colours(speed: Floats, strongest: float) -> Floats:
    """Return sRGB colours (n, 3) for speeds (n,), saturated from the speed ``strongest`` on."""
    return on_scale(WIND, speed / strongest)


def ratio_colours(ratio: Floats, strongest: float) -> Floats:
    """Return sRGB colours (n, 3) for log ratios (n,), saturated beyond +-``strongest``."""
    return on_scale(RATIO, 0.5 + 0.5 * ratio / strongest)
