"""LLVM's text to machine code, in two tiers that compute the same bits.

Quick code takes a fifth of the time to compile, and its ticks take one to three times as long. As a script, this
module compiles its standard input to better code; it imports nothing of the package.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator
from functools import lru_cache

import llvmlite.binding as llvm

# Sessions of a server compile in threads of their own; here one does at a time.
_LOCK = threading.Lock()
# First line of a text in which LLVM should begin no operation long before its result is needed.
TOPDOWN = "; topdown"


@lru_cache(maxsize=1)
def _native_target() -> llvm.Target:
    """Return LLVM's description (target) of this machine."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


def _target_machine(tier: str = "better") -> llvm.TargetMachine:
    """Return LLVM's target machine with this CPU's features, for quick or better code (``tier``)."""
    name, features = llvm.get_host_cpu_name(), _cpu_features().flatten()
    return _native_target().create_target_machine(
        cpu=name, features=features, opt=0 if tier == "quick" else 2, jit=True
    )


@lru_cache(maxsize=1)
def _cpu_features() -> llvm.FeatureMap:
    """Return the features of this CPU that LLVM knows, such as AVX2."""
    _native_target()
    return llvm.get_host_cpu_features()


@lru_cache(maxsize=1)
def vector_bytes() -> int:
    """Return the vector size [bytes] of programs: 32 on processors with AVX but not AVX-512, else 64."""
    features = _cpu_features()
    # A longer vector would take two of the few registers for each value.
    return 32 if features.get("avx") and not features.get("avx512f") else 64


@lru_cache(maxsize=1)
def machine_name() -> str:
    """Return a text of all that machine code depends on: processor, its features, compiler version."""
    version = ".".join(map(str, llvm.llvm_version_info))
    return f"{llvm.get_host_cpu_name()} {_cpu_features().flatten()} llvm {version}"


def machine_triple() -> str:
    """Return LLVM's target triple of this machine, such as "x86_64-unknown-linux-gnu"."""
    found: str = _native_target().triple
    return found


def machine_code(text: str, tier: str = "better") -> bytes:
    """Compile the text of an LLVM module to an object file, quickly or to faster code (``tier``).

    Args:
        text: of the module.
        tier: "quick" or "better".
    """
    with _LOCK:
        machine = _target_machine(tier)
        module = llvm.parse_assembly(text)
        # A text that LLVM would misread ends here, as an error that XLA takes over, and not as a wrong program.
        module.verify()
        if tier == "better":
            # Sums are kept in memory of the stack, which this pass makes registers. The text has no other use for
            # passes: it repeats nothing, and its loops are vectors where they should be.
            passes = llvm.create_new_module_pass_manager()
            passes.add_sroa_pass()
            passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
        # Object code and not a running engine, because that can be kept in a file.
        with _scheduled(text):
            code: bytes = machine.emit_object(module)
        return code


@contextlib.contextmanager
def _scheduled(text: str) -> Iterator[None]:
    """Return a context with LLVM's instruction scheduling set as ``text`` asks, on processors with a known default."""
    if not text.startswith(TOPDOWN) or not machine_triple().startswith("x86_64"):
        yield
        return
    # An option of the whole process, so it is set back, for other users of llvmlite.
    llvm.set_option("", "--misched-prera-direction=topdown")
    try:
        yield
    finally:
        llvm.set_option("", "--misched-prera-direction=bottomup")


class Loaded:
    """An object file in memory, which lives as long as this object.

    Args:
        code: what ``machine_code`` returned, on a machine of the same name.
    """

    def __init__(self, code: bytes):
        with _LOCK:
            self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
            self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
            self._engine.finalize_object()

    def address(self, name: str) -> int:
        """Return the address of a function in the loaded code."""
        found: int = self._engine.get_function_address(name)
        return found


if __name__ == "__main__":
    sys.stdout.buffer.write(machine_code(sys.stdin.read()))
