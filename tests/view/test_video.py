"""Videos: names, times of frames, and the encoder."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest
from PIL import Image

from qrsim.errors import RunError, UsageError
from qrsim.view import video
from qrsim.view.shots import Camera


def test_frames_are_25_a_second_and_end_with_the_run() -> None:
    times = video.times_of_video(2.0, 4.0, 1.0)
    assert len(times) == 51
    assert times[:2] == pytest.approx([2.0, 2.04])
    assert times[-1] == 4.0
    assert len(video.times_of_video(0.0, 600.0, 60.0)) == 251
    with pytest.raises(UsageError, match=r"180001 frames; at most 90000, so at least --speed 2"):
        video.times_of_video(0.0, 7200.0, 1.0)


@pytest.mark.parametrize("name", ["a.avi", "nowhere/a.mp4", "a", "folder.mp4"])
def test_a_name_that_cannot_be_written_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(
        UsageError, match=r"--video .*: (the name has to end in \.mp4 or|there is no folder|is a folder)"
    ):
        video.check_video(tmp_path / name)


def test_without_an_encoder_one_line_says_how_to_install_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video.shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(RunError, match="apt-get install ffmpeg, or python -m pip install imageio-ffmpeg"):
        video.find_ffmpeg()


def test_a_camera_may_go_with_a_vehicle() -> None:
    assert Camera.parsed("a:chase", ["a"]) == Camera("a", "chase")
    with pytest.raises(UsageError, match="did you mean 'onboard'"):
        Camera.parsed("a:onbord", ["a"])


def frame(level: int) -> bytes:
    found = io.BytesIO()
    Image.new("RGB", (101, 81), (level, level, level)).save(found, "JPEG")
    return found.getvalue()


def test_the_encoder_writes_all_or_nothing(tmp_path: Path) -> None:
    try:
        ffmpeg = video.find_ffmpeg()
    except RunError:
        pytest.skip("no ffmpeg")
    path = tmp_path / "a.mp4"
    with video._encoder(ffmpeg, path) as write:
        for level in (10, 120, 240):
            write(frame(level))
    # The head of an MP4 file: a box of type "ftyp".
    assert path.read_bytes()[4:8] == b"ftyp"
    with pytest.raises(RunError, match="ffmpeg failed"), video._encoder(ffmpeg, tmp_path / "b.mp4") as write:
        write(b"no picture")
    with pytest.raises(ZeroDivisionError), video._encoder(ffmpeg, tmp_path / "c.mp4") as write:
        write(bytes(1 // 0))
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]
