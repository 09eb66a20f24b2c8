"""The pages of models name every component and files that exist; equations are numbered, links lead somewhere."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import pytest
from evidence import docs

from qrsim.models.gnss.receivers import Sky
from qrsim.models.scene.area import StateLimits
from qrsim.scenarios import catalogue
from qrsim.studies.validate import parts

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = {
    page.stem: page.read_text("utf-8")
    for page in [
        DOCS / "howto" / "choose_an_estimator.md",
        DOCS / "reference" / "setpoints.md",
        DOCS / "explanation" / "task_design.md",
        *sorted((DOCS / "explanation" / "models").glob("*.md")),
    ]
}
ALL_PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def test_every_component_of_the_catalogue_is_named() -> None:
    text = "\n".join(PAGES.values())
    kinds = [value for value in vars(catalogue).values() if isinstance(value, dict)]
    names = {name for kind in kinds for name, record in kind.items() if hasattr(record, "__dataclass_fields__")}
    names -= {"none", "given", "still", "calm"}
    # What other tests of the same process have taken in from files is not built in.
    names = {name for name in names if ":" not in name}
    assert len(names) > 40
    assert sorted(name for name in names if f"`{name}`" not in text and f": {name}`" not in text) == []


@pytest.mark.parametrize("letter", "VAGNSECTFRDW")
def test_equations_are_numbered_one_by_one(letter: str) -> None:
    pages = [re.sub(r"\]\([^)]*\)", "]", text) for text in PAGES.values()]
    # A number begins a line, perhaps in bold, or is the tag of an equation in LaTeX.
    pattern = re.compile(rf"(?:^(?:\*\*)?\(|\\tag\{{){letter}(\d+)[)}}]", re.MULTILINE)
    found = sorted(numbers for text in pages if (numbers := [int(number) for number in pattern.findall(text)]))
    together = [number for numbers in found for number in numbers]
    assert together == list(range(1, len(together) + 1))
    assert len(found) == (2 if letter == "V" else 1)
    for numbers in found:
        assert f"({letter}{numbers[0]}) to ({letter}{numbers[-1]})" in PAGES["index"]


def _defaults() -> dict[str, set[float]]:
    """Return the numbers that fields of components have by default, by the name of the field."""
    kinds = [value for value in vars(catalogue).values() if isinstance(value, dict)]
    found: dict[str, set[float]] = {}
    for record in [*(record for kind in kinds for record in kind.values()), Sky, StateLimits]:
        for field in dataclasses.fields(record) if dataclasses.is_dataclass(record) else ():
            if isinstance(field.default, int | float):
                found.setdefault(field.name, set()).add(float(field.default))
    return found


def _stated() -> list[tuple[str, str, str]]:
    """Return page, parameter and number of the tables of parameters and of constants."""
    stated = []
    for page, text in PAGES.items():
        for header, body in re.findall(
            r"^(\| (?:parameter|constant) \|.*)\n\|[-|]+\n((?:\|.*\n)+)", text, re.MULTILINE
        ):
            place = header.split("|").index(" parameter ")
            for row in body.splitlines():
                cells = row.split("|")
                names = re.findall(r"`(\w+)`", cells[place])
                value = re.sub(r" to ", ", ", cells[2]).split(";")[0]
                numbers = [match[0] for part in value.split(", ") if (match := docs.NUMBER.match(part.strip()))]
                if len(names) == len(numbers):
                    stated += [(page, name, number) for name, number in zip(names, numbers, strict=True)]
    return stated


def test_defaults_are_those_of_the_components() -> None:
    defaults, stated = _defaults(), _stated()
    assert len(stated) > 60
    wrong = []
    for page, name, number in stated:
        if name == "collision_distance":
            continue  # the world's own
        scale = math.pi / 180.0 if (page, name) == ("vehicle", "rate_max") else 1.0  # shown in degrees
        known = {value / scale for value in defaults.get(name, ())}
        if not any(float(docs.rounded(value, number)) == float(number) for value in known):
            wrong.append(f"{page}: {name} is {number}; the default is {sorted(known) or 'none'}")
    assert wrong == []


def test_files_and_tests_exist() -> None:
    missing = []
    for page in sorted(DOCS.rglob("*.md")):
        rooms = "tests|core|models|control|world|flight_logs|evidence|simulation|engine|links|interface|tasks"
        for path in re.findall(rf"(?<!/)\b((?:{rooms})/[\w/]*\.py)", page.read_text("utf-8")):
            there = ROOT / path if path.startswith(("tests/", "evidence/")) else ROOT / "src" / "qrsim" / path
            missing += [] if there.exists() else [f"{page.relative_to(DOCS)}: {path}"]
    assert missing == []


def _anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists() or (anchor and anchor not in _anchors(file)):
            broken.append(target)
    assert broken == []


def test_no_page_cites_what_a_reader_does_not_have() -> None:
    for page in ALL_PAGES:
        assert not re.search(r"\[R\]|\[S\]|models\.md section|\bspec\.md", page.read_text("utf-8")), page


def test_every_part_of_the_validation_is_in_the_table_of_the_paper() -> None:
    page = (DOCS / "explanation" / "paper.md").read_text("utf-8")
    rows = re.findall(r"^\|.*`qrsim validate --only (\w+)`", page, re.MULTILINE)
    assert sorted(rows) == sorted(parts.PARTS)
    assert "| `qrsim slam --seeds 8` |" in page
