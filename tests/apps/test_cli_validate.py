"""``qrsim validate``: its parts in quick forms, the report, exit codes, and what goes wrong."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shutil
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim import cli
from qrsim.core.allan import exponential_allan_variance
from qrsim.errors import RunError
from qrsim.files.recordings import RECORDINGS
from qrsim.studies.validate import gnss, outdoor, parts, receiver, report, thrust, translation, turbulence
from qrsim.studies.validate.parts import PARTS
from qrsim.studies.validate.published import RangeErrors
from qrsim.studies.validate.report import Check, Finding, Outcome, Part, Picture, reference_check, share_verdict

PIXEL = bytes.fromhex("89504e470d0a1a0a")


def made_up(value: float = 1.0) -> Part:
    """A part that needs no recording, with one check of a value against 1 and a text that is not HTML."""

    def run(paths: Any, full: bool) -> Outcome:
        assert full
        check = Check("a <number>", value, 1.0, 0.1, "m", "because")
        finding = Finding("a fit", "1 %", "does not fit", "Not at all & never.")
        return Outcome("By hand.", "One & only.", [check], [finding], [Picture(PIXEL, 'a "dot"')], {"seen": [value]})

    return Part("made_up", "Made up", "no figure", (), run)


class Page(HTMLParser):
    """What a browser would fetch, and the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.words = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in {"script", "link", "iframe", "object"}
        self.fetched += [value or "" for name, value in attrs if name in {"src", "srcset", "href", "data", "poster"}]

    def handle_data(self, data: str) -> None:
        self.words += data


def finite_numbers(tree: Any) -> Iterator[float]:
    """Yield every number of a JSON tree; a null is a number that was lost."""
    if isinstance(tree, dict | list):
        for item in tree.values() if isinstance(tree, dict) else tree:
            yield from finite_numbers(item)
    elif not isinstance(tree, str | bool):
        assert tree is not None
        assert math.isfinite(tree)
        yield tree


@pytest.fixture(scope="session")
def quick(recordings: Path) -> Callable[[str], Outcome]:
    """Return a function that runs the quick form of a part."""

    def run(name: str) -> Outcome:
        part = PARTS[name]
        return part.run({file: recordings / file for file in part.recordings}, False)

    return run


# Parts that take a second; the others are flown in the long tier.
QUICK_PARTS = ("rotation", "translation", "thrust")


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name not in QUICK_PARTS)) for name in PARTS]
)
def test_a_part_passes_and_tells_its_numbers(quick: Callable[[str], Outcome], name: str):
    outcome = quick(name)
    assert [check.name for check in outcome.checks if not check.passed] == []
    assert outcome.checks
    assert len(list(finite_numbers(outcome.numbers))) > 5
    assert all(0.0 < check.tolerance < math.inf and check.reason for check in outcome.checks)
    assert outcome.pictures
    assert all(picture.png.startswith(PIXEL) and picture.caption for picture in outcome.pictures)
    if name == "translation":
        verdicts = {finding.name: finding.verdict for finding in outcome.findings}
        assert verdicts["horizontal velocity in still air, 160 s"] == "does not fit"
        assert verdicts["position, integrated twice over 160 s"] == "does not fit"
    if name == "gnss":
        assert "dates differ" in outcome.method
        assert "rows 1 to 350" in outcome.method


def test_scores_are_those_published(quick: Callable[[str], Outcome]):
    """Another constant, or another half second, and the score is another one."""
    checks = {check.name: check for name in ("thrust", "rotation") for check in quick(name).checks}
    assert checks["mean squared error of the thrust"].value == pytest.approx(0.9817, rel=5e-4)
    assert checks["mean squared error of the yaw"].value == pytest.approx(1.755e-2, rel=5e-4)


@pytest.mark.parametrize(
    ("value", "reference", "passed"),
    [
        (0.98171, "0.9817", True), (0.9824, "0.9817", False), (73.94, "73.9", True), (73.96, "73.9", False),
        (6.567e-4, "6.563e-4", True), (6.570e-4, "6.563e-4", False), (0.6288, "0.63", True), (0.6351, "0.63", False),
        (math.nan, "0.63", False), (math.inf, "0.63", False),
    ],
)  # fmt: skip
def test_agreement_to_three_digits(value: float, reference: str, passed: bool):
    check = reference_check("x", value, reference, "m")
    assert check.passed is passed
    assert check.to_json()["passed"] is passed
    json.dumps(check.to_json(), allow_nan=False)


def test_verdicts_of_shares():
    assert [share_verdict(share) for share in (0.95, 0.9, 0.7, 0.49, -0.5)] == [
        "fits",
        "fits",
        "fits in part",
        "does not fit",
        "does not fit",
    ]


@pytest.mark.long
def test_the_fitted_wind_is_found_again(recordings: Path):
    """The model flown in a known wind is fitted by that wind, because the model is linear in it."""
    flight = outdoor.fly_recorded(recordings / outdoor.RECORDING)
    short = flight._replace(commands=flight.commands[:1500], recorded=flight.recorded[:1500])
    blown, _ = outdoor.fly_in_wind(flight.start[None], short.commands[:, :, None], np.array([[3.0, -2.0, 0.0]]))
    recorded = short.recorded.copy()
    recorded[:, 6:9] = blown[:, 0]
    found = translation.fly_winds(short._replace(recorded=recorded))
    np.testing.assert_allclose(found.wind, [3.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(found.velocity["fitted wind"], blown[:, 0], atol=1e-8)
    still = outdoor.velocity_match(flight).simulated[:1500]
    np.testing.assert_allclose(found.velocity["still air"], still, atol=1e-9)


def test_sampled_allan_variance_is_the_continuous_one_for_many_samples():
    """And for windows of one sample it is half the variance of the difference, sigma^2 (1 - rho)."""
    errors, period = RangeErrors(2.0, 30.0, 0.0), 0.05
    autocovariance = receiver.range_autocovariance(errors, period, 800)
    autocovariance[0] -= 0.002**2
    found = receiver.sampled_allan_variance(autocovariance, 400)
    assert found == pytest.approx(4.0 * float(exponential_allan_variance(20.0, 30.0)), rel=1e-4)
    assert receiver.sampled_allan_variance(autocovariance, 1) == pytest.approx(4.0 * -math.expm1(-period / 30.0))


def test_windows_are_told_as_spans():
    windows = [0.4, 0.8, 1.2, 1.6, 2.4]
    assert gnss._window_spans(windows, [0.4, 0.8, 1.6]) == "0.4-0.8 s, 1.6 s"
    assert gnss._window_spans(windows, windows) == "0.4-2.4 s"


@pytest.mark.long
def test_without_jsbsim_it_is_said(quick: Callable[[str], Outcome], monkeypatch):
    monkeypatch.setattr(turbulence, "is_installed", lambda: False)
    outcome = quick("turbulence")
    assert outcome.passed
    assert "JSBSim is not installed" in outcome.skipped[0]
    assert "pip install jsbsim" in outcome.skipped[0]
    assert not any("jsbsim" in name for name in outcome.numbers["spectra"])


class TestCommand:
    @pytest.fixture
    def data(self, recordings: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        monkeypatch.setattr(parts, "PARTS", {"thrust": thrust.PART, "made_up": made_up()})
        assert os.environ["QRSIM_DATA_DIR"] == str(recordings)
        return recordings

    def test_report(self, data: Path, tmp_path: Path, capsys):
        folder = tmp_path / "new" / "report"
        assert cli.main(["validate", "--out", str(folder), "--json"]) == 0
        printed = capsys.readouterr()
        written = json.loads((folder / "validation.json").read_text(encoding="utf-8"))
        assert json.loads(printed.out) == written
        assert printed.err == ""
        files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
        assert files == ["figures/thrust_1.pdf", "validation.html", "validation.json", "validation.pdf"]
        assert written["passed"] is True
        assert list(written["parts"]) == ["thrust", "made_up"]
        assert written["recordings"] == {"thrust_rig.csv": RECORDINGS["thrust_rig.csv"].sha256}
        assert written["parts"]["thrust"]["numbers"]["mean_squared_error"] == pytest.approx(0.98171, abs=1e-5)
        assert written["parts"]["made_up"]["numbers"] == {"seen": [1.0]}

        text = (folder / "validation.html").read_text(encoding="utf-8")
        page = Page(text)
        assert not re.search(r"https?:|url\(|@import", text)
        assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.fetched)
        assert sum(link.startswith("data:") for link in page.fetched) == 2
        for words in ("All 3 checks passed", "One & only.", "a <number>", "0.9817", "does not fit", "IROS 2014"):
            assert words in page.words

    def test_summary_in_words(self, data: Path, tmp_path: Path, capsys):
        assert cli.main(["validate", "--out", str(tmp_path), "--only", "made_up", "--only", "made_up"]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[:3] == [
            "pass     Made up: 1 of 1 checks",
            "         One & only.",
            "         does not fit: a fit: 1 %",
        ]
        assert lines[-3:] == [
            f"report:  {tmp_path / 'validation.html'}, {tmp_path / 'validation.pdf'}",
            f"figures: {tmp_path / 'figures'}/",
            f"numbers: {tmp_path / 'validation.json'}",
        ]

    @pytest.mark.parametrize("value", [1.2, math.nan])
    def test_a_failed_bound(self, tmp_path: Path, monkeypatch, capsys, value: float):
        part = made_up(value)

        def run(paths: Any, full: bool) -> Outcome:
            outcome = part.run(paths, full)
            return Outcome(outcome.method, outcome.reading, outcome.checks, [], [], {})

        monkeypatch.setattr(parts, "PARTS", {"made_up": Part("made_up", "Made up", "no figure", (), run)})
        assert cli.main(["validate", "--out", str(tmp_path)]) == 1
        printed = capsys.readouterr()
        assert "FAIL     Made up: 0 of 1 checks" in printed.out
        assert "FAIL a <number>: " in printed.out
        assert "expected 1 ± 0.1" in printed.out
        assert printed.err == ""
        written = json.loads((tmp_path / "validation.json").read_text(encoding="utf-8"))
        assert written["passed"] is False
        assert "1 of 1 checks failed" in (tmp_path / "validation.html").read_text(encoding="utf-8")

    def test_without_recordings_the_rest_is_run(self, data: Path, tmp_path: Path, monkeypatch, capsys):
        monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path / "nowhere"))
        assert cli.main(["validate", "--out", str(tmp_path / "report")]) == 0
        printed = capsys.readouterr().out
        assert f"skipped  Thrust: thrust_rig.csv not found in {tmp_path / 'nowhere'}; 'qrsim data fetch'" in printed
        assert "pass     Made up" in printed
        text = Page((tmp_path / "report" / "validation.html").read_text(encoding="utf-8")).words
        assert "'qrsim data fetch' gets the recordings" in text
        written = json.loads((tmp_path / "report" / "validation.json").read_text(encoding="utf-8"))
        assert written["parts"]["thrust"]["passed"] is None
        assert written["recordings"] == {}

    def test_nothing_to_do(self, data: Path, tmp_path: Path, monkeypatch, refused):
        monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path / "nowhere"))
        words = ["validate", "--only", "thrust", "--out", str(tmp_path / "report")]
        refused(words, "nothing to do: thrust: thrust_rig.csv not found", "qrsim data fetch", code=1)

    @pytest.mark.parametrize("change", [lambda text: text[: len(text) // 2], lambda text: text.replace(b"7", b"8", 1)])
    def test_an_altered_or_truncated_recording(
        self, data: Path, tmp_path: Path, monkeypatch, refused, change: Callable[[bytes], bytes]
    ):
        content = change((data / "thrust_rig.csv").read_bytes())
        (tmp_path / "thrust_rig.csv").write_bytes(content)
        monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path))
        hashes = (RECORDINGS["thrust_rig.csv"].sha256, hashlib.sha256(content).hexdigest())
        words = ["validate", "--out", str(tmp_path / "report")]
        refused(words, str(tmp_path / "thrust_rig.csv"), *hashes, "altered", "qrsim data fetch", code=1)
        assert not (tmp_path / "report").exists()

    def test_an_altered_recording_that_is_not_used(self, data: Path, tmp_path: Path, monkeypatch):
        (tmp_path / "thrust_rig.csv").write_bytes(b"?")
        monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path))
        assert cli.main(["validate", "--only", "made_up", "--out", str(tmp_path / "report")]) == 0

    def test_an_output_folder_that_cannot_be(self, data: Path, tmp_path: Path, refused):
        (tmp_path / "file").write_text("")
        for folder in (tmp_path / "file", tmp_path / "file" / "sub"):
            refused(["validate", "--out", str(folder)], f"--out {folder}: cannot write there", code=1)

    def test_an_output_folder_without_permission(self, data: Path, tmp_path: Path, refused):
        tmp_path.chmod(0o500)
        # Root may write anywhere but into the kernel's own folders.
        folder = tmp_path if os.geteuid() else Path("/proc/self")
        refused(["validate", "--out", str(folder)], f"--out {folder}: cannot write there", code=1)
        tmp_path.chmod(0o700)

    def test_a_report_that_cannot_be_replaced(self, data: Path, tmp_path: Path, capsys):
        (tmp_path / "validation.html").mkdir()
        assert cli.main(["validate", "--only", "made_up", "--out", str(tmp_path)]) == 1
        assert f"cannot write {tmp_path / 'validation.html'}" in capsys.readouterr().err
        assert [path.name for path in tmp_path.iterdir()] == ["validation.html"]

    def test_a_misspelt_part(self, tmp_path: Path, refused):
        refused(
            ["validate", "--only", "trust", "--out", str(tmp_path / "report")],
            "--only trust: no such part; did you mean 'thrust'?",
        )
        assert not (tmp_path / "report").exists()

    def test_chosen_parts_keep_the_report_s_order(self):
        assert [part.name for part in parts.choose(["gnss", "thrust", "gnss"])] == ["thrust", "gnss"]
        assert [part.name for part in parts.choose([])] == list(PARTS)


def test_every_recording_of_a_part_is_in_the_registry():
    assert {name for part in PARTS.values() for name in part.recordings} == set(RECORDINGS)


def test_a_table_that_is_none_is_named(tmp_path: Path, recordings: Path):
    """The registry is checked first; the readers say what is wrong by themselves all the same."""
    shutil.copy(recordings / "thrust_rig.csv", tmp_path / "outdoor_flight.csv")
    with pytest.raises(RunError, match=r"outdoor_flight\.csv: 4 columns, expected 22"):
        outdoor.fly_recorded(tmp_path / "outdoor_flight.csv")


def test_the_check_nearest_to_its_bound():
    near, far = (Check(name, value, 1.0, 0.5, "", "") for name, value in (("near", 0.55), ("far", 1.1)))
    assert report.worst([far, near]) is near
