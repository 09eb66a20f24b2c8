"""Every example in README.md and docs/ runs: Python blocks as they are, qrsim commands in a temporary folder."""

from __future__ import annotations

import contextlib
import re
import shlex
import sys
import types
from pathlib import Path
from typing import Any

import pytest

import qrsim
from qrsim import cli
from qrsim.engine.programs import forget
from qrsim.scenarios.reading import built_in_names
from qrsim.studies.sweep.sweeping import sweep_here

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[tuple[str, str]]:
    """Return (page and number, text) of every fenced block of a language."""
    found = []
    for page in PAGES:
        matches = [text for kind, text in FENCE.findall(page.read_text("utf-8")) if kind == language]
        name = page.relative_to(ROOT).as_posix()
        found += [(f"{name}-{number}", text) for number, text in enumerate(matches, start=1)]
    return found


# What these do is tested elsewhere in less time.
DEAR = ("docs/gallery/learn_to_hover.md-1", "docs/gallery/winds.md-1")
# Pages whose Python blocks belong together, in their order.
TOGETHER = ("docs/start/field_day.md",)
# Numbers of flights in examples, and fewer that the long tier flies; the nightly one flies them as they are.
FEWER = {"docs/start/field_day.md": (("SEEDS = 30", "SEEDS = 2"), ('"--seeds", "10"', '"--seeds", "2"'))}


def examples(language: str) -> list[Any]:
    """Return a case for every example; those beyond the README take long, some very long."""
    cases, each = [], blocks(language)
    for page in TOGETHER if language == "python" else ():
        whole = "\n".join(text for name, text in each if name.startswith(f"{page}-"))
        each = [(name, text) for name, text in each if not name.startswith(f"{page}-")] + [(page, whole)]
    for name, text in each:
        marks = () if name.startswith("README") else (pytest.mark.nightly if name in DEAR else pytest.mark.long,)
        if name in FEWER:
            cases.append(pytest.param(name, text, id=f"{name}-whole", marks=pytest.mark.nightly))
        for given, fewer in FEWER.get(name, ()):
            assert text.count(given) == 1, f"{name} has no {given!r}"
            text = text.replace(given, fewer)
        cases.append(pytest.param(name, text, id=name, marks=marks))
    return cases


@pytest.fixture(autouse=True)
def _sweeps_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fly sweeps in this process; tests/studies/sweep/test_workers.py starts separate processes."""
    monkeypatch.setattr("qrsim.studies.sweep.cluster.workers_of", lambda *asked: contextlib.nullcontext())
    monkeypatch.setattr(
        "qrsim.studies.sweep.sweeping.sweep", lambda plan, store, client, progress: sweep_here(plan, store, progress)
    )


def test_the_pages_have_examples() -> None:
    assert blocks("python")
    assert blocks("bash")


@pytest.mark.long
@pytest.mark.parametrize(("name", "text"), examples("python"))
def test_python_example(
    name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    # As somebody's file would be: a module that its classes are found in, and nothing inherited from this one.
    module = types.ModuleType("example")
    monkeypatch.setitem(sys.modules, "example", module)
    exec(compile(text, name, "exec", dont_inherit=True), module.__dict__)
    if name.startswith("README"):
        shown = (ROOT / "README.md").read_text("utf-8").partition("```text\n")[2].partition("```")[0]
        assert capsys.readouterr().out == shown


@pytest.mark.long
@pytest.mark.parametrize(("name", "text"), examples("bash"))
def test_commands(name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "qrsim cache" in text:
        # The cache that all tests share would take minutes to pack.
        monkeypatch.setenv("QRSIM_CACHE_DIR", str(tmp_path / "cache"))
        forget()
    for line in text.splitlines():
        words = shlex.split(line, comments=True)
        if not words or words[0] == "make":
            continue
        assert words[0] == "qrsim", line
        assert cli.main(words[1:]) == 0, line


@pytest.mark.long
def test_the_first_flight_prints_its_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "start" / "first_flight.md").read_text("utf-8")
    shown = [line for line in page.splitlines() if line.startswith(("pelicans_", "separation:"))]
    assert len(shown) == 3
    assert cli.main(["run", "outdoor_patrol", "--seed", "1", "--out", "runs/first", "--no-figure"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert [line for line in shown if line not in {each.rstrip() for each in printed}] == []


# The mouse runs out of its area where no cats are flown.
WITHOUT_A_TASK = [name for name in built_in_names() if not name.startswith("cats_and_mouse")]
# Of a family of tasks, all but one.
VARIANTS = [name for name in WITHOUT_A_TASK if "/" in name and name[-2:] not in ("2B", "3F")]


# What pages add to this scenario is flown together by day, in as few flights as contradict each other.
EXTENDED = "extends: patrol_plain\n"
ADDED = {
    "sensors": ("choose_a_receiver", "choose_sensors", "sensors_heading_and_height", "sensors_inertial",
                "sensors_looking_around", "radio", "vehicle", "turbulence_field"),
    "receivers": ("corrections", "jam_and_spoof"),
}  # fmt: skip


def added(pages: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return (name, text) of the first scenario of each of these pages."""
    found = {Path(name.removesuffix("-1")).stem: (name, text) for name, text in blocks("yaml") if name.endswith("-1")}
    return [found[page] for page in pages]


def page_by_page() -> list[Any]:
    """Return a case for every scenario; of each page the first is flown in the long tier, the others at night."""
    together = {name for pages in ADDED.values() for name, _ in added(pages)}
    later: dict[bool, Any] = {True: (), False: pytest.mark.nightly}
    return [
        pytest.param(name, text, id=name, marks=later[name.endswith("-1") and name not in together])
        for name, text in blocks("yaml")
    ]


@pytest.mark.parametrize(("name", "text"), [case for case in blocks("yaml") if not case[0].endswith("-1")])
def test_scenario_can_be_flown(name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that the nightly tier flies are read, checked and built."""
    monkeypatch.chdir(tmp_path)
    Path("example.yaml").write_text(text, "utf-8")
    assert qrsim.load_scenario("example.yaml").world().fleets


def stopped(source: str, seeds: int) -> set[str]:
    """Return why vehicles stop in any of some flights of a scenario; empty where all fly to the end."""
    scenario = qrsim.load_scenario(source)
    ticks = round(min(scenario.duration, 120.0) / scenario.spec.time_step)
    flown = qrsim.rollout(scenario.world(), ticks=ticks, worlds=seeds)
    return {why for world in range(seeds) for why in flown.reasons(world) if why}


@pytest.mark.parametrize("seeds", [4, pytest.param(20, marks=pytest.mark.nightly)])
@pytest.mark.long
@pytest.mark.parametrize(("name", "text"), page_by_page())
def test_scenario_flies(name: str, text: str, seeds: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody stops with any of these seeds."""
    monkeypatch.chdir(tmp_path)
    Path("example.yaml").write_text(text, "utf-8")
    assert stopped("example.yaml", seeds) == set()


@pytest.mark.long
@pytest.mark.parametrize("pages", ADDED.values(), ids=ADDED)
def test_what_pages_add_to_a_scenario_flies(
    pages: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is built, and nobody stops where all is added; at night each flies alone."""
    monkeypatch.chdir(tmp_path)
    before = EXTENDED
    for number, (name, text) in enumerate(added(pages)):
        assert text.count(EXTENDED) == 1, name
        Path("alone.yaml").write_text(text, "utf-8")
        assert qrsim.load_scenario("alone.yaml").world().fleets
        Path(f"{number}.yaml").write_text(text.replace(EXTENDED, before), "utf-8")
        before = f"extends: ./{number}.yaml\n"
    assert stopped(f"{len(pages) - 1}.yaml", 4) == set()


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.nightly if name in VARIANTS else ()) for name in WITHOUT_A_TASK]
)
def test_nobody_stops_in_a_built_in_scenario(name: str) -> None:
    assert stopped(name, 20) == set()
