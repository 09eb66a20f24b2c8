"""The study of wrong input in its small form: three hundred mutations, each taken or refused in words."""

from __future__ import annotations

import pytest
from evidence import fuzz
from evidence.__main__ import plain


@pytest.mark.long
def test_small_form():
    entries = fuzz.some(fuzz.SMALL)
    bad = [entry for entry in entries if entry["outcome"] not in ("taken", "refused")]
    assert not bad, bad
    found = plain(fuzz.summed_up(entries))
    assert found["cases"] == fuzz.SMALL
    assert set(found["kinds"]) == set(fuzz.KINDS)
    # Mutations that are all refused, or all taken, would say little.
    assert min(found["taken"], found["refused"]) > fuzz.SMALL // 10


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
