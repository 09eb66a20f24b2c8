"""Every picture of the documentation is the work of a command that stands beside it or in the list of pictures."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from docs.writers import gallery, pictures
from PIL import Image

from qrsim.scenarios.reading import built_in_names
from qrsim.view.browser import INSTALL, find_browser

ROOT = pictures.IMAGES.parent.parent
PAGES = {path: path.read_text("utf-8") for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))}


AGAIN = [ROOT / page for page in ("README.md", "docs/gallery/index.md", "docs/start/first_flight.md")]


def test_each_picture_has_a_command_and_a_place():
    """And none is left of what is shown no more."""
    assert {path.name for path in pictures.IMAGES.iterdir()} == set(pictures.every())
    for name, command in pictures.every().items():
        showing = {page: text for page, text in PAGES.items() if f"images/{name})" in text}
        # These show pictures of other pages again.
        elsewhere = [text for page, text in showing.items() if page not in AGAIN]
        assert len(elsewhere) == 1 or (not elsewhere and showing), name
        text = (elsewhere or list(showing.values()))[0]
        if name.startswith(("view_", "slam_")) or name == "outdoor_patrol.png":
            said = " ".join(text.split()).replace("\\ ", "")
            assert all(part.strip() in said for part in command.split(";")), command


def test_each_page_of_the_gallery_is_a_picture_and_the_code_that_makes_it():
    index = PAGES[gallery.FOLDER / "index.md"]
    assert len(pictures.GALLERY) >= 12
    for name in pictures.GALLERY:
        block = gallery.code(name)
        assert 20 <= len(block.splitlines()) <= 60, name
        assert f'savefig("gallery_{name}.png"' in block
        assert f"](../images/gallery_{name}.png)" in PAGES[gallery.FOLDER / f"{name}.md"]
        assert f"](../images/gallery_{name}.png)]({name}.md)" in index
        assert (pictures.IMAGES / f"gallery_{name}.png").stat().st_size < 150_000, name


def test_pictures_of_the_page_are_small_enough_to_be_kept_with_the_code():
    for name, shot in pictures.SHOTS.items():
        assert 20_000 < (pictures.IMAGES / f"view_{name}.png").stat().st_size < 400_000
        assert shot.run.split()[0] in (*built_in_names(), pictures.SWARM)


def test_colours_of_the_legend_survive():
    """Of "stopped", of which a picture has some pixels only."""
    for name in pictures.SHOTS:
        picture = np.asarray(Image.open(pictures.IMAGES / f"view_{name}.png").convert("RGB")).astype(int)
        away = np.abs(picture[560:, :280] - np.array([197, 19, 12])).max(axis=2)
        assert (away < 8).sum() > 20, name


def test_no_camera_is_set_by_hand():
    """Nothing but the words that a user has: a direction or a vehicle."""
    for shot in pictures.SHOTS.values():
        words = shlex.split(shot.view)
        assert words[::2] in ([], ["--camera"])


def test_families_with_a_task_of_their_own_are_shown():
    folders = {name.partition("/")[0] for name in built_in_names() if "/" in name}
    assert folders <= set(pictures.SHOTS)


def test_a_wrong_name_is_refused(capsys: pytest.CaptureFixture[str]):
    assert pictures.main(["swrm"]) == 2
    assert "no family of scenarios 'swrm'; did you mean 'swarm'?" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}")
def test_a_picture_is_written_by_its_commands(tmp_path: Path):
    assert pictures.write("keep_spot", tmp_path).stat().st_size > 20_000
