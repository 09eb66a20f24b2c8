"""Idioms, long sentences and clauses as subjects are counted, and their ceilings only fall."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tools import prose

TEXT = """---
questions:
  - What is not counted?
---

# Whose heading

The receiver beside the mast is told nothing; it stands.
What it says is late. Why does a question count? What counts is not this?

- Where [a link](anew.md) leads, `beside` is code.

| Of a table | anew |
|---|---|

```text
What stands beside.
```
"""


def page(tmp_path: Path, text: str, name: str = "page.md") -> dict[str, list[str]]:
    file = tmp_path / name
    file.write_text(text, "utf-8")
    return prose.found(file)


def test_prose_is_counted_without_code_tables_and_headings(tmp_path: Path) -> None:
    counted = page(tmp_path, TEXT)
    assert [each.partition(":")[0] for each in counted["idioms"]] == ["beside", "is told", "stands"]
    assert counted["openings"] == ["What it says is late.", "Where a link leads, `beside` is code."]
    assert counted["long sentences"] == []


def test_a_sentence_is_long_from_31_words_on(tmp_path: Path) -> None:
    for words, long in ((30, 0), (31, 1)):
        assert len(page(tmp_path, f"{'word ' * words}\n")["long sentences"]) == long


def test_docstrings_and_messages_are_counted(tmp_path: Path) -> None:
    counted = page(
        tmp_path, '"""What whoever does."""\nRAISED = f"nobody {1} is there"\nWORD = "beside"\n', "module.py"
    )
    assert [each.partition(":")[0] for each in counted["idioms"]] == ["whoever", "nobody"]
    assert counted["openings"] == ["What whoever does."]


@pytest.mark.parametrize(("count", "ceiling", "faults"), [(2, 2, 0), (3, 2, 1), (0, 2, 0), (1, None, 1)])
def test_counts_stay_below_their_ceilings(count: int, ceiling: int | None, faults: int) -> None:
    ceilings = {} if ceiling is None else {"a.md": [ceiling, 0, 0]}
    found = prose.faults({"a.md": [count, 0, 0]}, ceilings)
    assert len(found) == faults
    assert all(line.startswith(f"a.md: {count} idioms, {ceiling or 0} allowed; see") for line in found)


def test_ceilings_only_fall() -> None:
    ceilings = {"a.md": [2, 5, 0], "gone.md": [1, 0, 0], "done.md": [1, 1, 1]}
    counts = {"a.md": [3, 4, 0], "new.md": [1, 0, 0]}
    assert prose.lowered(counts, ceilings) == {"a.md": [2, 4, 0]}


@pytest.mark.long
def test_no_page_or_source_exceeds_its_ceilings() -> None:
    ceilings = json.loads(prose.CEILINGS.read_text("utf-8"))
    assert len(prose.files(prose.ROOT)) > 300
    assert prose.faults(prose.counted(prose.ROOT), ceilings) == []
