"""A run as a page without a server: what is packed into it, and what is refused."""

from __future__ import annotations

import base64
import errno
import html
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.apps.conftest import DURATION, SEED, Flight

import qrsim
from qrsim import cli
from qrsim.errors import RunError, UsageError
from qrsim.runs import open_run
from qrsim.view import film, plots
from qrsim.view.recording import Recording

BODIES = "/world/vehicles/bodies"
# Of a film of 10 s at 20 Hz.
FRAMES = 201


def unpacked(text: str) -> Any:
    """Return what a browser makes of a packed text."""
    data = zlib.decompress(base64.b64decode(text))
    size = int.from_bytes(data[:8], "little")
    head = json.loads(data[8 : 8 + size])
    places, at = [], 8 + size + -size % 8
    for length in head["lengths"]:
        places.append(data[at : at + length])
        at += length + -length % 8
    assert at == len(data)

    def revived(value: Any) -> Any:
        if isinstance(value, dict) and "__binary_index" in value:
            return np.frombuffer(places[value["__binary_index"]], value["dtype"])
        if isinstance(value, dict):
            return {key: revived(item) for key, item in value.items()}
        return [revived(item) for item in value] if isinstance(value, list) else value

    return revived(head["content"])


def elements(page: str) -> dict[str, str]:
    """Return the elements of a page with data of ours, by name."""
    return dict(re.findall(r'<script type="text/plain" id="qrsim-([a-z0-9-]+)">(.*?)</script>', page, re.DOTALL))


@pytest.fixture(scope="module")
def recording(flown: Flight) -> Recording:
    return Recording(open_run(flown.folder))


@pytest.fixture(scope="module")
def page(flown: Flight) -> str:
    """The page as a notebook gets it, in parts of 80 frames."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(film, "FRAMES_OF_A_PART", 80)
        shown = qrsim.show(flown.folder)
    assert repr(shown).startswith(f"<page of outdoor_patrol, seed {SEED}, 5 vehicles, ")
    assert html.unescape(re.findall('srcdoc="([^"]*)"', shown._repr_html_())[0]) == shown.page
    return shown.page


def test_each_frame_has_the_positions_of_its_time(page: str, recording: Recording):
    """By the whole of a part's begin and what follows, as a browser plays it."""
    found = elements(page)
    nodes, about = unpacked(found["nodes"]), json.loads(found["about"])
    assert about["first"] == [0, 80, 160]
    assert len(about["times"]) == FRAMES
    for number, first in enumerate(about["first"]):
        part = unpacked(found[f"part-{number}"])
        made = {nodes[item]["name"]: nodes[item] for item in part["frames"][0][1] if isinstance(item, int)}
        assert {BODIES, "/world", "/world/paths", "/world/ghosts/bodies"} <= set(made)
        drawn: dict[str, Any] = dict(made[BODIES]["props"])
        for k, (time, items) in enumerate(part["frames"]):
            for item in items:
                if isinstance(item, dict) and item["name"] == BODIES:
                    drawn |= item.get("updates", {})
            assert time == pytest.approx(0.05 * (first + k))
            true = recording.frame(time).position_ned
            np.testing.assert_allclose(drawn["batched_positions"].reshape(-1, 3), true, atol=1e-5)
            np.testing.assert_allclose(part["positions"].reshape(-1, 5, 3)[k], true, atol=1e-5)


def test_it_keeps_heading_layers_marks_and_readings(page: str, flown: Flight):
    found = elements(page)
    about = json.loads(found["about"])
    assert about["heading"] == f"outdoor_patrol, seed {SEED}, 5 vehicles"
    assert "<title>qrsim - outdoor_patrol</title>" in page
    layers = {layer["title"]: layer for layer in about["layers"]}
    assert layers["true paths"] == {"title": "true paths", "path": "/world/paths", "shown": True}
    assert {"vehicles", "poles", "gusts", "area"} <= set(layers)
    run = open_run(flown.folder)
    shape = (len(about["quantities"]), -1)
    assert about["period"] == pytest.approx(0.1)
    assert '["measurements.barometer.height", "m", "height above the site' in page
    for vehicle in range(5):
        values = unpacked(found[f"plots-{vehicle}"])["values"].reshape(shape)
        measured, true = (
            values[about["quantities"].index(name)] for name in ("measurements.barometer.height", "derived.height")
        )
        # Every 0.1 s of ticks of 0.02 s.
        np.testing.assert_array_equal(measured, run["measurements"]["barometer.height"][::5, vehicle])
        np.testing.assert_array_equal(true, -run["truth"]["position_ned.z"][::5, vehicle].astype(np.float32))


def test_hidden_layers_are_recorded_and_hidden(recording: Recording, monkeypatch: pytest.MonkeyPatch):
    """The page's own switches show them."""
    monkeypatch.setattr("qrsim.view.layers.Ghosts.most", 1)
    monkeypatch.setattr(film, "FASTEST_HZ", 0.5)
    found = elements(film.film(recording))
    about, part = json.loads(found["about"]), unpacked(found["part-0"])
    assert [layer["shown"] for layer in about["layers"] if layer["title"] == "GNSS positions"] == [False]
    names = [i["name"] for _, items in part["frames"][1:] for i in items if isinstance(i, dict)]
    assert "/world/ghosts/bodies" in names


def test_what_is_left_out_of_a_long_run_is_said(recording: Recording, monkeypatch: pytest.MonkeyPatch):
    assert film.thinned(recording) == []
    monkeypatch.setattr(film, "MOST_FRAMES", 21)
    monkeypatch.setattr(plots, "MOST_VALUES", 5 * 200)
    lines = film.thinned(recording)
    assert lines[0] == "so long a run is exported at every 0.5 s"
    assert lines[1].startswith("its quantities are plotted at every ")
    assert len(film.times_of(recording)) == 21


@pytest.mark.parametrize("there", [True, False])
def test_a_page_that_does_not_fit_leaves_nothing(
    there: bool, flown: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused
):
    folder = tmp_path / "page"
    if there:
        folder.mkdir()
    monkeypatch.setattr(film, "FASTEST_HZ", 0.5)
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 120_000})())
    refused(["view", str(flown.folder), "--export", str(folder)], "no room for the page", "0.12 MB are free", code=1)
    assert folder.exists() == there
    assert list(tmp_path.rglob("*.*")) == []


def test_a_disk_that_is_full_is_said_in_one_line(
    flown: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused
):
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(film, "_write_element", full)
    monkeypatch.setattr(film, "FASTEST_HZ", 0.5)
    folder = tmp_path / "page"
    refused(["view", str(flown.folder), "--export", str(folder)], "index.html: No space left on device", code=1)
    assert not folder.exists()


def test_progress_is_told(recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(film, "FASTEST_HZ", 1.0)
    monkeypatch.setattr(film, "TOLD_FRAMES", 4)
    told: list[tuple[int, int]] = []
    assert film.export(recording, tmp_path, lambda *now: told.append(now)) == tmp_path / "index.html"
    assert told == [(0, 11), (4, 11), (8, 11), (11, 11)]


class TestInANotebook:
    def test_what_can_be_shown(self, flown: Flight, tmp_path: Path):
        for wrong in (3, None, {"a": 1}):
            with pytest.raises(UsageError, match=r"expected a run \(qrsim.open_run\) or its folder, not"):
                qrsim.show(wrong)  # type: ignore[arg-type]
        with pytest.raises(UsageError, match="there is no such folder"):
            qrsim.show(tmp_path / "nothing")
        rollout = qrsim.Rollout({}, None, np.zeros(0), np.zeros(0), np.zeros(0), ())
        with pytest.raises(UsageError, match="a rollout keeps numbers and no flight"):
            qrsim.show(rollout)  # type: ignore[arg-type]
        for height in (0, 1e3, True):
            with pytest.raises(UsageError, match=r"height: .*; expected a whole number of pixels, at least 200"):
                qrsim.show(flown.folder, height=height)  # type: ignore[arg-type]

    def test_without_a_notebook_it_is_saved(self, flown: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(film, "FASTEST_HZ", 0.5)
        shown = qrsim.show(open_run(flown.folder), height=300)
        assert ".save('page.html') writes it" in repr(shown)
        assert 'height="300"' in shown._repr_html_()[-200:]
        assert shown.save(tmp_path / "a.html").read_text("utf-8") == shown.page
        with pytest.raises(UsageError, match=r"has to end in \.html"):
            shown.save(tmp_path / "a.png")
        with pytest.raises(UsageError, match="there is no folder"):
            shown.save(tmp_path / "no" / "a.html")
        (tmp_path / "taken.html").mkdir()
        with pytest.raises(RunError, match="Is a directory"):
            shown.save(tmp_path / "taken.html")

    def test_viser_that_is_missing_is_said(self, flown: Flight, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setitem(__import__("sys").modules, "viser", None)
        with pytest.raises(UsageError, match=r"pip install 'qrsim\[view\]'"):
            qrsim.show(flown.folder)


def test_an_export_is_the_page_of_a_notebook(page: str, flown: Flight, tmp_path: Path, capsys):
    """Of two seconds' frames of it, to spare time: the elements are the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(film, "FASTEST_HZ", 0.5)
        assert cli.main(["view", str(flown.folder), "--export", str(tmp_path / "page")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'page' / 'index.html'}\n"
    written = elements((tmp_path / "page" / "index.html").read_text("utf-8"))
    assert set(written) == set(elements(page)) - {"part-1", "part-2"}
    assert json.loads(written["about"])["end"] == DURATION
