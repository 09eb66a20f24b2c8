"""A key of an object differs where the object is another, or something in it has changed."""

from __future__ import annotations

import functools
import weakref
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.sameness import Itself, is_gone, sameness


class Loop:
    def __init__(self, **attributes: Any):
        vars(self).update(attributes)

    def __call__(self) -> None:
        """Be something that can be called, which has attributes all the same."""


CHANGES = {
    "number": (lambda own: setattr(own, "gain", 2.0)),
    "kind of number": (lambda own: setattr(own, "gain", 1)),
    "sign of zero": (lambda own: setattr(own, "none", -0.0)),
    "array in place": (lambda own: own.table.__setitem__(3, 5.0)),
    "array of JAX": (lambda own: setattr(own, "weights", [own.weights[0] * 2.0])),
    "type of an array": (lambda own: setattr(own, "table", own.table.astype(np.float32))),
    "shape": (lambda own: setattr(own, "table", own.table.reshape(2, 2))),
    "element of a dict": (lambda own: own.named.update(kp=0.2)),
    "order of a list": (lambda own: own.several.reverse()),
    "set": (lambda own: own.chosen.add(3)),
    "attribute of an attribute": (lambda own: setattr(own.inner, "gain", 4.0)),
    "another function": (lambda own: setattr(own, "function", max)),
    "another attribute": (lambda own: setattr(own, "more", None)),
}


def made() -> Any:
    return Loop(
        gain=1.0, none=0.0, table=np.arange(4.0), weights=[jnp.ones(3)], named={"kp": 0.1}, several=[1, 2], chosen={1},
        inner=Loop(gain=3.0), function=min, missing=float("nan"), part=functools.partial(min, 1), own=None, module=np,
    )  # fmt: skip


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_change_makes_another_key(change):
    own = made()
    # What holds itself comes to an end.
    own.own = own
    before = sameness(own)
    assert sameness(own) == before
    assert hash(sameness(own)) == hash(before)
    change(own)
    assert sameness(own) != before


def test_objects_that_look_alike_are_two():
    assert sameness(made()) != sameness(made())
    assert sameness(min) == sameness(min) != sameness(max)


def test_what_a_program_that_was_made_left_behind_changes_nothing():
    import jax

    own = Loop()
    keys = []
    for _ in range(2):
        jax.make_jaxpr(lambda x: setattr(own, "last", x))(1.0)
        keys.append(sameness(own))
    assert keys[0] == keys[1]


def test_a_key_keeps_no_object_and_equals_nothing_once_that_is_gone():
    own = Loop(gain=1.0)
    seen, key, again = weakref.ref(own), sameness(own), sameness(own)
    assert key == again
    assert not is_gone(("policy", key))
    del own
    assert seen() is None
    assert is_gone(("policy", key))
    assert key != again
    assert key == key


def test_an_object_without_weak_references_is_kept():
    key = Itself(2**70)
    assert not is_gone(key)
    assert key != Itself(int("1180591620717411303424"))
