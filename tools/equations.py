"""Equations of the pages as MathML Core, made while the site is built: the site needs no script for them.

Pages have LaTeX in the two forms that GitHub draws as well: blocks with the fence ``math``, and ``$`...`$`` within a
line. `math-core <https://pypi.org/project/math-core>`_ converts them. Numbers of equations (``\\tag{A3}``) are on the
left, where they stay visible on a phone while a wide equation scrolls.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element

from markdown import Extension, Markdown
from markdown.inlinepatterns import InlineProcessor
from math_core import LatexError, LatexToMathML

# The last cell of a row of numbered equations; the first one is empty and as wide.
_NUMBERED = re.compile(
    r'<mtr><mtd style="width: 50%"></mtd>(?P<cells>(?:(?!</?mtr>).)*)'
    r'<mtd style="width: 50%[^"]*">(?P<number><mtext>[^<]*</mtext>)?</mtd></mtr>'
)
# Not within code, as in ``$`x`$`` of two backticks.
_INLINE = r"(?<!`)\$`(?P<line>[^`\n]+)`\$(?!`)"
# Blocks of code too, so that what looks like an equation in them is none.
_ANY = re.compile(rf"^ *(?P<fence>```+)(?P<kind>\w*)[^\n]*\n(?P<block>.*?)^ *(?P=fence) *$|{_INLINE}", re.M | re.S)

# GitHub refuses these commands, and shows the backslash of an underscore in text.
_REFUSED = re.compile(r"\\(?:operatorname|mbox|phantom|newcommand|def|DeclareMathOperator)\b|\\text\w*\{[^{}]*\\_")


def mathml(latex: str, block: bool) -> str:
    """Return an equation as the element ``math``, or as a message in red where it is not LaTeX.

    Args:
        latex: the equation; ``\\tag`` needs an environment with numbers, such as ``align``.
        block: an equation in a block, with large fractions and limits above and below sums.
    """
    made: str = _converter(strict=False).convert_with_local_state(latex.strip(), displaystyle=block)
    made = _NUMBERED.sub(
        lambda row: (
            f'<mtr><mtd class="number">{row["number"] or ""}</mtd>{row["cells"]}<mtd style="width: 50%"></mtd></mtr>'
        ),
        made,
    )
    # Browsers ignore these spaces; without them the search would show a block as one word.
    return made.replace("</mtd>", "</mtd> ")


def faults(text: str) -> Iterator[str]:
    """Yield the line and the fault of each equation of a page that math-core or GitHub cannot draw.

    Args:
        text: a page.
    """
    for found in _ANY.finditer(text):
        if found["kind"] not in (None, "math"):
            continue
        latex, block = (found["block"], True) if found["fence"] else (found["line"], False)
        place = f"{text.count(chr(10), 0, found.start()) + 1}:"
        if refused := _REFUSED.search(latex):
            yield f"{place} GitHub does not draw '{refused[0]}'; write \\mathrm. Equation: {' '.join(latex.split())}"
        try:
            _converter(strict=True).convert_with_local_state(latex.strip(), displaystyle=block)
        except LatexError as error:
            yield f"{place} {error} Equation: {' '.join(latex.split())}"


def fence(source: str, language: str, css_class: str, options: dict[str, str], md: Markdown, **others: Any) -> str:
    """Return a block of LaTeX as HTML: a formatter of ``pymdownx.superfences``."""
    return f'<div class="equation">{mathml(source, block=True)}</div>'


@functools.cache
def _converter(strict: bool) -> LatexToMathML:
    return LatexToMathML(fancy_error=False, continue_on_error=not strict)


class _Inline(InlineProcessor):
    """LaTeX within a line."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str | Element, int, int]:  # noqa: N802
        return self.md.htmlStash.store(mathml(m["line"], block=False)), m.start(0), m.end(0)


class Equations(Extension):
    """The extension of Python-Markdown for LaTeX within a line."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802
        """Register the pattern in front of code, whose priority is 190."""
        md.inlinePatterns.register(_Inline(_INLINE, md), "equation", 195)


def makeExtension(**settings: Any) -> Equations:  # noqa: N802
    """Return the extension, for its name in mkdocs.yml."""
    return Equations(**settings)
