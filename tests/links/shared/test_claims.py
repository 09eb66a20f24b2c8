"""Who may command which vehicle, and what is said to who may not."""

from __future__ import annotations

import pytest

from qrsim.errors import UsageError
from qrsim.links.shared.claims import Claims


def claims() -> Claims:
    return Claims(["cat_0", "cat_1", "mouse", "tree"], deaf=["tree"])


def test_a_vehicle_has_one_holder_until_it_is_given_back():
    found = claims()
    assert found.take(1, ["cat_1", "cat_0", "cat_1"]) == ("cat_1", "cat_0")
    assert found.of(1) == ("cat_0", "cat_1")
    with pytest.raises(UsageError, match="CLAIM: 'cat_0' is flown by client 1, which has to release it first"):
        found.take(2, ["mouse", "cat_0"])
    # All of them or none.
    assert found.holder("mouse") == 0
    assert found.give_back(1, ["cat_0"]) == ("cat_0",)
    assert found.take(2, ["mouse", "cat_0"]) == ("mouse", "cat_0")
    assert found.holders == [1, 2]
    assert found.give_back(2) == ("cat_0", "mouse")
    assert found.holders == [1]


def test_without_names_all_that_are_free():
    found = claims()
    found.take(1, ["cat_1"])
    assert found.take(2, []) == ("cat_0", "mouse")
    with pytest.raises(UsageError, match="no vehicle is free: 'cat_1' is flown by client 1; 'cat_0' is"):
        found.take(3, [])


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda found: found.take(1, ["mose"]), "CLAIM: no vehicle is called 'mose'; did you mean 'mouse'?"),
        (lambda found: found.take(1, ["tree"]), "CLAIM: 'tree' takes no orders"),
        (lambda found: found.give_back(1, ["cat_0"]), "RELEASE: 'cat_0' is flown by client 7"),
        (lambda found: found.check_own(1, "cat_0", "COMMAND"), "COMMAND: 'cat_0' is flown by client 7"),
        (lambda found: found.check_own(1, "mouse", "COMMAND"), "COMMAND: 'mouse' is not claimed; CLAIM it first"),
        (lambda found: found.check_own(1, "cat_9", "COMMAND"), "COMMAND: no vehicle is called 'cat_9'; did you"),
    ],
)
def test_what_is_wrong_is_said(ask, said):
    found = claims()
    found.take(7, ["cat_0"])
    with pytest.raises(UsageError) as error:
        ask(found)
    assert str(error.value).startswith(said)
    assert found.of(7) == ("cat_0",)
