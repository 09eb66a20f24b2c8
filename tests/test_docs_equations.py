"""Equations of the pages: LaTeX that becomes MathML, with numbers on the left."""

from __future__ import annotations

import re
from pathlib import Path

import markdown
from tools import equations, site

ROOT = Path(__file__).resolve().parent.parent


def test_all_equations_of_the_pages_can_be_drawn() -> None:
    assert site.wrong_equations(ROOT) == []


def test_a_fault_names_line_reason_and_equation() -> None:
    text = "# A\n\n```math\na = \\frc{b}{2}\n```\n\nwith $`\\sqrt{2`$.\n\n```text\n$`\\nothing`$\n```\n"
    first, second = equations.faults(text)
    assert re.fullmatch(r"3: .*\\frc.* Equation: a = \\frc\{b\}\{2\}", first)
    assert re.fullmatch(r"7: .+ Equation: \\sqrt\{2", second)


def test_commands_that_github_refuses_are_faults() -> None:
    text = "$`\\operatorname{clip}(a)`$\n$`\\text{speed\\_max}`$\n$`\\mathrm{speed\\_max}\\ \\text{m}`$\n"
    assert list(equations.faults(text)) == [
        "1: GitHub does not draw '\\operatorname'; write \\mathrm. Equation: \\operatorname{clip}(a)",
        "2: GitHub does not draw '\\text{speed\\_'; write \\mathrm. Equation: \\text{speed\\_max}",
    ]


def test_numbers_are_on_the_left() -> None:
    made = equations.mathml("\\begin{align} a &= b \\tag{A1} \\\\ c &= \\frac{d}{2} \\notag \\end{align}", block=True)
    rows = re.findall(r"<mtr>(.*?)</mtr>", made)
    assert [re.findall(r'^<mtd class="number">(.*?)</mtd>', row) for row in rows] == [["<mtext>(A1)</mtext>"], [""]]
    assert [row.count("<mtd") for row in rows] == [4, 4]
    assert "<mfrac><mi>d</mi><mn>2</mn></mfrac>" in rows[1]
    assert made.count("(A1)") == 1


def test_a_line_has_equations_and_code_keeps_its_dollars() -> None:
    text = "At $`x^2`$ it costs $5, `$x` and ``$`y`$``.\n"
    made = markdown.markdown(text, extensions=["tools.equations"])
    assert made == (
        "<p>At <math><msup><mi>x</mi><mn>2</mn></msup></math> it costs $5, <code>$x</code> and <code>$`y`$</code>.</p>"
    )


def test_an_equation_that_is_wrong_is_named_on_the_page() -> None:
    made = equations.fence("a \\nothing b", "math", "equation", {}, markdown.Markdown())
    assert "<math" not in made
    assert "\\nothing" in made
