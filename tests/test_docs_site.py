"""The documentation site: pages are collected and have a place, and the generated ones are those of the code."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from tools import reference, site
from tools.reference import environment_variables
from tools.site_source import BrokenLinkError, collect, pages

import qrsim

ROOT = Path(__file__).resolve().parent.parent
# Those that build every schema or compile a world: one process makes them, without what other tests have registered.
SLOW = ("components", "scenario_schema", "log_columns")
ADVICE = "run 'make docs-pages'"
# Pages with a goal: each names the questions that it answers, for a fresh reader before a release.
ANSWERING = [page for kind in ("start", "howto", "explanation") for page in (ROOT / "docs" / kind).rglob("*.md")]


@pytest.mark.parametrize("module", [name for name in reference.MODULES if name not in SLOW])
def test_generated_pages_are_those_of_the_code(module: str) -> None:
    for name, text in reference.made(module).items():
        assert (reference.FOLDER / name).read_text("utf-8") == text, ADVICE


@pytest.mark.long
def test_all_generated_pages_are_those_of_the_code() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tools.reference", "--check"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_every_page_has_a_place_of_its_own() -> None:
    assert site.without_a_place() == []
    names = list(pages(ROOT).values())
    assert len(set(names)) == len(names)


def test_the_index_names_every_page_once() -> None:
    index = ROOT / "docs" / "index.md"
    tables = index.read_text("utf-8").partition("\n## ")[2]
    named = sorted((index.parent / link).resolve() for link in re.findall(r"\]\(([^)]+)\)", tables))
    expected = sorted(path for path in pages(ROOT) if path.suffix == ".md" and path not in (index, ROOT / "README.md"))
    assert named == expected


def test_every_environment_variable_is_listed() -> None:
    sources = [path for path in (ROOT / "src").rglob("*") if path.suffix in (".py", ".c")]
    read = {name for path in sources for name in re.findall(r"QRSIM_[A-Z_]+", path.read_text("utf-8"))}
    listed = {row[0] for row in (*environment_variables.PUBLIC, *environment_variables.INTERNAL)}
    assert "QRSIM_DATA_DIR" in read
    assert read == listed - {"QRSIM_PEERS"}


@pytest.mark.parametrize(
    "page", [path for path in pages(ROOT) if path.suffix == ".md"], ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_headings_of_a_page_differ(page: Path) -> None:
    """GitHub and the site number the anchors of equal headings differently."""
    if page.name == "CHANGELOG.md":
        return
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = [line.lstrip("#").strip().lower() for line in text.splitlines() if re.match(r"#+ ", line)]
    assert sorted({each for each in headings if headings.count(each) > 1}) == []


def test_fields_of_records_show_their_declaration() -> None:
    griffe = pytest.importorskip("griffe", reason="make docs installs it")
    extensions = griffe.load_extensions(str(ROOT / "tools" / "record_fields.py"))
    file = ROOT / "src" / "qrsim" / "models" / "sensors" / "barometer.py"
    module = griffe.visit("barometer", filepath=file, code=file.read_text("utf-8"), extensions=extensions)
    fields = module["Barometer"].members
    assert fields["drift_std"].docstring.value == "Stationary std of the drift [m]; at least 0.0; default 0.26"
    assert fields["drift_time_constant"].docstring.value == ("Time constant of the drift [s]; above 0.0; default 300.0")
    assert fields["drift_std"].value is None


def test_pages_that_docstrings_name_are_links() -> None:
    griffe = pytest.importorskip("griffe", reason="make docs installs it")
    extensions = griffe.load_extensions(str(ROOT / "tools" / "record_fields.py"))
    code = 'def wave():\n    """Waves (docs/models/air.md), [gusts](docs/gusts.md)."""\n'
    with griffe.temporary_pypackage("waves", {"__init__.py": code}) as package:
        module = griffe.load("waves", search_paths=[package.tmpdir], extensions=extensions)
    text = module["wave"].docstring.value
    assert text == "Waves ([docs/models/air.md](../../models/air.md)), [gusts](docs/gusts.md)."


def test_attributes_that_share_an_entry_get_one_each() -> None:
    griffe = pytest.importorskip("griffe", reason="make docs installs it")
    extensions = griffe.load_extensions(str(ROOT / "tools" / "record_fields.py"))
    code = (
        'class Box:\n    """A box.\n\n    Attributes:\n        low, high: its ends,\n            in metres.\n    """\n'
    )
    with griffe.temporary_pypackage("boxes", {"__init__.py": code}) as package:
        module = griffe.load("boxes", search_paths=[package.tmpdir], extensions=extensions)
    _, attributes = module["Box"].docstring.parse("google")
    assert [(each.name, each.description) for each in attributes.value] == [
        ("low", "its ends,\nin metres."), ("high", "its ends,\nin metres."),
    ]  # fmt: skip


def test_every_public_name_has_an_entry() -> None:
    page = (ROOT / "docs" / "reference" / "api" / "qrsim.md").read_text("utf-8")
    entries = re.findall(r"^::: qrsim\.(\w+)$", page, re.MULTILINE)
    assert sorted(entries) == sorted(set(qrsim.__all__) - {"__version__"})


def prose_words(text: str) -> int:
    """Return the words of a page without its head, code, comments and tables."""
    text = re.sub(r"\A---\n.*?\n---\n", "", text, flags=re.DOTALL)
    text = re.sub(r"^ *```.*?^ *```$|<!--.*?-->|^\|.*?$", "", text, flags=re.MULTILINE | re.DOTALL)
    return len(text.split())


def test_words_are_those_of_the_prose() -> None:
    head, table, code = "---\na: b\n---\n", "| a | b |\n|---|---|\n", "```text\nc d\n```\n"
    assert prose_words(f"{head}\n# One two\n\n{table}\n{code}<!--ev a.b\nc.d -->\nThree `four` five.\n") == 6


@pytest.mark.parametrize("page", ANSWERING, ids=lambda page: page.relative_to(ROOT / "docs").as_posix())
def test_a_page_names_three_questions_and_is_short(page: Path) -> None:
    text = page.read_text("utf-8")
    _, head, body = text.split("---\n", 2)
    questions = yaml.safe_load(head)["questions"]
    assert len(set(questions)) == 3
    assert [each for each in questions if not re.fullmatch(r"[A-Z].{15,100}\?", each)] == []
    assert body.startswith("\n# ")
    assert page.parent.name == "models" or prose_words(text) <= 1200


class TestCollecting:
    """A small repository."""

    @pytest.fixture
    def root(self, tmp_path: Path) -> Path:
        for name, text in {
            "README.md": "[air](docs/air.md#wind) [all](docs/index.md) [code](src/a.py#L3) [web](https://example.org)\n",
            "CONTRIBUTING.md": "[here](README.md)\n",
            "CHANGELOG.md": "none\n",
            "docs/index.md": "all\n",
            "docs/air.md": "[home](../README.md)\n```text\n[no](link.md)\n```\n[data](evidence/a.json)\n",
            "docs/evidence/a.json": "{}\n",
            "docs/images/a.png": "picture\n",
            "src/a.py": "\n",
            **{f"clients/{name}/README.md": "[root](../../README.md)\n" for name in ("python", "cpp", "ros2")},
        }.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text, "utf-8")
        return tmp_path

    def test_links_lead_to_pages_or_to_the_tag(self, root: Path) -> None:
        out = root / "build" / "site-source"
        assert collect(root, out, "https://host/blob/v1") == 2
        assert (out / "index.md").read_text("utf-8") == (
            "[air](air.md#wind) [all](all_pages.md) [code](https://host/blob/v1/src/a.py#L3) [web](https://example.org)\n"
        )
        assert (out / "air.md").read_text("utf-8") == (
            "[home](index.md)\n```text\n[no](link.md)\n```\n[data](https://host/blob/v1/docs/evidence/a.json)\n"
        )
        assert (out / "reference" / "client_cpp.md").read_text("utf-8") == "[root](../index.md)\n"
        assert (out / "project" / "changelog.md").read_text("utf-8") == "---\nsearch:\n  exclude: true\n---\n\nnone\n"
        assert (out / "images" / "a.png").exists()
        assert not (out / "evidence").exists()

    def test_pages_that_are_gone_go(self, root: Path) -> None:
        out = root / "build" / "site-source"
        collect(root, out, "")
        (root / "docs" / "images" / "a.png").unlink()
        collect(root, out, "")
        assert not (out / "images" / "a.png").exists()

    def test_a_link_to_nothing_is_refused(self, root: Path) -> None:
        (root / "docs" / "air.md").write_text("[gone](gone.md)\n", "utf-8")
        with pytest.raises(BrokenLinkError, match=r"docs/air\.md: link to 'gone\.md', which does not exist"):
            collect(root, root / "out", "")
