"""Directions, meshes, grid and colours."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.models.vehicles.contracts import Outline
from qrsim.runs.colours import WIND
from qrsim.view import shapes
from qrsim.view.ground import grid_cell


def turned(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Rotate by quaternions (n, 4), w first."""
    w, u = quaternion[:, :1], quaternion[:, 1:]
    twice = 2.0 * np.cross(u, vector)
    return vector + w * twice + np.cross(u, twice)


def test_arrows_point_along_their_vectors():
    rng = np.random.default_rng(1)
    vectors = np.vstack([rng.normal(size=(200, 3)), np.eye(3), -np.eye(3), [[-1.0, 1e-5, 0.0], [-1.0, 0.0, 1e-5]]])
    found = turned(shapes.along(vectors), np.tile([1.0, 0.0, 0.0], (len(vectors), 1)))
    np.testing.assert_allclose(found, vectors / np.linalg.norm(vectors, axis=1)[:, None], atol=1e-4)
    assert np.isfinite(shapes.along(np.zeros((2, 3)))).all()


@pytest.mark.parametrize(
    "mesh",
    [
        shapes.quadrotor(),
        shapes.arrow(),
        shapes.prism(2.0, -1.0, 1.0),
        shapes.box((0, 0, 0), (1, 2, 3)),
        shapes.mast(),
        shapes.multirotor(((0.3, 0.0, 0.0), (-0.3, 0.1, 0.0)), 0.1),
    ],
)
def test_triangles_have_corners(mesh: shapes.Mesh):
    corners, faces = mesh
    assert corners.shape[1] == faces.shape[1] == 3
    assert set(np.unique(faces)) == set(range(len(corners)))


def test_a_quadrotor_has_span_one_and_looks_ahead():
    corners, _ = shapes.quadrotor()
    assert np.ptp(corners[:, 1]) == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(corners[np.argmax(corners[:, 0])], [0.65, 0.0, 0.0])
    assert corners[:, 0].min() > -0.55


def test_colours_of_speeds_end_where_the_scale_does():
    found = shapes.speed_colours(np.array([0.0, 6.0, 12.0, 99.0]), 12.0)
    np.testing.assert_array_equal(found[0], WIND[0])
    np.testing.assert_array_equal(found[2:], np.tile(WIND[-1], (2, 1)))
    assert not np.array_equal(found[1], found[0])


@pytest.mark.parametrize(("extent", "cell"), [(10.0, 0.5), (127.0, 5.0), (400.0, 20.0), (999.0, 20.0), (1000.0, 50.0)])
def test_grids_have_round_cells(extent: float, cell: float):
    assert grid_cell(extent) == pytest.approx(cell)


def test_a_multirotor_is_drawn_by_its_rotors():
    """Of span 1 whatever its size: hubs in their directions, rotors as large as they are beside the arms."""
    hubs = ((0.2, 0.2, -0.05), (-0.2, 0.2, -0.05), (-0.2, -0.2, -0.05), (0.2, -0.2, -0.05))
    corners, _ = shapes.multirotor(hubs, 0.1)
    span = 2.0 * (0.2 * 2.0**0.5 + 0.1)
    # Rotors reach 0.3 m ahead and aside; the beak reaches half a span ahead, and alone reaches so far on the axis.
    assert np.abs(corners[:, 1]).max() == pytest.approx(0.3 / span, rel=0.02)
    middles = [(x / span, y / span, z / span - 0.02) for x, y, z in hubs]
    for middle in middles:
        assert np.linalg.norm(corners - middle, axis=1).min() < 1e-9
    six, _ = shapes.multirotor((*hubs, (0.0, 0.3, 0.0), (0.0, -0.3, 0.0)), 0.1)
    assert len(six) > len(corners)


def test_a_mast_stands_up_and_looks_ahead():
    corners, _ = shapes.mast()
    assert corners[:, 2].min() == pytest.approx(-0.8)
    assert corners[:, 2].max() == pytest.approx(0.05)
    assert corners[:, 0].max() > -corners[:, 0].min()


def test_what_looks_like_what():
    assert len(shapes.looks(None)[0]) == len(shapes.quadrotor()[0])
    assert len(shapes.looks(Outline())[0]) == len(shapes.mast()[0])
    two = Outline(((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0)), 0.05)
    np.testing.assert_array_equal(shapes.looks(two)[0], shapes.multirotor(two.rotors, 0.05)[0])


def test_a_ball_is_closed_and_round():
    corners, triangles = shapes.ball()
    assert (len(corners), len(triangles)) == (162, 320)
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 1.0, atol=1e-6)
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).tolist()
    assert len({tuple(edge) for edge in edges}) == 960
    assert {(a, b) for a, b in edges} == {(b, a) for a, b in edges}
    # Six times the volume of each tetrahedron with the centre: all face outwards.
    volumes = np.linalg.det(corners[triangles].astype(float))
    assert volumes.min() > 0.0
    # trimesh 5.2.0: icosphere(subdivisions=2).volume.
    assert volumes.sum() / 6.0 == pytest.approx(4.0470447, abs=1e-5)
