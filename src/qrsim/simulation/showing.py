"""The compiled program of a world as text."""

from __future__ import annotations

import jax
import numpy as np

from qrsim.core.noise import Key
from qrsim.engine.backend import FORMS, Extent, form_of
from qrsim.errors import UsageError, did_you_mean
from qrsim.interface.actions import ActionChecker
from qrsim.simulation.one_world import RESET, TICK
from qrsim.world.draws import keys_of
from qrsim.world.state import World


def program_text(world: World, form: str, what: str = "tick") -> str:
    """Return the compiled program of one world, flown by its own guidance and controllers, as text; ``form``: "graph",
    "steps" or "llvm"; ``what``: "tick" or "start".

    Args:
        world: the parameters.
        form: "graph" of operations, "steps" (the loops that compute them, in order), or "llvm" (what LLVM compiles).
        what: "tick", or the "start" of a flight.

    Raises:
        UsageError: another form; XLA has been chosen as compiler; or the code generator does not take the world.
    """
    if form not in FORMS:
        raise UsageError(
            f"'{form}' is no form of a program; expected one of {', '.join(FORMS)}{did_you_mean(form, FORMS)}"
        )
    dtype = np.dtype(world.fleets[0].start.position_ned.x.dtype)
    checker, keys = ActionChecker(world, dtype), keys_of(world, Key.root(0, 0))
    given = checker.actions(None, None), checker.estimates(None)
    extent = Extent(sum(fleet.size for fleet in world.fleets), dtype)
    with jax.enable_x64(dtype == np.float64):
        if what == "start":
            return form_of(RESET, world, ((), keys), extent, form)
        return form_of(TICK, world, (((), keys), ((), given)), extent, form, RESET)
