"""Text of others inside of the page's Markdown."""

from __future__ import annotations

import html

import pytest

from qrsim.view.markdown import plain


@pytest.mark.parametrize("text", ["<b>", "a & b", "{1 + 1}", "*x*", "_x_", "`x`", "[a](b)", "![a](b)", "$x$", "# x"])
def test_it_reads_the_same_and_means_nothing(text: str) -> None:
    found = plain(text)
    assert html.unescape(found) == text
    assert not set(found.replace("&#", "").replace(";", "")) & set("<>{}*_`[]()!$#")


def test_it_stays_on_its_line() -> None:
    assert plain("a\n# b\r\x1b[31m\u2028c") == "a &#35; b  &#91;31m c"


def test_plain_words_are_left_alone() -> None:
    assert plain("outdoor-patrol, seed 1: 5.0 m") == "outdoor-patrol, seed 1: 5.0 m"
