"""Machine code for a processor from the same tick that JAX traces: whole ticks in one function, the state in its cache.

XLA makes some hundred loops of a tick, and every one of them goes through memory. Here the tick's jaxpr becomes a few
loops over vectors, written as LLVM's text and compiled by it. What a program does that the code generator cannot do is
``UnsupportedError``, and then XLA compiles it as before.
"""

from qrsim.engine.llvm.calling import Program
from qrsim.engine.llvm.digest import digest
from qrsim.engine.llvm.lanes import LaneProgram, Lanes
from qrsim.engine.llvm.looking import Looks
from qrsim.engine.llvm.printing import FORMS, printed
from qrsim.engine.llvm.program import Binary, Input, Mode, build, trace_tick
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.engine.llvm.start import state_of, trace_of

__all__ = [
    "FORMS",
    "Binary",
    "Input",
    "LaneProgram",
    "Lanes",
    "Looks",
    "Mode",
    "Program",
    "UnsupportedError",
    "build",
    "digest",
    "printed",
    "state_of",
    "trace_of",
    "trace_tick",
]
