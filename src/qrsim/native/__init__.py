"""Machine code for a processor from the same tick that JAX traces: whole ticks in one function, the state in its cache.

XLA makes some hundred loops of a tick, and every one of them goes through memory. Here the tick's jaxpr becomes a few
loops over vectors, written as LLVM's text and compiled by it. What a program does that the code generator cannot do is
``UnsupportedError``, and then XLA compiles it as before.
"""

from qrsim.native.cache import identity, kept
from qrsim.native.lanes import Lanes, Together, layout_of
from qrsim.native.once import forget, once
from qrsim.native.program import Binary, Input, Mode, Program, aligned, build
from qrsim.native.refusal import UnsupportedError
from qrsim.native.start import Start, build_start, trace_of

__all__ = [
    "Binary",
    "Input",
    "Lanes",
    "Mode",
    "Program",
    "Start",
    "Together",
    "UnsupportedError",
    "aligned",
    "build",
    "build_start",
    "forget",
    "identity",
    "kept",
    "layout_of",
    "once",
    "trace_of",
]
