"""The factor graphs: residuals, their Jacobians by JAX over all states at once, and the normal equations in blocks.

Unknown are the vehicle's state at T + 1 times, x (T + 1, D), and L landmarks, a (L, 3). Every residual is in units of
its own standard deviation, and the cost is half the sum of their squares:

- motion   W_k (x_k+1 - f(x_k, u_k)), f the simulator's own vehicle model over the K steps between two states
- prior    (x_0 - m) / s
- range    (|p_k - a_i| - d_ki) / std, for each landmark in range of a state
- fix      (p_k + b_k - z_k) / std in north and east, only in the graph ``gnss``
- bias     b_k+1 = exp(-dt/tau) b_k + noise, two more states of the motion, only where the error is modelled
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import quantity, record, replace, setting
from qrsim.engine.settings import quick_jit
from qrsim.errors import UsageError
from qrsim.models.vehicles.process_noise import PROCESS_NOISE_STEP_S
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.studies.slam.flight import SIZE, Flight, Floats, advance, dead_reckon
from qrsim.studies.slam.ranging import Ranging

GRAPHS, STATES, PRIORS = ("paper", "gnss"), ("full", "poses"), ("start", "estimate")
YAW = 5
POSE = (0, 1, 2, YAW)
# What the model leaves open beside its process noise, per root of a second: position [m], angles [rad], velocity
# [m/s], rates [rad/s] and thrust [N]. Far below the process noise; it keeps what has none (thrust) invertible.
FLOOR = np.array([3e-4] * 3 + [3e-4] * 3 + [3e-3] * 3 + [3e-3] * 3 + [3e-2])
# Standard deviations of the prior on x_0: about the true start, or about what the sensors say there.
START_STD = np.array([0.1] * 3 + [0.01] * 3 + [0.1] * 3 + [0.05] * 3 + [0.5])
ESTIMATE_STD = np.array([100.0, 100.0, 0.5] + [0.01] * 3 + [0.5] * 3 + [0.05] * 3 + [0.5])


@record
class Graph:
    """Data of a problem: T + 1 states of D numbers, L landmarks."""

    vehicle: Quadrotor = quantity(doc="vehicle model, float64")
    commands: Array = quantity(doc="(T, K, 5) commands as flown")
    air_ned: Array = quantity(unit="m/s", doc="(T, K, 3) known wind")
    nominal: Array = quantity(doc="(T + 1, 13) dead-reckoned states; only poses use them")
    whiten: Array = quantity(doc="(T, D, D) W of each motion factor")
    prior_mean: Array = quantity(doc="(D,) prior of the first state")
    prior_weight: Array = quantity(doc="(D,) inverse of its standard deviations")
    ranges: Array = quantity(unit="m", doc="(T + 1, L) ranges, 0 where there is none")
    range_weight: Array = quantity(unit="1/m", doc="(T + 1, L) inverse standard deviations, 0 where there is no range")
    fixes: Array = quantity(unit="m", doc="(T + 1, 2) GNSS fixes, 0 where there is none")
    fix_weight: Array = quantity(unit="1/m", doc="(T + 1,) inverse standard deviations, 0 where there is no fix")
    active: Array = quantity(doc="(L,) 1 for landmarks with enough ranges, else 0")
    bias_decay: Array = quantity(doc="() of the bias over one state")
    time_step: float = setting(unit="s", doc="step of the simulator")
    states: str = setting(doc="full or poses")
    bias: bool = setting(doc="whether the GNSS error is a state")

    @property
    def vehicle_size(self) -> int:
        """Number of unknowns of one state that describe the vehicle, without GNSS errors."""
        return SIZE if self.states == "full" else len(POSE)

    @property
    def size(self) -> int:
        """Number D of unknowns of one state: vehicle, and GNSS errors if they are states."""
        return self.vehicle_size + 2 * self.bias

    def cost(self, x: Floats, landmarks: Floats) -> float:
        """Return half the sum of all squared residuals at states x (T + 1, D) and landmarks (L, 3)."""
        return float(cost(self, jnp.asarray(x), jnp.asarray(landmarks)))

    def linearise(self, x: Floats, landmarks: Floats) -> Normal:
        """Return the normal equations of the graph at states x (T + 1, D) and landmarks (L, 3)."""
        return linearise(self, jnp.asarray(x), jnp.asarray(landmarks))


@record
class Normal:
    """The normal equations at a point: blocks of half the Hessian of the cost, and its gradient."""

    cost: Array = quantity(doc="()")
    diagonal: Array = quantity(doc="(T + 1, D, D)")
    below: Array = quantity(doc="(T, D, D) row k + 1, column k")
    border: Array = quantity(doc="(T + 1, 3, L, 3) positions against landmarks; of N vehicles (T + 1, 3 N, L, 3)")
    corner: Array = quantity(doc="(L, 3, 3)")
    gradient: Array = quantity(doc="(T + 1, D)")
    gradient_landmarks: Array = quantity(doc="(L, 3)")

    @property
    def places(self) -> int:
        """Number of position coordinates in one block of unknowns, where they come first."""
        return int(self.border.shape[1])


def predict(graph: Graph, x: Array, commands: Array, air_ned: Array, nominal: Array, normals: Array) -> Array:
    """Predict the next state (D,) from a state x (D,) by K rows of commands.

    Args:
        graph: for the model and which states there are.
        x: (D,).
        commands, air_ned: (K, 5), (K, 3).
        nominal: (2, 13) dead-reckoned states before and after; poses move as these do, turned by the heading.
        normals: (K, 6) process noise, standard normals.
    """
    if graph.states == "full":
        moved = advance(graph.vehicle, x[:SIZE], commands, air_ned, normals, graph.time_step)
    else:
        step = nominal[1] - nominal[0]
        turn = x[3] - nominal[0, YAW]
        cos, sin = jnp.cos(turn), jnp.sin(turn)
        turned = jnp.stack([cos * step[0] - sin * step[1], sin * step[0] + cos * step[1], step[2], step[YAW]])
        moved = x[: len(POSE)] + turned
    return jnp.concatenate([moved, graph.bias_decay * x[graph.vehicle_size :]])


def _zero_normals(graph: Graph) -> Array:
    """Return zeros (K, normals) in place of the process noise between two states."""
    return jnp.zeros((graph.commands.shape[1], graph.vehicle.normals))


def motion_residual(
    graph: Graph, x: Array, after: Array, commands: Array, air_ned: Array, nominal: Array, whiten: Array
) -> Array:
    """Return the whitened residual (D,) of the motion from state ``x`` to state ``after``."""
    return whiten @ (after - predict(graph, x, commands, air_ned, nominal, _zero_normals(graph)))


def range_residual(position: Array, landmark: Array, measured: Array, weight: Array) -> Array:
    """Return the whitened residual () of a measured range [m] from a position (3,) to a landmark (3,)."""
    away = position - landmark
    # A nanometre squared, so that there is a derivative at the landmark itself.
    return weight * (jnp.sqrt(jnp.sum(away * away) + 1e-18) - measured)


def fix_residual(graph: Graph, x: Array, fix: Array, weight: Array) -> Array:
    """Return the whitened residuals (2,) of a GNSS fix at state ``x``, north and east."""
    believed = x[:2] + x[graph.vehicle_size :] if graph.bias else x[:2]
    return weight * (believed - fix)


def _pairs(nominal: Array) -> Array:
    """Return the states (T, 2, 13) before and after each interval, from states (T + 1, 13)."""
    return jnp.stack([nominal[:-1], nominal[1:]], axis=1)


def _residuals(graph: Graph, x: Array, landmarks: Array) -> tuple[Array, Array, Array, Array]:
    """Return all whitened residuals: motion (T, D), prior (D,), ranges (T + 1, L), GNSS fixes (T + 1, 2)."""
    motion = jax.vmap(partial(motion_residual, graph))(
        x[:-1], x[1:], graph.commands, graph.air_ned, _pairs(graph.nominal), graph.whiten
    )
    to_all = jax.vmap(range_residual, in_axes=(None, 0, 0, 0))
    ranges = jax.vmap(to_all, in_axes=(0, None, 0, 0))(x[:, :3], landmarks, graph.ranges, graph.range_weight)
    fixes = jax.vmap(partial(fix_residual, graph))(x, graph.fixes, graph.fix_weight)
    return motion, graph.prior_weight * (x[0] - graph.prior_mean), ranges, fixes


def _half_squares(parts: tuple[Array, ...]) -> Array:
    """Return half the sum of squares over all arrays, ()."""
    return 0.5 * jnp.sum(jnp.stack([jnp.sum(part * part) for part in parts]))


@quick_jit
def cost(graph: Graph, x: Array, landmarks: Array) -> Array:
    """Return half the sum of all squared residuals at states x (T + 1, D) and landmarks (L, 3)."""
    return _half_squares(_residuals(graph, x, landmarks))


@record
class _Slopes:
    """Residuals and their Jacobians, one row for each state, motion or range."""

    residuals: tuple[Array, Array, Array, Array] = quantity(doc="as ``_residuals`` returns them")
    motion: Array = quantity(doc="(T, D, D) by the state before; by the one after it is W")
    range_position: Array = quantity(doc="(T + 1, L, 3)")
    range_landmark: Array = quantity(doc="(T + 1, L, 3)")
    fix: Array = quantity(doc="(T + 1, 2, D)")


@quick_jit
def _jacobians(graph: Graph, x: Array, landmarks: Array) -> _Slopes:
    """Return all residuals with their derivatives by states x (T + 1, D) and landmarks (L, 3)."""
    motion = jax.vmap(jax.jacfwd(partial(motion_residual, graph)))(
        x[:-1], x[1:], graph.commands, graph.air_ned, _pairs(graph.nominal), graph.whiten
    )
    to_all = jax.vmap(jax.jacfwd(range_residual, argnums=(0, 1)), in_axes=(None, 0, 0, 0))
    by_position, by_landmark = jax.vmap(to_all, in_axes=(0, None, 0, 0))(
        x[:, :3], landmarks, graph.ranges, graph.range_weight
    )
    fix = jax.vmap(jax.jacfwd(partial(fix_residual, graph)))(x, graph.fixes, graph.fix_weight)
    return _Slopes(_residuals(graph, x, landmarks), motion, by_position, by_landmark, fix)


@quick_jit
def _normal_equations(graph: Graph, slopes: _Slopes) -> Normal:
    """Return the blocks of the normal equations from residuals and their derivatives."""
    motion, prior, ranges, fixes = slopes.residuals
    from_x, to_x, from_p, from_a = slopes.motion, graph.whiten, slopes.range_position, slopes.range_landmark
    diagonal = jnp.einsum("tri,trj->tij", slopes.fix, slopes.fix)
    diagonal = diagonal.at[:-1].add(jnp.einsum("tri,trj->tij", from_x, from_x))
    diagonal = diagonal.at[1:].add(jnp.einsum("tri,trj->tij", to_x, to_x))
    diagonal = diagonal.at[0].add(jnp.diag(graph.prior_weight**2))
    diagonal = diagonal.at[:, :3, :3].add(jnp.einsum("tli,tlj->tij", from_p, from_p))
    gradient = jnp.einsum("tri,tr->ti", slopes.fix, fixes)
    gradient = gradient.at[:-1].add(jnp.einsum("tri,tr->ti", from_x, motion))
    gradient = gradient.at[1:].add(jnp.einsum("tri,tr->ti", to_x, motion))
    gradient = gradient.at[0].add(graph.prior_weight * prior)
    gradient = gradient.at[:, :3].add(jnp.einsum("tli,tl->ti", from_p, ranges))
    idle = jnp.eye(3)[None] * (1.0 - graph.active)[:, None, None]
    return Normal(
        cost=_half_squares((motion, prior, ranges, fixes)),
        diagonal=diagonal,
        below=jnp.einsum("tri,trj->tij", to_x, from_x),
        border=jnp.einsum("tli,tlj->tilj", from_p, from_a),
        corner=jnp.einsum("tli,tlj->lij", from_a, from_a) + idle,
        gradient=gradient,
        gradient_landmarks=jnp.einsum("tli,tl->li", from_a, ranges),
    )


def linearise(graph: Graph, x: Array, landmarks: Array) -> Normal:
    """Return the normal equations of a graph at states x (T + 1, D) and landmarks (L, 3).

    In two programs: in one, XLA computes the Jacobians anew inside each product that they are part of.
    """
    return _normal_equations(graph, _jacobians(graph, x, landmarks))


@quick_jit
def _noise_jacobians(graph: Graph, x: Array) -> Array:
    """Return the derivatives (T, D, K * 6) of each predicted state by the process noise of its interval."""

    def after(normals: Array, x: Array, commands: Array, air_ned: Array, nominal: Array) -> Array:
        """Return the state (D,) after an interval with the process noise ``normals``."""
        return predict(graph, x, commands, air_ned, nominal, normals)

    inputs = (x[:-1], graph.commands, graph.air_ned, _pairs(graph.nominal))
    found = jax.vmap(jax.jacfwd(after), in_axes=(None, 0, 0, 0, 0))(_zero_normals(graph), *inputs)
    return found.reshape(*found.shape[:2], -1)


def motion_covariance(graph: Graph, x: Floats, bias_std: float) -> Floats:
    """Return the covariance (T, D, D) of each state predicted from the one before, about states x.

    Full states: the simulator's process noise through the linearised model. Poses: a velocity or yaw rate that decays
    at the rate c under noise of density S moves the pose like a random walk of S/c^2 per second.

    Raises:
        UsageError: poses of a vehicle without drag.
    """
    interval = graph.commands.shape[1] * graph.time_step
    floor = FLOOR**2 * interval
    vehicle = graph.vehicle
    if graph.states == "full":
        spread = np.asarray(_noise_jacobians(graph, jnp.asarray(x)))
        covariance = spread @ spread.transpose(0, 2, 1)
        diagonal = floor
    else:
        rates = np.array([float(vehicle.kuv)] * 2 + [float(vehicle.kw), float(vehicle.kr1)])
        if not np.all(rates < 0.0):
            raise UsageError("states poses: they need a vehicle with drag and yaw damping; take full")
        density = float(vehicle.process_noise) ** 2 * PROCESS_NOISE_STEP_S
        covariance = np.zeros((len(graph.commands), graph.size, graph.size))
        diagonal = floor[list(POSE)] + density * interval / rates**2
    if graph.bias:
        decay = float(graph.bias_decay)
        diagonal = np.concatenate([diagonal, np.full(2, bias_std**2 * (1.0 - decay**2))])
    return np.asarray(covariance + np.diag(diagonal))


def make_graph(
    flight: Flight,
    ranging: Ranging,
    active: Floats,
    *,
    graph: str,
    states: str,
    prior: str,
    fix_std: float,
    bias_time_constant: float | None,
) -> tuple[Graph, Floats]:
    """Build the factor graph of a flight with ranges; also return initial states (T + 1, D): the vehicle's estimate.

    Args:
        flight, ranging: what was flown and measured.
        active: (L,) 1 for landmarks with enough ranges, else 0.
        graph, states, prior, bias_time_constant: see ``qrsim.studies.slam``.
        fix_std: of a GNSS fix, per axis [m].

    Raises:
        UsageError: poses of a vehicle without drag.
    """
    mean = (flight.truth if prior == "start" else flight.estimate)[0]
    deviations = START_STD if prior == "start" else ESTIMATE_STD
    if prior == "estimate" and graph == "paper":
        # There the prior is all that says where the vehicle is, and it is as good as a fix.
        deviations = np.concatenate([[fix_std, fix_std], deviations[2:]])
    kept = list(range(SIZE)) if states == "full" else list(POSE)
    bias = bias_time_constant is not None
    nothing = np.zeros((len(flight.truth), 2 * bias))
    x = np.concatenate([flight.estimate[:, kept], nothing], axis=1)
    interval = flight.ticks * flight.time_step
    made: Any = np.isfinite(flight.fixes).all(axis=1) & (graph == "gnss")
    decay = math.exp(-interval / bias_time_constant) if bias_time_constant is not None else 0.0
    # White noise that is left of a fix beside its bias: an error that moved within one interval between states.
    white = fix_std * math.sqrt(1.0 - decay**2) if bias else fix_std
    reckoned = dead_reckon(flight.vehicle, mean, flight.commands, flight.air_ned, flight.time_step)
    seen = np.isfinite(ranging.ranges) & (active > 0)
    with jax.enable_x64(True):
        arrays: dict[str, object] = {
            "commands": flight.commands,
            "air_ned": flight.air_ned,
            "nominal": reckoned,
            "whiten": np.zeros((len(flight.commands), x.shape[1], x.shape[1])),
            "prior_mean": np.concatenate([mean[kept], nothing[0]]),
            "prior_weight": 1.0 / np.concatenate([deviations[kept], np.full(2 * bias, fix_std)]),
            "ranges": np.where(seen, ranging.ranges, 0.0),
            "range_weight": np.where(seen, np.sqrt(ranging.counts) / ranging.std, 0.0),
            "fixes": np.where(made[:, None], flight.fixes, 0.0),
            "fix_weight": np.where(made, 1.0 / white, 0.0),
            "active": active,
            "bias_decay": np.float64(decay),
        }
        made_graph = Graph(
            vehicle=jax.tree.map(jnp.asarray, flight.vehicle),
            **{name: jnp.asarray(value, jnp.float64) for name, value in arrays.items()},
            time_step=flight.time_step,
            states=states,
            bias=bias,
        )
        covariance = motion_covariance(made_graph, x, fix_std)
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        return replace(made_graph, whiten=jnp.asarray(root)), x
