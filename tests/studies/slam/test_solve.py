"""The graphs and their solution, on flights that their own commands explain exactly."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from tests.studies.slam.problems import exact_flight, exact_ranges

from qrsim.core.tree import replace
from qrsim.engine.settings import quick_jit
from qrsim.errors import UsageError
from qrsim.studies.slam import graph as graphs
from qrsim.studies.slam.covariance import marginals
from qrsim.studies.slam.estimate import estimate
from qrsim.studies.slam.solve import Damping, solve, step


def made(**options: Any) -> tuple[graphs.Graph, Any, Any]:
    """A graph, its first states and its landmarks."""
    flight = exact_flight(0.5, fixes=True)
    ranging = exact_ranges(flight)
    given = {"graph": "gnss", "states": "full", "prior": "estimate", "fix_std": 0.5, "bias_time_constant": None}
    problem, x = graphs.make_graph(flight, ranging, np.ones(len(ranging.guess_ned)), **(given | options))
    return problem, x, ranging.guess_ned


def cut(problem: graphs.Graph, count: int) -> graphs.Graph:
    """The first ``count`` states of a graph."""
    motions = {name: getattr(problem, name)[: count - 1] for name in ("commands", "air_ned", "whiten")}
    states = ("nominal", "ranges", "range_weight", "fixes", "fix_weight")
    return replace(problem, **motions, **{name: getattr(problem, name)[:count] for name in states})


def flat(problem: graphs.Graph, x: Any, landmarks: Any) -> Any:
    """All residuals in a row."""
    return jnp.concatenate([part.ravel() for part in graphs._residuals(problem, x, landmarks)])


def split(values: Any, x: Any, landmarks: Any) -> tuple[Any, Any]:
    """States and landmarks out of a row of all unknowns."""
    return jnp.asarray(values[: x.size]).reshape(x.shape), jnp.asarray(values[x.size :]).reshape(landmarks.shape)


@pytest.fixture(scope="module")
def small() -> tuple[graphs.Graph, Any, Any]:
    """A graph of 12 states with every factor, and a point at which none of them is zero."""
    problem, x, landmarks = made(bias_time_constant=20.0)
    with jax.enable_x64(True):
        x = x[:12] + 1e-3 * np.random.default_rng(0).standard_normal((12, x.shape[1]))
        return cut(problem, 12), x, landmarks


def dense(normal: graphs.Normal) -> tuple[Any, Any]:
    """The normal equations as one full matrix and one vector, states first."""
    count, size = normal.gradient.shape
    marks = len(normal.corner)
    full = np.zeros((count * size + 3 * marks,) * 2)
    for k in range(count):
        rows = slice(k * size, (k + 1) * size)
        full[rows, rows] = normal.diagonal[k]
        if k < count - 1:
            after = slice((k + 1) * size, (k + 2) * size)
            full[after, rows], full[rows, after] = normal.below[k], np.asarray(normal.below[k]).T
        full[k * size : k * size + 3, count * size :] = np.asarray(normal.border[k]).reshape(3, -1)
    full[count * size :, : count * size] = full[: count * size, count * size :].T
    for i in range(marks):
        rows = slice(count * size + 3 * i, count * size + 3 * i + 3)
        full[rows, rows] = normal.corner[i]
    return full, np.concatenate([np.ravel(normal.gradient), np.ravel(normal.gradient_landmarks)])


@pytest.mark.long
def test_the_normal_equations_are_those_of_central_differences(small: tuple[graphs.Graph, Any, Any]) -> None:
    problem, x, landmarks = small
    with jax.enable_x64(True):
        unknown = np.concatenate([x.ravel(), landmarks.ravel()])
        every = quick_jit(jax.vmap(lambda values: flat(problem, *split(values, x, landmarks))))
        width = 1e-5
        ends = [np.asarray(every(jnp.asarray(unknown[None] + sign * width * np.eye(len(unknown))))) for sign in (1, -1)]
        jacobian = (ends[0] - ends[1]).T / (2.0 * width)
        now = np.asarray(flat(problem, *split(unknown, x, landmarks)))
        matrix, gradient = dense(graphs.linearise(problem, jnp.asarray(x), jnp.asarray(landmarks)))
    scale = np.sqrt(np.diag(matrix))
    # In units of the curvatures; differences of this width are good to about 1e-6.
    assert np.max(np.abs(matrix - jacobian.T @ jacobian) / np.outer(scale, scale)) < 1e-5
    assert np.max(np.abs(gradient - jacobian.T @ now) / (scale * np.linalg.norm(now))) < 1e-6


@pytest.mark.long
def test_a_step_is_that_of_the_full_matrix(small: tuple[graphs.Graph, Any, Any]) -> None:
    problem, x, landmarks = small
    with jax.enable_x64(True):
        normal = graphs.linearise(problem, jnp.asarray(x), jnp.asarray(landmarks))
    matrix, gradient = dense(normal)
    damping = Damping.of(normal, "metres", 0.3)
    added = np.concatenate([damping.states.ravel(), damping.landmarks.ravel()])
    expected = np.linalg.solve(matrix + np.diag(added), -gradient)
    dx, da = step(normal, damping)
    np.testing.assert_allclose(np.concatenate([dx.ravel(), da.ravel()]), expected, rtol=1e-5, atol=1e-8)
    found = marginals(normal)
    every = np.linalg.inv(matrix)
    for i, covariance in enumerate(found.landmarks):
        rows = slice(x.size + 3 * i, x.size + 3 * i + 3)
        np.testing.assert_allclose(covariance, every[rows, rows], rtol=1e-4, atol=1e-4)
    for k, covariance in enumerate(found.positions):
        rows = slice(k * x.shape[1], k * x.shape[1] + 3)
        np.testing.assert_allclose(covariance, every[rows, rows], rtol=1e-4, atol=1e-6)


def test_exact_fixes_have_no_weight_and_are_refused() -> None:
    flight = exact_flight(0.5)
    with pytest.raises(UsageError, match="its fixes are exact, and a graph weighs them by their errors"):
        estimate(flight, exact_ranges(flight), graph="gnss", states="poses", fix_std=0.0)


@pytest.mark.long
@pytest.mark.parametrize("states", ["full", "poses"])
def test_without_noise_the_landmarks_come_out_to_a_millimetre(states: str) -> None:
    """The estimate begins half a metre off at every state, the landmarks anywhere."""
    flight = exact_flight(0.5)
    ranging = exact_ranges(flight)
    found = estimate(flight, ranging, graph="paper", states=states, fix_std=0.5)
    assert found.converged
    assert found.determined.all()
    assert np.max(np.linalg.norm(found.landmarks_ned - ranging.true_ned, axis=1)) < 1e-3
    assert np.max(np.linalg.norm(found.position_ned - flight.truth[:, :3], axis=1)) < 1e-3
    assert found.costs[-1] < 1e-6 < found.costs[0]


@pytest.mark.long
def test_both_ways_to_hold_steps_back_lead_to_one_optimum() -> None:
    flight = exact_flight(0.5, fixes=True)
    ranging = exact_ranges(flight)
    one, other = (estimate(flight, ranging, damping=damping, iterations=300) for damping in ("metres", "diagonal"))
    assert one.converged
    assert other.converged
    assert one.costs[-1] == pytest.approx(other.costs[-1], rel=1e-6)
    # A general solver's ten iterations are not enough.
    ten = estimate(flight, ranging, damping="diagonal", iterations=10)
    assert not ten.converged


@pytest.mark.long
def test_scipy_finds_the_same_optimum(small: tuple[graphs.Graph, Any, Any]) -> None:
    """Its own trust region on the same residuals with a sparse Jacobian: the cost to 6 digits."""
    problem, x, landmarks = small
    ours = solve(problem, x, landmarks, 300)
    residuals, jacobian = functions(problem, x, landmarks)
    theirs = scipy.optimize.least_squares(
        residuals,
        np.concatenate([x.ravel(), landmarks.ravel()]),
        lambda values: scipy.sparse.csr_array(jacobian(values)),
        x_scale="jac",
        tr_solver="lsmr",
        tr_options={"maxiter": 3000, "atol": 1e-14, "btol": 1e-14},
        ftol=1e-14,
        xtol=1e-14,
        gtol=1e-10,
        max_nfev=300,
    )
    assert ours.converged
    assert ours.point.cost == pytest.approx(theirs.cost, rel=1e-6)


def functions(problem: graphs.Graph, x: Any, landmarks: Any) -> tuple[Any, Any]:
    """Residuals and their Jacobian as functions of a row of all unknowns."""
    whole = jax.jit(lambda states, places: flat(problem, states, places))
    slopes = quick_jit(jax.jacfwd(whole, argnums=(0, 1)))

    def residuals(values: Any) -> Any:
        with jax.enable_x64(True):
            return np.asarray(whole(*split(values, x, landmarks)))

    def jacobian(values: Any) -> Any:
        with jax.enable_x64(True):
            parts = [np.asarray(part) for part in slopes(*split(values, x, landmarks))]
        return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)

    return residuals, jacobian


@pytest.mark.long
def test_ceres_finds_the_same_optimum(small: tuple[graphs.Graph, Any, Any]) -> None:
    """The same residuals and Jacobians in Ceres: the cost to 6 digits."""
    pyceres = pytest.importorskip("pyceres", reason="pyceres, an optional oracle, is not installed")
    problem, x, landmarks = small
    ours = solve(problem, x, landmarks, 300)
    residuals, jacobian = functions(problem, x, landmarks)
    values = np.concatenate([x.ravel(), landmarks.ravel()])
    count = len(residuals(values))

    class All(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(count)
            self.set_parameter_block_sizes([len(values)])

        def Evaluate(self, parameters: Any, out: Any, slopes: Any) -> bool:  # noqa: N802 (Ceres' name)
            row = np.array(parameters[0])
            out[:] = residuals(row)
            if slopes is not None:
                slopes[0][:] = jacobian(row).ravel()
            return True

    task, options, summary = pyceres.Problem(), pyceres.SolverOptions(), pyceres.SolverSummary()
    function = All()
    task.add_residual_block(function, None, [values])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_QR
    options.max_num_iterations = 500
    options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 1e-14
    pyceres.solve(options, task, summary)
    assert ours.point.cost == pytest.approx(summary.final_cost, rel=1e-6)
