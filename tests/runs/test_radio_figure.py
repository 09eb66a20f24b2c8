"""Who heard whom, delivery and connectivity: from packets made up by hand, and from the run folder of a flight."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from qrsim.cli import main
from qrsim.errors import UsageError
from qrsim.runs import open_run
from qrsim.runs.layout import Event
from qrsim.runs.radio_figure import draw_radio
from qrsim.runs.radio_links import Packets, components_of, connectivity, out_of_reach, packets_of
from qrsim.view.highlights import highlights_of
from qrsim.view.recording import Recording
from qrsim.view.series import Series

HEARD, WEAK, NOISE, TO_OTHERS = 1, 2, 3, 4


def packets(*periods: list[tuple[int, int, int]], n: int = 4, stopped: tuple[int, ...] = ()) -> Packets:
    """Return packets from (sender, receiver, outcome), one period after the other, each at -70 dBm less its sender."""
    shape = (len(periods), 3, n)
    sender, outcome, rssi = np.full(shape, -1), np.zeros(shape, int), np.zeros(shape)
    for p, period in enumerate(periods):
        used = [0] * n
        for i, j, what in period:
            sender[p, used[j], j], outcome[p, used[j], j], rssi[p, used[j], j] = i, what, -70.0 - i
            used[j] += 1
    flies = np.ones((len(periods), n), bool)
    flies[:, list(stopped)] = False
    return Packets(np.arange(len(periods)) * 0.2, sender, outcome, rssi, flies)


ALL = np.ones(4, bool)


def test_packets_are_counted_for_each_direction() -> None:
    found = packets([(0, 1, HEARD), (1, 0, HEARD)], [(0, 1, WEAK), (2, 1, HEARD)], [(0, 1, HEARD), (3, 1, 0)])
    sent, heard, strength = found.counts()
    assert sent.tolist() == [[0, 3, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]]
    assert heard.tolist() == [[0, 2, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]]
    assert strength[0, 1] == -70.0
    assert strength[2, 1] == -72.0
    assert np.isnan(strength[3, 1])


def test_receivers_out_of_reach_are_counted_if_the_log_tells() -> None:
    pair = [(0, 1, HEARD), (1, 0, HEARD)]
    found, sent = packets(pair, [*pair, (0, 2, HEARD)], stopped=(3,)), np.array([[1, 1, 1, 0], [2, 2, 2, 0]])
    # Three vehicles send to two others twice, which makes 12, and 5 packets were within reach.
    assert out_of_reach(found, sent, ALL) == 7
    # Two of them with a radio: 4, all within reach.
    without = np.array([True, True, False, True])
    assert out_of_reach(packets(pair, pair, stopped=(3,)), sent * without, without) == 0
    # One of them was silent, or a packet was for another vehicle.
    assert out_of_reach(found, sent - [[0, 0, 1, 0]], ALL) is None
    assert out_of_reach(packets([*pair, (0, 2, 0)], stopped=(3,)), sent[:1], ALL) is None


def test_groups_are_of_those_who_hear_each_other_both_ways() -> None:
    chain = [(0, 1, HEARD), (1, 0, HEARD), (1, 2, HEARD), (2, 1, HEARD), (2, 3, HEARD), (3, 2, WEAK)]
    assert components_of(packets(chain), ALL) == (2, 0.75)
    assert components_of(packets(chain, [(3, 2, HEARD)]), ALL) == (1, 1.0)
    # Who has stopped or has no radio does not count, and joins nobody.
    assert components_of(packets(chain, stopped=(3,)), ALL) == (1, 1.0)
    assert components_of(packets(chain, stopped=(1,)), ALL) == (3, pytest.approx(1 / 3))
    assert components_of(packets(chain), np.array([True, False, True, True])) == (3, pytest.approx(1 / 3))


def test_what_becomes_of_packets_adds_up_in_each_bin() -> None:
    first = [(0, 1, HEARD), (1, 0, WEAK), (2, 0, NOISE), (3, 0, TO_OTHERS)]
    found = connectivity(packets(first, [(0, 1, HEARD)], [], []), 2, ALL)
    np.testing.assert_allclose(found.delivery, [0.4, np.nan])
    assert {name: part[0] for name, part in found.lost.items()} == {"too weak": 0.2, "by chance": 0.2, "to others": 0.2}
    assert found.components.tolist() == [4, 4]
    assert found.largest.tolist() == [0.25, 0.25]
    np.testing.assert_allclose(found.time, [0.2, 0.6])


@pytest.fixture(scope="module")
def run(tmp_path_factory: Any) -> Any:
    folder = tmp_path_factory.mktemp("radio")
    words = ["run", "formation_radio", "--out", str(folder / "run"), "--set", "duration=2.0"]
    assert main([*words, "--set", "world.radio.path_loss.shadowing_db=0"]) == 0
    return open_run(folder / "run")


@pytest.mark.long
def test_a_row_is_cut_in_two_by_a_wall(run: Any) -> None:
    """6 km are heard, 12 km are heard, 24 km mostly; through the wall 20 dB are missing."""
    found = packets_of(run)
    # Every 0.2 s of 2 s, known one tick later.
    np.testing.assert_allclose(found.time, 0.2 * np.arange(10) + 0.02)
    sent, heard, strength = found.counts()
    far = np.abs(np.subtract.outer(np.arange(8), np.arange(8))) == 7
    # 42 km is out of reach.
    assert (sent[~(far | np.eye(8, dtype=bool))] == 10).all()
    assert not sent[far].any()
    assert heard[0, 1] == heard[1, 0] == 10
    # 20 dBm - (31.68 dB + 22 lg 6000), with no shadowing: docs/explanation/models/radio.md.
    assert strength[0, 1] == pytest.approx(20.0 - 31.68 - 22.0 * np.log10(6000.0), abs=0.2)
    assert strength[0, 1] == pytest.approx(strength[1, 0], abs=0.1)
    assert heard[2, 5] == 0
    [member] = Recording(run).members
    [worst] = [text for _, text, _ in highlights_of([Series(member, member)]) if "radio" in text]
    assert worst == "worst radio link: row_0 to row_4, 100.0 % of 10 packets lost"
    # As if the second vehicle had stopped, which ends its speed: that before is told.
    member.recording.stops = [(Event(1.0, 50, "row_1", "collision", "obstacle", 0.0, ""), 1)]
    truth = run["truth"]
    velocity = truth.arrays([f"velocity_body.{axis}" for axis in "xyz"])
    before = np.linalg.norm([part[49, 1] for part in velocity.values()])
    assert truth.time[49] == pytest.approx(0.98)
    assert before > 0.1
    told = f"speed before it stopped: row_1, {before:.1f} m/s"
    assert told in [text.partition(";")[0] for _, text, _ in highlights_of([Series(member, member)])]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = draw_radio(run, start=0.5)
        figure.canvas.draw()
    graph, delivery, groups, *_ = figure.axes
    assert len(graph.collections[0].get_segments()) == 54
    assert delivery.lines[0].get_ydata().max() <= 1.0
    assert groups.get_ylabel() == "part in the largest group"
    assert "radio sik_915, 0.62 to 1.82 s" in figure.get_suptitle()


@pytest.mark.long
def test_a_replay_shows_the_links_of_its_time(run: Any) -> None:
    from qrsim.view.recording import Recording

    found = Recording(run).frame(1.0).links
    assert found is not None
    row = int(np.searchsorted(run["measurements"].time, 1.0 + 1e-6, side="right")) - 1
    for part, array in (("sender", found.sender), ("error", found.error), ("outcome", found.outcome)):
        assert array.shape == (7, 8)
        for k in range(7):
            np.testing.assert_allclose(array[k], run["measurements"][f"radio.{part}.{k}"][row], rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--panel", "radio", "--vehicle", "row_0"], "--panel radio is of all vehicles together; leave out --vehicle"),
        (["--panel", "radio", "--panel", "truth.valid"], "--panel radio is a separate figure; leave out the other"),
        (["--panel", "radio", "--from", "9"], "no period of the radio was logged in that span"),
    ],
)
def test_what_cannot_be_drawn_is_said_in_one_line(run: Any, words: list[str], said: str, capsys: Any) -> None:
    assert main(["plot", str(run.folder), *words]) == 2
    assert said in capsys.readouterr().err


def test_a_run_without_radio_is_refused(tmp_path: Any) -> None:
    from flight import write_flight

    with pytest.raises(UsageError, match=r"its vehicles have no radio; a scenario with world.radio gives them one"):
        draw_radio(open_run(write_flight(tmp_path / "run", vehicles=2)))
