"""The tables of docs/reference/mavlink_compared.md are those of the code."""

from __future__ import annotations

from docs.writers import mavlink_table as table

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
