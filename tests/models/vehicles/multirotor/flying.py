"""A multirotor alone, flown by the package's own machine code."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.engine.backend import Extent, Function, Specialised
from qrsim.engine.layout import Packer, Shared, aligned_copy
from qrsim.models.vehicles.contracts import Around
from qrsim.models.vehicles.process_noise import ProcessNoise


class Flown:
    """Vehicles (n,) over level ground at 0 m.

    Args:
        model: parameters.
        dt: of a step [s].
        wind: velocity of the air, NED [m/s].
        dtype: of all numbers.
        failed: of each rotor that may fail its number; ``step`` is then given health and what is known of it.
        count: vehicles.
    """

    def __init__(
        self,
        model: Any,
        dt: float,
        wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
        dtype: Any = np.float64,
        failed: tuple[int, ...] = (),
        count: int = 1,
    ):
        self.model, self.dtype, self.count = cast(model, dtype), np.dtype(dtype), count

        def call(model: Any, own: Any, state: Any, tick: Any) -> Any:
            command, air, health, known = own[1]
            zero = jnp.zeros(count, dtype)
            still = Vec3(zero, zero, zero)
            lost = tuple(zip(failed, health, known, strict=True))
            around = Around(lambda p: (zero, Vec3(zero, zero, zero - 1.0)), still, lost)
            after, force = model.step(
                state[0], command, lambda trig: trig.rotation().to_body(air), ProcessNoise(still, still), dt, around
            )
            return after, force

        self.function = Function(f"alone {dt} {failed}", call, of=(dt, failed, count))
        self.programs = Specialised(self.function, Shared.of(self.model), Extent(count, self.dtype), "llvm")
        self.wind = Vec3(*(np.full(count, speed, dtype) for speed in wind))
        self.failed = failed

    def start(self, position: Any = (0.0, 0.0, -20.0), attitude: Any = (0.0, 0.0, 0.0)) -> Any:
        """Return a state at rest at a place and an attitude."""
        each = [np.full(self.count, value, self.dtype) for value in (*position, *attitude)]
        zero = np.zeros(self.count, self.dtype)
        with jax.enable_x64(self.dtype == np.float64):
            state = self.model.initial_state(
                Vec3(*each[:3]), Euler(*each[3:]), Vec3(zero, zero, zero), Vec3(zero, zero, zero)
            )
            return jax.tree.map(lambda leaf: np.array(leaf, self.dtype), state)

    def fly(self, state: Any, commands: Any, health: Any = None, known: Any = None) -> list[Any]:
        """Return the states and specific forces (state, force) after each of some commands, records of (n,)."""
        zero = np.zeros(self.count, self.dtype)
        layout = Packer((state, Vec3(zero, zero, zero)))
        held = aligned_copy(layout.pack((state, Vec3(zero, zero, zero))))
        found = []
        with jax.enable_x64(self.dtype == np.float64):
            for i, command in enumerate(commands):
                lost = () if health is None else health(i)
                seen = () if known is None else known(i)
                program = self.programs.program((command, self.wind, lost, seen), layout)
                assert program.refused == ""
                held = program.run(held, i, 1)
                found.append(jax.tree.map(np.array, layout.unpack(held)))
        return found
