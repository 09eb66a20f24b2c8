"""The study of serving in its small form: what it says has the kinds that the documentation quotes, and all is well."""

from __future__ import annotations

import pytest
from evidence import serve
from evidence.__main__ import plain


@pytest.mark.long
def test_small_form():
    found = plain(serve.run(full=False))
    for name in ("lock_step", "outstanding", "written_twice", "readings", "long_steps"):
        assert found[name]["per_second"] > 0
    assert found["written_twice"]["of_one_write"] > 0
    malformed = found["malformed"]
    assert malformed["frames"] >= serve.SMALL
    assert malformed["fine"] + malformed["errors"] == malformed["frames"]
    assert (malformed["unanswered"], malformed["server_alive"], malformed["lines_on_stderr"]) == (0, 1, 0)
    assert malformed["steps_of_another_client"] == malformed["connections"]
