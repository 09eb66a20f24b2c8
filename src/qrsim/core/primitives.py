"""Own primitives in JAX's programs, which a compiler recognises by name.

Each is a JAX primitive: it can be jitted, batched and differentiated like any other, XLA gets it as the operations of
one function, and our own code generator (``qrsim.engine.llvm``) recognises the primitive itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir


def primitive_of(name: str, function: Callable[..., Any], elementwise: bool = False) -> Any:
    """Make a primitive of one result that XLA lowers, and JAX differentiates, through a function.

    Args:
        name: of the primitive, for whoever prints a program.
        function: of arrays, that returns an array of the shape and type of the first.
        elementwise: of one array, each element for itself; then it stays the same operation on a batch.
    """
    primitive: Any = Primitive(name)
    primitive.def_impl(jax.jit(function))
    primitive.def_abstract_eval(lambda *avals: avals[0].update(weak_type=False))
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=False))

    def batched(arguments: Any, axes: Any, **parameters: Any) -> tuple[Any, int]:
        if elementwise:
            return primitive.bind(*arguments), axes[0]
        return jax.vmap(function, in_axes=tuple(axes))(*arguments), 0

    def differentiated(primals: Any, tangents: Any, **parameters: Any) -> Any:
        given = tuple(ad.instantiate_zeros(tangent) for tangent in tangents)  # type: ignore[no-untyped-call]
        return primitive.bind(*primals), jax.jvp(function, tuple(primals), given)[1]

    batching.primitive_batchers[primitive] = batched
    ad.primitive_jvps[primitive] = differentiated
    return primitive
