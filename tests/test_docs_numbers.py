"""Numbers in the documentation come from docs/evidence; so do tests of the program that writes them.

A marked number looks like ``<!--ev STUDY.path.to.number-->TEXT<!--/ev-->``. TEXT must be the number at that path of
docs/evidence/STUDY.json (in its results, or at its top level), rounded to as many significant digits as TEXT shows.
A trailing % is a unit like any other: the file then holds per cent. Other units stand outside the marker.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from evidence import __main__ as runner

from qrsim.errors import RunError

ROOT = Path(__file__).resolve().parent.parent
MARKER = re.compile(r"<!--\s*ev\s+(\S+?)\s*-->(.*?)<!--\s*/ev\s*-->", re.DOTALL)
TAG = re.compile(r"<!--\s*/?ev\b")
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)


def pages(root: Path) -> list[Path]:
    """Markdown files whose numbers are checked."""
    top = [root / "README.md", root / "CHANGELOG.md"]
    return [page for page in top if page.is_file()] + sorted((root / "docs").rglob("*.md"))


def look_up(path: str, evidence: Path) -> float:
    """Return the number at STUDY.path.to.number; LookupError says what is missing."""
    study, *keys = path.split(".")
    file = evidence / f"{study}.json"
    if not file.is_file():
        raise LookupError(f"no {file.name} in docs/evidence")
    report = json.loads(file.read_text(encoding="utf-8"))
    node: Any = {**report, **report["results"]}
    for key in keys:
        if not isinstance(node, dict) or key not in node:
            raise LookupError(f"{file.name} has no '{key}' there")
        node = node[key]
    if isinstance(node, bool) or not isinstance(node, int | float):
        raise LookupError(f"{file.name} has no number there")
    return node


def fault(path: str, text: str, evidence: Path) -> str | None:
    """Return what is wrong with one marked number, None where nothing is."""
    shown = text.strip().removesuffix("%").strip()
    match = NUMBER.fullmatch(shown)
    if match is None:
        return f"'{text}' is not a number"
    try:
        value = look_up(path, evidence)
    except LookupError as error:
        return str(error.args[0])
    digits = max(1, len(match[1].replace(".", "").lstrip("0")))
    rounded = float(f"{value:.{digits - 1}e}")
    return None if rounded == float(shown) else f"shows {shown}, measured {value!r}"


def faults(text: str, source: str, evidence: Path) -> list[str]:
    """Return every fault of a page's marked numbers, with file and line."""
    found = []
    markers = list(MARKER.finditer(text))
    for marker in markers:
        problem = fault(marker[1], marker[2], evidence)
        if problem is not None:
            found.append(f"{source}:{text.count(chr(10), 0, marker.start()) + 1}: {marker[1]}: {problem}")
    tags = len(TAG.findall(text))
    if tags != 2 * len(markers):
        found.append(f"{source}: {tags} marker tags for {len(markers)} marked numbers: one is not opened or not closed")
    return found


def test_documented_numbers_are_the_measured_ones():
    problems = []
    for page in pages(ROOT):
        source = str(page.relative_to(ROOT))
        problems += faults(page.read_text(encoding="utf-8"), source, ROOT / "docs" / "evidence")
    assert not problems, "\n".join(problems)


class TestChecker:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        results = {
            "mse": {"phi": 6.5634e-4, "down": 1.5465273},
            "rate": 99.94,
            "count": 5301,
            "zero": 0.0,
            "below": -2.5,
        }
        report = {"study": "flight", "duration_s": 12.3, "machine": {"cores": 2, "cpu": "x"}, "results": results}
        (tmp_path / "flight.json").write_text(json.dumps(report), encoding="utf-8")
        return tmp_path

    @pytest.mark.parametrize(
        ("path", "text"),
        [
            ("flight.mse.phi", "6.563e-4"),
            ("flight.mse.phi", "0.00066"),
            ("flight.mse.phi", " 0.0006563 "),
            ("flight.mse.down", "1.547"),
            ("flight.mse.down", "1.55"),
            ("flight.mse.down", "2"),
            ("flight.rate", "99.9%"),
            ("flight.rate", "99.94 %"),
            ("flight.count", "5301"),
            ("flight.count", "5.30e3"),
            ("flight.zero", "0.00"),
            ("flight.below", "-2.5"),
            ("flight.duration_s", "12"),
            ("flight.machine.cores", "2"),
        ],
    )
    def test_right_numbers(self, folder: Path, path: str, text: str):
        assert fault(path, text, folder) is None

    @pytest.mark.parametrize(
        ("path", "text", "reason"),
        [
            ("flight.mse.phi", "6.564e-4", "shows 6.564e-4, measured 0.00065634"),
            ("flight.mse.phi", "6.563e-3", "shows"),
            ("flight.mse.down", "1.546", "shows"),
            ("flight.mse.down", "1.6", "shows"),
            ("flight.mse.down", "1.54650", "shows"),
            ("flight.count", "5300", "shows"),
            ("flight.zero", "0.01", "shows"),
            ("flight.below", "2.5", "shows"),
            ("flight.rate", "0.999", "shows"),
            ("flight.rate", "100", "shows"),
            ("flight.mse.phi", "about 6.6e-4", "not a number"),
            ("flight.mse.phi", "", "not a number"),
            ("flight.mse.phi", "nan", "not a number"),
            ("flight.mse.phi", "1,000", "not a number"),
            ("flight.mse.theta", "1.0", "has no 'theta'"),
            ("flight.mse.phi.deeper", "1.0", "has no 'deeper'"),
            ("flight.mse", "1.0", "no number"),
            ("flight.machine.cpu", "1.0", "no number"),
            ("flight", "1.0", "no number"),
            ("fight.mse.phi", "6.563e-4", "no fight.json"),
        ],
    )
    def test_wrong_numbers(self, folder: Path, path: str, text: str, reason: str):
        problem = fault(path, text, folder)
        assert problem is not None
        assert reason in problem

    def test_a_page_with_a_wrong_number_names_file_and_line(self, folder: Path):
        page = (
            "A phi of <!--ev flight.mse.phi-->6.563e-4<!--/ev--> rad^2\n\n"
            "and <!-- ev flight.mse.down -->1.6<!-- /ev --> (m/s)^2 over <!--ev flight.count-->5301<!--/ev--> rows.\n"
        )
        assert faults(page, "README.md", folder) == [
            "README.md:3: flight.mse.down: shows 1.6, measured 1.5465273",
        ]

    @pytest.mark.parametrize(
        "page",
        [
            "<!--ev flight.count-->5301",
            "5301<!--/ev-->",
            "<!--ev flight.count-->5301 <!--ev flight.rate-->99.94<!--/ev-->",
            "<!--ev flight.count-->5301<!--/ev--> and <!--ev-->1<!--/ev-->",
        ],
    )
    def test_a_broken_marker_is_a_fault(self, folder: Path, page: str):
        assert faults(page, "README.md", folder)

    def test_pages_are_found(self, tmp_path: Path):
        for name in ("README.md", "CHANGELOG.md", "NOTES.md", "docs/a.md", "docs/how/b.md", "docs/c.txt"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text("", encoding="utf-8")
        found = [str(page.relative_to(tmp_path)) for page in pages(tmp_path)]
        assert found == ["README.md", "CHANGELOG.md", "docs/a.md", "docs/how/b.md"]
        assert pages(tmp_path / "nowhere") == []


def study(results: Any) -> ModuleType:
    """A study that returns the given results."""
    module = ModuleType("made_up")
    module.DOC, module.SEED = "made up", 7  # type: ignore[attr-defined]

    def run(full: bool) -> Any:
        assert full
        if isinstance(results, Exception):
            raise results
        return results

    module.run = run  # type: ignore[attr-defined]
    return module


class TestRunner:
    @pytest.fixture(autouse=True)
    def _clean(self, request, monkeypatch) -> None:
        if request.node.originalname != "test_commit":
            monkeypatch.setattr(runner, "commit", lambda root: "abc1234")

    def test_studies_are_found(self):
        known = runner.studies()
        assert {"noise", "recordings"} <= set(known)
        assert all(callable(module.run) and module.DOC.strip() for module in known.values())

    def test_a_report_has_its_keys(self, tmp_path: Path):
        path = runner.write("made_up", study({"a": {"b": 1.5, "c": 2}}), "abc1234", tmp_path / "docs" / "evidence")
        report = json.loads(path.read_text(encoding="utf-8"))
        assert path.name == "made_up.json"
        assert list(report) == ["study", "commit", "date", "seed", "machine", "duration_s", "results"]
        assert (report["study"], report["commit"], report["seed"]) == ("made_up", "abc1234", 7)
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", report["date"])
        assert set(report["machine"]) == {"cpu", "cores", "os", "python", "jax"}
        assert report["results"] == {"a": {"b": 1.5, "c": 2}}
        assert fault("made_up.a.b", "1.5", path.parent) is None

    def test_all_studies_run_where_none_is_named(self, tmp_path: Path, monkeypatch, capsys):
        monkeypatch.setattr(runner, "studies", lambda: {"one": study({"a": 1}), "two": study({"a": 2})})
        assert runner.main([], tmp_path) == 0
        assert sorted(p.name for p in tmp_path.iterdir()) == ["one.json", "two.json"]
        assert "two: wrote" in capsys.readouterr().out

    def test_a_tree_that_differs_from_its_commit_is_refused(self, tmp_path: Path, monkeypatch, capsys):
        monkeypatch.setattr(runner, "studies", lambda: {"one": study({"a": 1})})
        monkeypatch.setattr(runner, "commit", lambda root: "abc1234+dirty")
        assert runner.main(["one"], tmp_path) == 2
        assert "error: files differ from commit abc1234," in capsys.readouterr().err
        assert list(tmp_path.iterdir()) == []
        assert runner.main(["one", "--dirty"], tmp_path) == 0
        assert json.loads((tmp_path / "one.json").read_text(encoding="utf-8"))["commit"] == "abc1234+dirty"

    def test_a_part_takes_the_place_of_what_the_file_says_of_it(self, tmp_path: Path, monkeypatch, capsys):
        module = study(None)
        module.PARTS = ("left", "right")  # type: ignore[attr-defined]
        module.run = lambda full, parts=module.PARTS: {part: {"a": version} for part in parts}  # type: ignore[attr-defined]
        monkeypatch.setattr(runner, "studies", lambda: {"two": module, "one": study({"a": 1})})
        version = 1
        assert runner.main(["two:left"], tmp_path) == 2
        assert "there is no two.json yet to put it into; run all of 'two' first" in capsys.readouterr().err
        assert runner.main(["two"], tmp_path) == 0
        version = 2
        monkeypatch.setattr(runner, "commit", lambda root: "def5678")
        assert runner.main(["two:left"], tmp_path) == 0
        report = json.loads((tmp_path / "two.json").read_text(encoding="utf-8"))
        assert report["results"] == {"left": {"a": 2}, "right": {"a": 1}}
        assert (report["commit"], report["parts"]["left"]["commit"]) == ("abc1234", "def5678")
        assert runner.main(["two:right"], tmp_path) == 0
        report = json.loads((tmp_path / "two.json").read_text(encoding="utf-8"))
        assert (report["commit"], set(report["parts"])) == ("def5678", {"left", "right"})
        capsys.readouterr()
        for name, said in (("two:rigth", "did you mean 'right'?; it has left, right"), ("one:a", "it has none")):
            assert runner.main([name], tmp_path) == 2
            assert said in capsys.readouterr().err

    def test_a_failed_study_stops_no_other(self, tmp_path: Path, monkeypatch, capsys):
        monkeypatch.setattr(runner, "studies", lambda: {"bad": study(RunError("no disk")), "good": study({"a": 1})})
        assert runner.main([], tmp_path) == 1
        assert capsys.readouterr().err == "error: no disk\n"
        assert [path.name for path in tmp_path.iterdir()] == ["good.json"]

    def test_an_unknown_name_runs_nothing(self, tmp_path: Path, capsys):
        assert runner.main(["noise", "recordigns"], tmp_path) == 2
        assert capsys.readouterr().err == "error: no study named 'recordigns'; did you mean 'recordings'?\n"
        assert list(tmp_path.iterdir()) == []

    def test_missing_recordings(self, tmp_path: Path, monkeypatch, capsys):
        monkeypatch.delenv("QRSIM_DATA_DIR", raising=False)
        assert runner.main(["recordings"], tmp_path) == 1
        error = capsys.readouterr().err
        assert error.startswith("error: no recordings: QRSIM_DATA_DIR is not set")
        assert "qrsim data fetch" in error
        monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path))
        assert runner.main(["recordings"], tmp_path) == 1
        error = capsys.readouterr().err
        assert str(tmp_path / "rotation_rig.csv") in error
        assert "qrsim data fetch" in error
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("content", ["1,2,3\n", "a,b\n", "1,2\n1,2,3\n", ""])
    def test_a_wrong_recording_is_named(self, tmp_path: Path, monkeypatch, capsys, content: str):
        (tmp_path / "rotation_rig.csv").write_text(content, encoding="utf-8")
        monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path))
        assert runner.main(["recordings"], tmp_path) == 1
        assert "rotation_rig.csv" in capsys.readouterr().err

    def test_a_failed_study_leaves_no_file(self, tmp_path: Path, monkeypatch, capsys):
        monkeypatch.setattr(runner, "studies", lambda: {"bad": study(RunError("no disk"))})
        assert runner.main(["bad"], tmp_path) == 1
        assert capsys.readouterr().err == "error: no disk\n"
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        "results",
        [{"a": float("nan")}, {"a": [1.0]}, {"a": "1"}, {"a": None}, {"a": True}, {"a.b": 1}, {"a b": 1}, {1: 1}],
    )
    def test_only_plain_numbers_are_written(self, tmp_path: Path, results: Any):
        with pytest.raises(TypeError):
            runner.write("made_up", study(results), "unknown", tmp_path)
        assert list(tmp_path.iterdir()) == []

    def test_commit(self, tmp_path: Path, monkeypatch):
        # A git hook that runs the tests sets these.
        for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_PREFIX"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
        assert runner.commit(tmp_path) == "unknown"

        def git(*arguments: str) -> str:
            identity = ("-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "core.hooksPath=/dev/null")
            command = ["git", "-C", str(tmp_path), *identity, "-c", "commit.gpgsign=false", *arguments]
            return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

        git("init")
        assert runner.commit(tmp_path) == "unknown"
        git("commit", "--allow-empty", "-m", "first")
        revision = git("rev-parse", "--short", "HEAD")
        assert runner.commit(tmp_path) == revision
        (tmp_path / "docs" / "evidence").mkdir(parents=True)
        (tmp_path / "docs" / "evidence" / "noise.json").write_text("{}", encoding="utf-8")
        assert runner.commit(tmp_path) == revision
        (tmp_path / "docs" / "images").mkdir()
        (tmp_path / "docs" / "images" / "a.png").write_bytes(b"")
        assert runner.commit(tmp_path) == revision, "studies draw, too"
        (tmp_path / "model.py").write_text("", encoding="utf-8")
        assert runner.commit(tmp_path) == f"{revision}+dirty"
