"""Which environments the tests of all of them make in which tier."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

# The others take seconds to load and compile.
QUICK = ("keep_spot", "goto_waypoint", "cats_and_mouse/1A")
# Of each family, one variant by day for one vehicle and one for several; both kinds of plumes that the wind carries.
BY_DAY = ("cats_and_mouse/1C", "search_and_rescue/2B", "search_and_rescue/2D", "plume_mapping/3D", "plume_mapping/3F")


def every(names: Sequence[str]) -> Any:
    """Return a case for every name: the quick ones in the short tier, other variants of a family at night."""
    cases = []
    for name in names:
        later = pytest.mark.nightly if "/" in name and name not in BY_DAY else pytest.mark.long
        cases.append(pytest.param(name, marks=() if name in QUICK else (later,)))
    return pytest.mark.parametrize("name", cases)
