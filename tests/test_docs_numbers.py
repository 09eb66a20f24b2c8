"""Numbers in the documentation come from docs/evidence; so do tests of the programs that write and compare them."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from evidence import __main__ as runner
from evidence import docs

from qrsim.errors import RunError

ROOT = Path(__file__).resolve().parent.parent


def test_documented_numbers_are_the_measured_ones():
    problems = docs.differences(ROOT)
    assert not problems, "\n".join(problems)


def test_evidence_is_of_files_that_were_committed():
    files = sorted((ROOT / "docs" / "evidence").glob("*.json"))
    assert len(files) > 10
    assert [file.name for file in files if runner.DIRTY in file.read_text(encoding="utf-8")] == []


def test_most_pages_with_measurements_are_marked():
    marked = {page.name for page in docs.pages(ROOT) if list(docs.marked(page.read_text(encoding="utf-8")))}
    assert marked >= {
        "README.md", "baselines.md", "control_accuracy.md", "identification_evidence.md", "learn.md", "performance.md",
        "performance_links.md", "slam_results.md",
    }  # fmt: skip


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
            ("mse.phi", "6.563e-4"),
            ("mse.phi", "0.00066"),
            ("mse.phi", "(0.0006563)"),
            ("mse.down", "1.547"),
            ("mse.down", "1.55."),
            ("mse.down", "2"),
            ("rate", "99.9%"),
            ("rate", "99.94 %"),
            ("count", "5301"),
            ("count", "5.30e3"),
            ("zero", "0.00"),
            ("below", "-2.5"),
            ("duration_s", "12"),
            ("machine.cores", "2"),
        ],
    )
    def test_right_numbers(self, folder: Path, path: str, text: str):
        assert docs.faults(f"<!--ev flight: {path} -->\n{text}\n", "a.md", folder) == []

    @pytest.mark.parametrize(
        ("path", "text", "reason"),
        [
            ("mse.phi", "6.564e-4", "shows 6.564e-4, measured 0.00065634"),
            ("mse.phi", "6.563e-3", "shows"),
            ("mse.down", "1.546", "shows"),
            ("mse.down", "1.6", "shows"),
            ("mse.down", "1.54650", "shows"),
            ("count", "5300", "shows"),
            ("zero", "0.01", "shows"),
            ("below", "2.5", "shows"),
            ("rate", "0.999", "shows"),
            ("rate", "100", "shows"),
            ("mse.phi", "", "1 items for 0 numbers: none"),
            ("mse.phi", "nan", "1 items for 0 numbers"),
            ("mse.phi", "1 000", "1 items for 2 numbers: 1, 000"),
            ("mse.phi", "6.563e-4 in 3 runs", "1 items for 2 numbers: 6.563e-4, 3"),
            ("mse.phi -", "6.563e-4", "2 items for 1 numbers"),
            ("mse.theta", "1.0", "has no 'theta'"),
            ("mse.phi.deeper", "1.0", "has no 'deeper'"),
            ("mse", "1.0", "no number"),
            ("machine.cpu", "1.0", "no number"),
        ],
    )
    def test_wrong_numbers(self, folder: Path, path: str, text: str, reason: str):
        (problem,) = docs.faults(f"<!--ev flight: {path} -->\n{text}\n", "a.md", folder)
        assert problem.startswith("a.md:")
        assert reason in problem

    def test_a_study_that_is_not_there(self, folder: Path):
        assert docs.faults("<!--ev fight: mse.phi -->\n1\n", "a.md", folder) == [
            "a.md:2: fight.mse.phi: no fight.json in docs/evidence"
        ]

    def test_a_page_with_a_wrong_number_names_file_and_line(self, folder: Path):
        page = (
            "Text of 2014.\n\n<!--ev flight: - mse.phi\nmse: down -->\n"
            "[In 160 s](a_7.md) phi is 6.563e-4 rad\u00b2 and `x 9` down\n"
            "1.6 (m/s)^2 in 3D.\n\nNo number of the 3 here counts.\n"
        )
        assert docs.faults(page, "README.md", folder) == ["README.md:6: flight.mse.down: shows 1.6, measured 1.5465273"]

    def test_of_a_table_header_and_labels_do_not_count(self, folder: Path):
        page = "<!--ev flight:\nmse: phi down\ncount - -->\n| 9 | 8 | 7 |\n|---|---|---|\n"
        page += "| 40 s | 6.563e-4 | {} |\n| | 5301 | 4 |\n"
        assert docs.faults(page.format("1.547"), "a.md", folder) == []
        assert docs.faults(page.format("1.548"), "a.md", folder) == [
            "a.md:6: flight.mse.down: shows 1.548, measured 1.5465273"
        ]

    def test_a_bound(self, folder: Path):
        page = "<!--ev flight: <below <mse.down -->\nv < 2.6, < 1.6\n"
        assert docs.faults(page, "a.md", folder) == []
        assert docs.rewritten(page, folder) == page
        assert docs.faults(page.replace("2.6", "2.4"), "a.md", folder) == [
            "a.md:2: flight.below: shows < 2.4, measured -2.5"
        ]

    def test_a_line_with_braces_is_repeated(self):
        marker = " wind.hold:\n a {low high}: {}.mean\n  -\nb"
        assert docs.paths(marker) == ["wind.hold.a.low.mean", "-", "wind.hold.a.high.mean", "-", "wind.hold.b"]

    def test_numbers_are_written_as_they_were_shown(self, folder: Path):
        page = (
            "Of 3:\n\n<!--ev flight: mse.phi mse.down - count zero rate -->\n7e-3, 9.99, 160 s, 17, 0.00 and 98.0 %.\n"
        )
        expected = page.replace("7e-3, 9.99", "7e-4, 1.55").replace("17", "5301").replace("98.0", "99.9")
        assert docs.rewritten(page, folder) == expected
        assert docs.faults(expected, "a.md", folder) == []

    @pytest.mark.parametrize("page", ["<!--ev flight: count\n5301\n", "<!--ev-->\n5301\n", "<!-- /ev -->\n"])
    def test_a_broken_marker_is_a_fault(self, folder: Path, page: str):
        assert docs.faults(page, "README.md", folder)

    def test_pages_are_found(self, tmp_path: Path):
        for name in ("README.md", "CHANGELOG.md", "NOTES.md", "docs/a.md", "docs/how/b.md", "docs/c.txt"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text("", encoding="utf-8")
        found = [str(page.relative_to(tmp_path)) for page in docs.pages(tmp_path)]
        assert found == ["README.md", "CHANGELOG.md", "docs/a.md", "docs/how/b.md"]
        assert docs.pages(tmp_path / "nowhere") == []

    def test_the_command_tells_and_writes(self, folder: Path, tmp_path: Path, capsys):
        (tmp_path / "docs" / "evidence").mkdir(parents=True)
        (folder / "flight.json").rename(tmp_path / "docs" / "evidence" / "flight.json")
        page = tmp_path / "docs" / "a.md"
        page.write_text("<!--ev flight: count -->\n17\n", encoding="utf-8")
        assert docs.main([], tmp_path) == 1
        assert capsys.readouterr().out == "docs/a.md:2: flight.count: shows 17, measured 5301\n"
        assert docs.main(["--write"], tmp_path) == 0
        assert page.read_text(encoding="utf-8").endswith("\n5301\n")
        assert docs.main(["--wirte"], tmp_path) == 2


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
        assert {"imu", "recordings"} <= set(known)
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
        assert docs.faults("<!--ev made_up: a.b -->\n1.5\n", "a.md", path.parent) == []

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
        assert runner.main(["imu", "recordigns"], tmp_path) == 2
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
        (tmp_path / "docs" / "evidence" / "imu.json").write_text("{}", encoding="utf-8")
        assert runner.commit(tmp_path) == revision
        (tmp_path / "docs" / "images").mkdir()
        (tmp_path / "docs" / "images" / "a.png").write_bytes(b"")
        assert runner.commit(tmp_path) == revision, "studies draw, too"
        (tmp_path / "model.py").write_text("", encoding="utf-8")
        assert runner.commit(tmp_path) == f"{revision}+dirty"
