"""Own primitives in JAX's programs, which a compiler recognises by name.

Each is a JAX primitive: it can be jitted, batched and differentiated like any other, XLA gets it as the operations of
one function, and our own code generator (``qrsim.engine.llvm``) recognises the primitive itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir


def primitive_of(
    name: str,
    function: Callable[..., object],
    elementwise: bool = False,
    parameters: tuple[str, ...] = (),
    shape: Callable[[tuple[int, ...]], tuple[int, ...]] | None = None,
) -> Primitive:
    """Return a new JAX primitive with one result; XLA compiles and JAX differentiates it as ``function``.

    Args:
        name: of the primitive, in printed programs.
        function: of arrays; it returns an array of the type of the first.
        elementwise: whether it maps each element of one array; a batch then keeps the same operation.
        parameters: names of what else the function takes, which must be known when it is traced.
        shape: gives the shape of the result from that of the first array; None: it is the same.
    """
    primitive = Primitive(name)
    primitive.def_impl(jax.jit(function, static_argnames=parameters))
    result_shape = shape or (lambda first: first)
    primitive.def_abstract_eval(lambda first, *_, **__: first.update(shape=result_shape(first.shape), weak_type=False))
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=False))

    def batched(
        arguments: Sequence[Array], axes: Sequence[int | None], **parameters: object
    ) -> tuple[object, int | None]:
        """Return the primitive's result on a batch (JAX batching rule), and its batch axis."""
        if elementwise:
            return primitive.bind(*arguments), axes[0]
        return jax.vmap(partial(function, **parameters), in_axes=tuple(axes))(*arguments), 0

    def differentiated(primals: Sequence[Array], tangents: Sequence[object], **parameters: object) -> object:
        """Return the primitive's result and its tangent (JAX rule of forward-mode differentiation)."""
        given = tuple(ad.instantiate_zeros(tangent) for tangent in tangents)
        known = partial(function, **parameters)
        return primitive.bind(*primals, **parameters), jax.jvp(known, tuple(primals), given)[1]

    batching.primitive_batchers[primitive] = batched
    ad.primitive_jvps[primitive] = differentiated
    return primitive


@dataclass(frozen=True, eq=False)
class Kernel:
    """An elementwise function that a traced program contains as one operation.

    JAX traces one equation for each call, and the code generator compiles the body once for each program.

    Attributes:
        name: of the primitive.
        takes, gives: types of the arguments and of the results.
        body: function of arrays, one element of each result from one element of each argument; returns a tuple.
        jvp: ``jvp(primals, tangents, results)`` returns the tangents of the results; None: JAX differentiates the body.
    """

    name: str
    takes: tuple[str, ...]
    gives: tuple[str, ...]
    body: Callable[..., tuple[Array, ...]]
    jvp: Callable[..., tuple[Array, ...]] | None = None
    primitive: Primitive = field(init=False, repr=False)

    def __post_init__(self) -> None:
        primitive = Primitive(f"kernel_{self.name}")
        primitive.multiple_results = True
        primitive.def_impl(jax.jit(self.body))
        primitive.def_abstract_eval(self._results)
        mlir.register_lowering(primitive, mlir.lower_fun(self.body, multiple_results=True))
        batching.primitive_batchers[primitive] = self._batched
        ad.primitive_jvps[primitive] = self._differentiated
        object.__setattr__(self, "primitive", primitive)
        KERNELS[self.name] = self

    def __call__(self, *arguments: Array) -> tuple[Array, ...]:
        """Apply the kernel to arrays of one shape, or to such arrays and scalars."""
        if len({argument.shape for argument in arguments} - {()}) > 1:
            arguments = tuple(jnp.broadcast_arrays(*arguments))
        result: tuple[Array, ...] = tuple(self.primitive.bind(*arguments))
        return result

    def _results(self, *avals: Any) -> list[object]:
        """Return the abstract values (shapes and dtypes) of the kernel's results for those of its arguments."""
        assert self.takes == tuple(aval.dtype.name for aval in avals)
        shape = max((aval.shape for aval in avals), key=len)
        return [avals[0].update(shape=shape, dtype=np.dtype(dtype), weak_type=False) for dtype in self.gives]

    def _batched(self, arguments: Sequence[Array], axes: Sequence[int | None]) -> tuple[object, list[int]]:
        """Return the kernel's results on a batch (JAX batching rule), and their batch axes, all 0."""
        rank = max(jnp.ndim(argument) - (axis is not None) for argument, axis in zip(arguments, axes, strict=True))
        moved = []
        for argument, axis in zip(arguments, axes, strict=True):
            if axis is not None:
                batch = jnp.moveaxis(argument, axis, 0)
                # A scalar of each element of the batch stays a scalar there.
                argument = batch.reshape(batch.shape[0], *(1,) * (rank + 1 - batch.ndim), *batch.shape[1:])
            moved.append(argument)
        shape = np.broadcast_shapes(*(argument.shape for argument in moved))
        spread = [each if each.shape == () else jnp.broadcast_to(each, shape) for each in moved]
        return self.primitive.bind(*spread), [0] * len(self.gives)

    def _differentiated(self, primals: Sequence[Array], tangents: Sequence[object]) -> tuple[object, object]:
        """Return the kernel's results and their tangents (JAX rule of forward-mode differentiation)."""
        given = tuple(ad.instantiate_zeros(tangent) for tangent in tangents)
        result = self.primitive.bind(*primals)
        if self.jvp is None:
            return result, jax.jvp(self.body, tuple(primals), given)[1]
        return result, self.jvp(primals, given, result)


# Every kernel, by its name.
KERNELS: dict[str, Kernel] = {}
