"""``qrsim run``: what it says of orbits, of fixes that come and go, and of the faults of a scenario."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest
import yaml
from tests.models.gnss.sp3_writing import line_of, sp3_text

from qrsim.runs import open_run

KINDS = ("no_fix", "fix_lost", "fix_found", "fault_begins", "fault_ends")


@pytest.fixture(scope="module")
def told(fly: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A flight of 4 s over which all but three satellites are gone for 2 s; one receiver's mask hides the whole sky.

    The file's epochs are 1 s apart; it ends 37 s after the run, and its header lists a satellite more.
    """
    text = sp3_text(epochs=60, interval=1.0, first=datetime(2010, 8, 31, 15))
    lines = text.replace("  0  0  0", "G30  0  0", 1).splitlines()
    gap = line_of(text, "*", 20)
    del lines[gap + 3 : gap + 24]
    folder = tmp_path_factory.mktemp("events")
    (folder / "gap.sp3").write_text("\n".join([*lines, ""]))
    # 15 leap seconds: the run starts 18 s into the file, whose gap is from 19 to 21 s.
    content = {
        "name": "gap",
        "duration": 4.0,
        "start_time": "2010-08-31T15:00:03Z",
        "world": {"sky": {"orbits": {"type": "sp3", "file": "gap.sp3"}, "errors": {"type": "ou", "std": 1.0}}},
        "fleets": {
            "a": {
                "controller": {"type": "waypoint", "feed": "truth"},
                "sensors": {
                    "gnss": {"type": "gnss_receiver", "delay": 0, "elevation_mask_deg": [0.0, 90.0]},
                    "baro": {"type": "ideal_barometer"},
                },
                "faults": [{"sensor": "baro", "kind": "frozen", "start": 1.5, "end": 2.5, "vehicles": ["a_1"]}],
                "vehicles": [{"position_ned": [0.0, 10.0 * i, -20.0]} for i in range(2)],
            }
        },
    }
    (folder / "gap.yaml").write_text(yaml.safe_dump(content))
    return fly(str(folder / "gap.yaml"), "--no-figure")


def test_fixes_and_faults_are_events_with_their_times(told: Any) -> None:
    assert told.code == 0, told.complaints
    found = [event for event in open_run(told.folder).events if event.kind in KINDS]
    assert [(event.kind, event.vehicle, event.field, event.message) for event in found] == [
        ("no_fix", "a_1", "gnss.satellites", "a_1: gnss no fix at 0.00 s, 0 satellites"),
        ("fix_lost", "a_0", "gnss.satellites", found[1].message),
        ("fault_begins", "a_1", "baro", "a_1: baro stuck, begins at 1.50 s"),
        ("fault_ends", "a_1", "baro", "a_1: baro stuck, ends at 2.50 s"),
        ("fix_found", "a_0", "gnss.satellites", found[4].message),
    ]
    assert found[1].message.startswith("a_0: gnss fix lost at 1.00 s, ")
    assert found[1].value <= 3
    assert found[4].message.startswith("a_0: gnss fix found at 3.00 s, ")
    assert found[4].value >= 4
    printed = told.printed.splitlines()
    for event in found:
        assert event.message in printed


def test_what_is_unusual_about_the_orbits_is_a_line_each(told: Any) -> None:
    complaints = told.complaints.splitlines()
    assert all(line.startswith("warning: ") and "gap.sp3: " in line for line in complaints)
    expected = (
        "the run comes within 30 minutes of the start of the file's span",
        "the run comes within 30 minutes of the end of the file's span",
        "not available during all of the run: G04, G05",
        "in the header's list, but without positions: G30",
        "only 3 satellites of systems 'G' have positions during the run or a part of it; a fix needs 4",
    )
    assert len(complaints) == len(expected)
    for line, part in zip(complaints, expected, strict=True):
        assert part in line
