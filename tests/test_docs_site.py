"""The documentation site: pages are collected and have a place, and the generated ones are those of the code."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
import yaml
from tools import offline_site, publish_docs, reference, release_notes, site
from tools.publish_docs import git
from tools.reference import environment_variables
from tools.site_source import BrokenLinkError, collect, pages

import qrsim
from qrsim.view.browser import Browser, find_browser

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


class TestPublishing:
    """A repository with one commit, and a site of two pages."""

    @pytest.fixture
    def root(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        # A git hook that runs the tests sets these.
        for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_PREFIX"):
            monkeypatch.delenv(name, raising=False)
        for kind in ("AUTHOR", "COMMITTER"):
            monkeypatch.setenv(f"GIT_{kind}_NAME", "a")
            monkeypatch.setenv(f"GIT_{kind}_EMAIL", "a@example.org")
        root = tmp_path / "repository"
        root.mkdir()
        git(root, "init", "--quiet", "--initial-branch=main")
        (root / ".gitignore").write_text("*.png\nsite/\n", "utf-8")
        git(root, "add", ".gitignore")
        git(root, "commit", "--quiet", "--message=first")
        return root

    def publish(self, root: Path, text: str, version: str, title: str, latest: bool) -> str:
        site_folder = root / "site"
        (site_folder / "start").mkdir(parents=True, exist_ok=True)
        (site_folder / "index.html").write_text(text, "utf-8")
        (site_folder / "start" / "a.png").write_bytes(b"ignored elsewhere")
        return publish_docs.publish(root, site_folder, version, title, latest)

    def test_versions_have_folders_and_latest_is_the_newest_release(self, root: Path) -> None:
        first = self.publish(root, "of main", "dev", "dev", latest=False)
        assert "url=dev/" in git(root, "show", "gh-pages:index.html")
        self.publish(root, "two", "0.2", "0.2.0", latest=True)
        self.publish(root, "ten", "0.10", "0.10.0", latest=True)
        last = self.publish(root, "ten again", "0.10", "0.10.1", latest=True)
        assert git(root, "ls-tree", "--name-only", "gh-pages").split() == [
            ".nojekyll", "0.10", "0.2", "dev", "index.html", "latest", "versions.json",
        ]  # fmt: skip
        assert [git(root, "show", f"gh-pages:{name}/index.html") for name in ("dev", "0.2", "0.10", "latest")] == [
            "of main", "two", "ten again", "ten again",
        ]  # fmt: skip
        assert git(root, "show", "gh-pages:latest/start/a.png") == "ignored elsewhere"
        assert json.loads(git(root, "show", "gh-pages:versions.json")) == [
            {"version": "dev", "title": "dev", "aliases": []},
            {"version": "0.10", "title": "0.10.1", "aliases": ["latest"]},
            {"version": "0.2", "title": "0.2.0", "aliases": []},
        ]
        assert "url=latest/" in git(root, "show", "gh-pages:index.html")
        assert git(root, "rev-list", "gh-pages").split()[::3] == [last, first]

    def test_the_work_tree_and_the_other_branches_stay(self, root: Path) -> None:
        before = git(root, "rev-parse", "main")
        self.publish(root, "two", "0.2", "0.2.0", latest=True)
        assert git(root, "status", "--porcelain") == ""
        assert git(root, "symbolic-ref", "--short", "HEAD") == "main"
        assert git(root, "rev-parse", "main") == before

    def test_other_words_publish_nothing(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert publish_docs.main(["releases"]) == 2
        assert capsys.readouterr().err == "usage: python -m tools.publish_docs dev | release\n"


class TestOffline:
    def test_the_configuration_has_the_plugin_and_no_versions(self) -> None:
        text = offline_site.configuration((ROOT / "mkdocs.yml").read_text("utf-8"))
        assert "\nplugins:\n  - offline\n  - search\n" in text
        assert "\nsite_dir: build/site-offline\n" in text
        assert "mike" not in text

    def test_pages_load_the_worker_of_the_site(self, tmp_path: Path) -> None:
        shim = '<script src="https://unpkg.com/iframe-worker/shim"></script>'
        (tmp_path / "start").mkdir()
        for name in ("index.html", "start/air.html", "404.html"):
            (tmp_path / name).write_text("none" if name == "404.html" else shim, "utf-8")
        assert offline_site.complete(tmp_path) == 2
        page = (tmp_path / "start" / "air.html").read_text("utf-8")
        assert page == '<script src="../assets/offline_worker.js"></script>'
        for name in ("one", "two"):
            (tmp_path / name).mkdir()
            offline_site.pack(tmp_path / "start", tmp_path / name / "docs.zip")
        assert zipfile.ZipFile(tmp_path / "one" / "docs.zip").namelist() == ["docs/air.html"]
        assert (tmp_path / "one" / "docs.zip").read_bytes() == (tmp_path / "two" / "docs.zip").read_bytes()

    @pytest.mark.long
    @pytest.mark.skipif(find_browser() is None, reason="needs chromium")
    def test_a_page_opened_as_a_file_has_a_worker(self, tmp_path: Path) -> None:
        (tmp_path / "w.js").write_text('onmessage = e => importScripts("d.js").then(() => postMessage(e.data + d))')
        (tmp_path / "d.js").write_text('var d = "!"')
        shutil.copy(offline_site.WORKER, tmp_path / "shim.js")
        page = tmp_path / "index.html"
        page.write_text(
            '<body><script src="shim.js"></script><script>const w = new Worker("w.js");'
            'w.addEventListener("message", e => document.title = e.data); w.postMessage("heard")</script></body>'
        )
        with Browser() as browser:
            browser.open(page.as_uri())
            end = time.monotonic() + 30.0
            while browser.evaluate("document.title") != "heard!":
                assert time.monotonic() < end
                time.sleep(0.05)


class TestReleaseNotes:
    CHANGES = "\n\n".join(
        (
            "# Changes",
            "## [Unreleased]",
            "## [0.20.0]",
            "ten",
            "## [0.2.0] - 2026-11-26",
            "You can fly.",
            "## [0.1.0]",
            "",
        )
    )

    def test_a_section_ends_where_the_next_begins(self) -> None:
        assert release_notes.notes(self.CHANGES, "0.2.0") == "You can fly."
        assert [release_notes.notes(self.CHANGES, version) for version in ("0.1.0", "2.0", "0.2")] == ["", "", ""]

    def test_a_tag_of_another_version_has_none(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert release_notes.main(["v99.0.0"]) == 1
        assert capsys.readouterr().err.startswith("v99.0.0: pyproject.toml states ")
        assert release_notes.main(["v1"]) == 2

    def test_the_changes_of_this_version_have_addresses(self, capsys: pytest.CaptureFixture[str]) -> None:
        version = re.findall(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text("utf-8"), re.MULTILINE)[0]
        assert release_notes.main([f"v{version}"]) == 0
        printed = capsys.readouterr().out
        assert len(printed.split()) > 10
        assert [link for link in re.findall(r"\]\((\S+)\)", printed) if not link.startswith("https://")] == []
