"""Settings of the process: how many CPU devices, where compiled programs are kept."""

from __future__ import annotations

import os
from typing import Any

import jax

from qrsim.errors import UsageError

# The older code generator of XLA:CPU compiles a tick in half the time of the newer one. It runs a few vehicles as fast,
# hundreds more slowly.
FEW_VEHICLES = 64
QUICK_TO_COMPILE = {"xla_cpu_use_fusion_emitters": False}


def configure(*, cpu_devices: int | None = None) -> None:
    """Fix settings that must be known before anything is computed.

    Args:
        cpu_devices: devices that a rollout spreads its worlds over, at best one for each core; None: as it is.

    Raises:
        UsageError: not a positive whole number, or JAX has already started with another number.
    """
    if cpu_devices is None:
        return
    if isinstance(cpu_devices, bool) or not isinstance(cpu_devices, int) or cpu_devices < 1:
        raise UsageError(f"cpu_devices: {cpu_devices!r} is not a positive whole number")
    config: Any = jax.config
    try:
        config.update("jax_num_cpu_devices", cpu_devices)
    except RuntimeError:
        found = len(jax.devices("cpu"))
        if found != cpu_devices:
            raise UsageError(
                f"cpu_devices: JAX has already started with {found}; call qrsim.configure before anything is computed"
            ) from None


def available_cores() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_compilation_cache() -> None:
    """Keep compiled programs in the user's cache, unless JAX was told otherwise or QRSIM_COMPILATION_CACHE is off."""
    config: Any = jax.config
    if config.jax_compilation_cache_dir or os.environ.get("QRSIM_COMPILATION_CACHE") == "off":
        return
    from platformdirs import user_cache_path

    config.update("jax_compilation_cache_dir", str(user_cache_path("qrsim") / "compiled"))
    config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    config.update("jax_persistent_cache_min_entry_size_bytes", -1)
