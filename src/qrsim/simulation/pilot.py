"""A user's policy and estimator at the controls of a single Simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from qrsim.errors import warn_user
from qrsim.interface.actions import ActionChecker
from qrsim.interface.policies import UserFunction, user_function
from qrsim.interface.readings import Reading
from qrsim.simulation.arguments import check_counts
from qrsim.simulation.block_parts import call_compiled
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation


class Pilot:
    """Runs a policy and an estimator; compiles those that can be compiled.

    Args:
        simulation: the simulation to fly, after a reset.
        policy, estimator: see ``qrsim.interface.policies``; None for the scenario's own.
        policy_ticks: number of ticks from one call of the policy to the next.

    Raises:
        UsageError: a policy or estimator is no function of a reading.
        RunError: one of them failed at its start.
    """

    def __init__(self, simulation: Simulation, policy: object = None, estimator: object = None, policy_ticks: int = 1):
        check_counts(policy_ticks=policy_ticks)
        self.simulation = simulation
        self.policy = user_function("policy", policy)
        self.estimator = user_function("estimator", estimator)
        self.policy_ticks = policy_ticks
        self.command: object = None
        self._checker = ActionChecker(simulation.world, simulation.dtype)
        self.memories = {}
        for function in (self.policy, self.estimator):
            if function is not None:
                with simulation.precision_context(), function.blamed():
                    self.memories[function.what] = function.init(simulation.reading)
        self._compile()

    def _compile(self) -> None:
        """Prepare compiled versions of the policy and estimator that are marked as compiled."""
        self._compiled = {
            function.what: jax.jit(lambda state, tick, memory, f=function: self._answer(f, state, tick, memory))
            for function in (self.policy, self.estimator)
            if function is not None and function.compiled
        }

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "_compiled"}

    def __setstate__(self, kept: Mapping[str, object]) -> None:
        vars(self).update(kept)
        self._compile()

    def record(self, ticks: int, capacity: int = 50) -> History:
        """Fly at most ``ticks`` ticks, up to the next call of a user's function, and return the state of each.

        Raises:
            UsageError: what the user's function returned cannot be flown.
            RunError: it failed.
        """
        count, estimate = self._call_due(ticks)
        return self.simulation.record(count, self.command, capacity, estimate)

    def advance(self, ticks: int) -> None:
        """Fly at most ``ticks`` ticks, up to the next call of a user's function, without returning states."""
        count, estimate = self._call_due(ticks)
        self.simulation.advance(self.command, count, estimate)

    def _call_due(self, ticks: int) -> tuple[int, Any]:
        """Call the user's functions that are due; return the number of ticks to fly until the next call, at most
        ``ticks``, and the estimate."""
        simulation, estimate = self.simulation, None
        if self.policy is not None and simulation.tick % self.policy_ticks == 0:
            self.command = self._call(self.policy)
            if self.command is None and simulation.tick == 0:
                warn_user(
                    f"policy {self.policy.name} returned None at tick 0, so the vehicles fly by the guidance and "
                    "controllers of the scenario; to fly them, return a command or a set-point"
                )
        if self.estimator is not None:
            estimate = self._call(self.estimator)
        period = 1 if self.estimator else self.policy_ticks
        return min(ticks, period - simulation.tick % period), estimate

    def _call(self, function: UserFunction) -> object:
        """Call a policy or estimator, store its new memory, and return its checked result."""
        simulation, memory = self.simulation, self.memories[function.what]
        where = f", at tick {simulation.tick} ({simulation.time:g} s)"
        with simulation.precision_context(), function.blamed(where):
            if function.compiled:
                answer = self._compiled[function.what](simulation.state, np.int32(simulation.tick), memory)
                result, self.memories[function.what] = jax.tree.map(np.asarray, answer)
            else:
                result, self.memories[function.what] = function(simulation.reading, memory)
            # Checked here, where messages can name the function.
            if function is self.policy:
                self._checker.actions(result, lambda: simulation.valid)
            else:
                self._checker.estimates(result, needed=True)
            return result

    def _answer(self, function: UserFunction, state: Any, tick: Any, memory: Any) -> tuple[object, object]:
        """Return the result and new memory of a user's function that is compiled."""
        return call_compiled(function, Reading(self.simulation.world, state, tick, self.simulation.site), memory)
