"""Processes forked after JAX has compiled: they lack XLA's threads, and XLA would wait for them for ever.

qrsim's own machine code runs in such a process. Everything that needs XLA is refused, a policy under ``jax.jit`` too.
"""

from __future__ import annotations

import os
import sys

import jax

from qrsim.errors import RunError

# JAX's events: it begins to lower a function for XLA; XLA has compiled it.
_LOWERING = "/jax/core/compile/jaxpr_to_mlir_module_duration"
_COMPILED = "/jax/core/compile/backend_compile_duration"
_known = {"compiled": False, "forked": False}


def refuse() -> None:
    """Raise RunError if this process was forked and XLA can neither compile nor run in it."""
    if _known["forked"]:
        raise RunError(
            "this process was forked after JAX had compiled in its parent, so XLA would wait here for ever; start "
            "processes by spawn or forkserver: multiprocessing.get_context('forkserver')"
        )


def _on_event(event: str, value: float, **_: object) -> None:
    """Raise RunError when JAX reports that a compilation begins after such a fork; listener of JAX events."""
    # At the start: lowering a function of several parts waits for threads already.
    if event == _LOWERING:
        refuse()


def _on_duration(event: str, duration_secs: float, **_: object) -> None:
    """Note that this process has compiled; listener of JAX's reports of durations."""
    if event == _COMPILED:
        _known["compiled"] = True


def _after_fork() -> None:
    """Note in a forked child process whether its parent had compiled with XLA."""
    _known["forked"] = _known["compiled"]


def watch() -> None:
    """Register listeners that raise RunError if XLA compiles in a process forked after XLA had compiled."""
    if sys.platform != "win32":
        jax.monitoring.register_scalar_listener(_on_event)
        jax.monitoring.register_event_duration_secs_listener(_on_duration)
        os.register_at_fork(after_in_child=_after_fork)
