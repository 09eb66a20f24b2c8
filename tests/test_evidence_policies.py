"""The study of policies in its small form: what compiled ones cost is less than what those in NumPy do."""

from __future__ import annotations

import pytest
from evidence import policies
from evidence.__main__ import plain


@pytest.mark.long
def test_small_form() -> None:
    found = plain(policies.run(full=False))
    assert set(found) == {*policies.NAMES, "load_average"}
    assert all(found[name]["w1"]["per_wall_second"] > 0 for name in policies.NAMES)
