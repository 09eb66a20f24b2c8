"""The folder of the source: few rooms, each of which says what it is for, and a page that says where to begin."""

from __future__ import annotations

import ast
import itertools
import re
import tomllib
from pathlib import Path

import pytest

import qrsim

SOURCE = Path(qrsim.__file__).parent
ROOMS = sorted(path.parent.name for path in SOURCE.glob("*/__init__.py"))
STUDIES = sorted(path.parent.name for path in SOURCE.glob("studies/*/__init__.py"))
PAGE = (SOURCE / "README.md").read_text("utf-8")
# A table's numbers are rounded, and may be off by as much before somebody has to write them again.
TOLERANCE = 0.1


def below() -> dict[str, list[str]]:
    """Return, for each room, the layer under it in the contract of import-linter."""
    project = tomllib.loads((SOURCE.parents[1] / "pyproject.toml").read_text("utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (layers,) = (each["layers"] for each in contracts if each["name"].startswith("layers"))
    names = [[name.strip().removeprefix("qrsim.") for name in layer.split("|")] for layer in layers]
    return {room: lower for upper, lower in itertools.pairwise(names) for room in upper}


def lines_of(room: str) -> int:
    """Count the lines of a room's Python, without generated files."""
    files = [path for path in (SOURCE / room).rglob("*.py") if not path.stem.endswith("_pb2")]
    return sum(len(path.read_text("utf-8").splitlines()) for path in files)


def docstring(folder: Path) -> str:
    return ast.get_docstring(ast.parse((folder / "__init__.py").read_text("utf-8"))) or ""


def test_the_top_has_few_rooms_and_modules() -> None:
    assert len(ROOMS) <= 16, ROOMS
    modules = sorted(path.stem for path in SOURCE.glob("*.py"))
    assert modules == ["__init__", "cli", "contracts", "errors", "extras", "starting"]
    folders = {path.name for path in SOURCE.iterdir() if path.is_dir()} - {"__pycache__"}
    assert folders == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_it_may_import(room: str) -> None:
    names = ", ".join(f"``{name}``" for name in below()[room])
    layers = "layers below them" if "," in names else "layers below it"
    assert f"\nIt may import {names} and the {layers}.\n" in docstring(SOURCE / room)


@pytest.mark.parametrize("folder", [*ROOMS, *(f"studies/{name}" for name in STUDIES)])
def test_a_room_says_where_to_begin(folder: str) -> None:
    text = docstring(SOURCE / folder)
    found = re.search(r"\nRead ``([\w/]+\.py)`` first\.$", text)
    assert found, text
    assert (SOURCE / folder / found[1]).is_file()
    assert 4 <= len([line for line in text.splitlines() if line]) <= 7, text


def test_the_page_names_ten_files_that_exist() -> None:
    files = re.findall(r"^\| `([\w/]+\.py)` \|", PAGE, re.MULTILINE)
    assert len(set(files)) == 10
    assert [name for name in files if not (SOURCE / name).is_file()] == []


def test_the_page_counts_every_room() -> None:
    stated = {
        name: int(count.replace(" ", "")) for name, count in re.findall(r"^\| `(\w+)/` \| ([\d ]+) \|", PAGE, re.M)
    }
    assert sorted(stated) == ROOMS
    counted = {room: lines_of(room) for room in ROOMS}
    wrong = {room: count for room, count in counted.items() if abs(count - stated[room]) > TOLERANCE * count}
    assert wrong == {}, "write these numbers into src/qrsim/README.md, rounded to hundreds"


def test_the_simulator_has_as_many_lines_as_its_title_says() -> None:
    table = PAGE.partition("| simulator | lines | content |")[2].partition("| together |")
    rooms = [name for name, _ in re.findall(r"^\| `(\w+)/` \| ([\d ]+) \|", table[0], re.MULTILINE)]
    assert rooms == ["core", "control", "world", "interface", "simulation"]
    total = sum(map(lines_of, rooms))
    together = int(table[2].partition("|")[0].replace(" ", ""))
    assert together == pytest.approx(total, rel=TOLERANCE)
    assert total == pytest.approx(17_000, rel=TOLERANCE), "the title of src/qrsim/README.md"
