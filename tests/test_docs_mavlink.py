"""The tables of the pages of MAVLink are those of the code."""

from __future__ import annotations

from docs.writers import mavlink_table as table
from tools.reference import mavlink

from qrsim.links.mavlink.stack import plan


def test_the_page_has_the_tables_of_now(capsys):
    assert table.main([]) == 0, capsys.readouterr().out


def test_what_is_here_is_asked_of_the_code():
    # Of both, of PX4's and of ArduPilot's flavour alone, and of none.
    for number, who in ((22, (True, True)), (34, (True, False)), (115, (False, True)), (193, (False, False))):
        assert (table.takes("px4", number), table.takes("ardupilot", number)) == who
    # No command and no item of the code is left out.
    here = {number for number in range(1, 3001) if table.takes("px4", number) or table.takes("ardupilot", number)}
    assert here <= set(table.COMMANDS)
    assert set.union(*map(set, plan.ACCEPTED.values())) <= set(table.ITEMS)
    text = table.written()
    assert "| 80 | `NAV_ROI` | yes | - | reached at once |" in text
    assert "| follow | Follow Target (4, 8) | - |" in text
    assert table.rewritten(f"a{table.BEGIN} old {table.END}b") == f"a{text}b"


def test_messages_have_their_rates_and_directions():
    text = mavlink.pages()["mavlink_messages.md"]
    sent, _, rest = text.partition("## Sent as replies")
    replies, _, taken = rest.partition("## Taken")
    assert "| `ATTITUDE` | 30 | 100 | 15 | at most once a tick |" in sent
    assert "| `ODOMETRY` | 331 | 30 | on request |" in sent
    assert "| `GPS_RAW_INT` | 24 | each fix; 5 without | 1 |" in sent
    assert "| `STATUSTEXT` | 253 |" in replies
    assert "| `SET_ATTITUDE_TARGET` | 82 |" in taken
    assert "`ATTITUDE`" not in taken
    # No note is of a message that is not spoken.
    assert [name for name in mavlink.NOTES if f"| `{name}` |" not in text] == []


def test_parameters_have_type_default_range_and_unit():
    text = mavlink.pages()["mavlink_parameters.md"]
    assert "| `BAT_LOW_THR` | REAL32 | 0.15 | 0.12 to 0.5 |  | charge at which a battery is low |" in text
    assert "| `CAL_GYRO0_ID` | INT32 | 196616 | 0 to 9999999 |" in text
    assert "| `MPC_TKO_SPEED` | REAL32 | 1.5 | 0.5 to 5 | m/s | speed of a take-off |" in text
