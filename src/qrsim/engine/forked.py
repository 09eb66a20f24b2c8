"""Processes that were forked after JAX had compiled: its threads are not there, and it would wait for them for ever.

qrsim's own machine code runs in such a process. What only XLA can compile, as a policy under ``jax.jit``, is refused.
"""

from __future__ import annotations

import os
from typing import Any

import jax

from qrsim.errors import RunError

# Told before XLA compiles, and after it has.
_LOWERED = "/jax/core/compile/jaxpr_to_mlir_module_duration"
_COMPILED = "/jax/core/compile/backend_compile_duration"
_known = {"compiled": False, "forked": False}


def _told(event: str, duration_secs: float, **_: Any) -> None:
    if event == _COMPILED:
        _known["compiled"] = True
    elif event == _LOWERED and _known["forked"]:
        raise RunError(
            "this process was forked after JAX had compiled in its parent, so XLA would wait here for ever; start "
            "processes by spawn or forkserver: multiprocessing.get_context('forkserver')"
        )


def _after_fork() -> None:
    _known["forked"] = _known["compiled"]


def watch() -> None:
    """Refuse, from now on, to compile by XLA in a process that is forked after it has compiled in this one."""
    if hasattr(os, "register_at_fork"):
        jax.monitoring.register_event_duration_secs_listener(_told)
        os.register_at_fork(after_in_child=_after_fork)
