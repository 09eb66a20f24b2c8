"""The study of wrong input in its small form: mutations, each of which is taken or refused in words."""

from __future__ import annotations

import pytest
from evidence import fuzz
from evidence.__main__ import plain


@pytest.mark.parametrize(
    "count", [pytest.param(100, marks=pytest.mark.long), pytest.param(fuzz.SMALL, marks=pytest.mark.nightly)]
)
def test_small_form(count):
    entries = fuzz.some(count)
    bad = [entry for entry in entries if entry["outcome"] not in ("taken", "refused")]
    assert not bad, bad
    found = plain(fuzz.summed_up(entries))
    assert found["cases"] == count
    assert set(found["kinds"]) == set(fuzz.KINDS)
    # Mutations that are all refused, or all taken, would say little.
    assert min(found["taken"], found["refused"]) > count // 10


def test_what_is_no_answer_is_counted(tmp_path, monkeypatch):
    """A target that raises, and one that takes long, are not passed over."""

    def fails(shop, rng):
        raise IndexError("nobody thought of this")

    def waits(shop, rng):
        while True:
            pass

    monkeypatch.setattr(fuzz, "KINDS", {"fails": (1, fails), "waits": (1, waits)})
    monkeypatch.setattr(fuzz, "PATIENCE_S", 0.2)
    shop = fuzz.Workshop(tmp_path)
    assert [fuzz.case(shop, number)["outcome"] for number in (0, 1)] == ["traceback", "hang"]
