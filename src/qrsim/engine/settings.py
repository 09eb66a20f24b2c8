"""Settings of the process: how many CPU devices, where compiled programs are kept."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh

from qrsim.engine.folders import cache_folder, private, tidy
from qrsim.errors import UsageError

# The older code generator of XLA:CPU compiles a tick in half the time of the newer one. It runs a few vehicles as fast,
# hundreds more slowly.
FEW_VEHICLES = 64
_QUICK_TO_COMPILE = {"xla_cpu_use_fusion_emitters": False}

# The axis that is cut among devices.
WORLDS = "worlds"
COMPILERS = ("llvm", "xla")
CODE_TIERS = ("auto", "quick", "better")
_chosen: dict[str, Any] = {"compiler": None, "threads": None}


def configure(*, cpu_devices: int | None = None, compiler: str | None = None) -> None:
    """Set the number of CPU devices (``cpu_devices``) and the compiler; call it before anything is computed.

    Args:
        cpu_devices: cores that a rollout spreads its worlds over, and one world of thousands of vehicles its vehicles;
            None: as it is, at first all that there are.
        compiler: what makes machine code of a tick: "llvm", the package's own generator for processors, or "xla", which
            is also what compiles for other devices and whatever the first one cannot compile; None: as it is. The
            environment variable QRSIM_COMPILER says the same.

    Raises:
        UsageError: not a positive whole number, or JAX has already started with another number; or no such compiler.
    """
    if compiler is not None:
        _chosen["compiler"] = _checked_compiler(compiler, "compiler")
    if cpu_devices is None:
        return
    if isinstance(cpu_devices, bool) or not isinstance(cpu_devices, int) or cpu_devices < 1:
        raise UsageError(f"cpu_devices: {cpu_devices!r} is not a positive whole number")
    _chosen["threads"] = cpu_devices
    # JAX fixes its devices at the first computation.
    config = jax.config
    try:
        config.update("jax_num_cpu_devices", cpu_devices)
    except RuntimeError:
        found = len(jax.devices("cpu"))
        if found != cpu_devices:
            raise UsageError(
                f"cpu_devices: JAX has already started with {found}; call qrsim.configure before anything is computed"
            ) from None


def _checked_compiler(name: object, where: str) -> str:
    """Return a compiler's name if it is known, else raise UsageError that names ``where`` it was given."""
    if name not in COMPILERS:
        raise UsageError(f"{where}: '{name}' is not known; expected one of {', '.join(COMPILERS)}")
    return str(name)


def uses_llvm() -> bool:
    """Return whether this package's own LLVM generator compiles ticks: on CPUs, unless XLA is chosen.

    Raises:
        UsageError: the environment names no compiler.
    """
    named = os.environ.get("QRSIM_COMPILER")
    # What a program says comes before what its environment says.
    asked = _chosen["compiler"] or (_checked_compiler(named, "QRSIM_COMPILER") if named else "llvm")
    return bool(asked == "llvm" and jax.default_backend() == "cpu")


def chosen_compiler() -> str:
    """Return which compiler is tried first, "llvm" or "xla"; raise UsageError as ``uses_llvm`` does."""
    return "llvm" if uses_llvm() else "xla"


def tier() -> str:
    """Return the tier of machine code from QRSIM_TIER: "quick", "better" or "auto" (quick, then better).

    "auto" runs quick code until better code is ready, which another process compiles.

    Raises:
        UsageError: the environment variable has another value.
    """
    named = os.environ.get("QRSIM_TIER") or "auto"
    if named not in CODE_TIERS:
        raise UsageError(f"QRSIM_TIER: '{named}' is not known; expected one of {', '.join(CODE_TIERS)}")
    return named


def device_mesh() -> Mesh | None:
    """Return a mesh of all JAX devices, over which a rollout splits its worlds; None for a single device."""
    devices = jax.devices()
    return Mesh(np.array(devices), (WORLDS,)) if len(devices) > 1 else None


def threads() -> int:
    """Return the number of threads for a rollout or one large world."""
    return int(_chosen["threads"] or available_cores())


def available_cores() -> int:
    """Return the number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@lru_cache(maxsize=1)
def quick_to_compile() -> dict[str, Any]:
    """Return XLA options for quick compilation of short runs; {} if this XLA does not know them."""
    try:
        jax.jit(lambda: 0, compiler_options=_QUICK_TO_COMPILE).lower().compile()
    except jax.errors.JaxRuntimeError:
        # Newer ones have no other code generator, and refuse an option that they do not know.
        return {}
    return _QUICK_TO_COMPILE


def quick_jit(function: Callable[..., Any], **options: Any) -> Any:
    """Return ``jax.jit(function, **options)`` that compiles quickly; XLA is asked for its options at the first call."""
    # At the first call, because to ask XLA for its options starts it, which an import must not.
    compiled = lru_cache(maxsize=1)(lambda: jax.jit(function, compiler_options=quick_to_compile(), **options))

    @wraps(function)
    def call(*arguments: object, **named: object) -> Any:
        """Call the compiled function, compiling it at the first call."""
        return compiled()(*arguments, **named)

    return call


def use_compilation_cache() -> None:
    """Make XLA cache its programs in the user's cache folder, unless JAX is set otherwise or caching is off.

    A folder that others can write into is not used, with a warning.
    """
    config: Any = jax.config
    if config.jax_compilation_cache_dir or os.environ.get("QRSIM_COMPILATION_CACHE") == "off":
        return
    place = cache_folder() / "compiled"
    if not private(place):
        return
    tidy(place)
    config.update("jax_compilation_cache_dir", str(place))
    # What compiles faster than that is not worth a file.
    config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    config.update("jax_persistent_cache_min_entry_size_bytes", -1)
