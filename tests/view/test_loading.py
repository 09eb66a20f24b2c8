"""What a page says until its first frame is there."""

from __future__ import annotations

from qrsim.view.loading import loading_element


def test_names_are_escaped():
    """A page shows the name of a run folder before any script runs."""
    found = loading_element('<img src=x onerror="alert(1)">')
    assert found.startswith('<div id="qrsim-loading" style="')
    assert found.endswith(">loading &lt;img src=x onerror=&quot;alert(1)&quot;&gt; ...</div>")
