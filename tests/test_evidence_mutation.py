"""A sample of the mutation study: what its recorded tests killed once, they kill today."""

from __future__ import annotations

import pytest
from evidence import mutation


@pytest.mark.nightly
def test_small_form():
    found = mutation.run(full=False)
    assert not found["missed"], "\n".join(found["missed"])
    assert found["tried"] + len(found["untried"]) == mutation.SMALL
    # Of those that no test is known to kill yet, this says nothing.
    print(f"{found['tried']} killed; not yet tried: " + "; ".join(found["untried"]))
    assert found["tried"] > 0
