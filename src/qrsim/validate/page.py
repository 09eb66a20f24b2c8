"""The report as one HTML page: style and pictures are embedded, nothing is fetched."""

from __future__ import annotations

import base64
import html
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from qrsim.validate.parts import Result
from qrsim.validate.report import FITS, FITS_IN_PART, Check, Finding, Picture, Verdict, worst

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { margin-top: 3rem; border-bottom: 2px solid #ccc; }
table { border-collapse: collapse; margin: 0.6rem 0 1.2rem; width: 100%; font-size: 0.9rem; }
th, td { text-align: left; vertical-align: top; padding: 0.3rem 0.6rem; border-bottom: 1px solid #ddd; }
td.number { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
th.number { text-align: right; }
.pass, .fits { color: #146c2e; } .fail, .not { color: #b3261e; } .part { color: #8a5a00; } .skip, .note { color: #555; }
.verdict { font-weight: 600; white-space: nowrap; }
figure { margin: 1rem 0; } figure img { max-width: 100%; border: 1px solid #ddd; }
figcaption, .small { color: #444; font-size: 0.9rem; }
.reading { background: #f3f5f8; border-left: 4px solid #5b7db1; padding: 0.5rem 1rem; }
code { font-size: 0.85em; overflow-wrap: anywhere; }
"""
_CLASSES: dict[Verdict, str] = {"fits": "fits", "fits in part": "part", "does not fit": "not", "to note": "note"}
SOURCE = (
    "A. Symington, R. De Nardi, S. Julier, S. Hailes, “Simulating Quadrotor UAVs in Outdoor Scenarios”, IROS 2014,"
    " pp. 3382-3388"
)


def write_page(results: Sequence[Result], about: Mapping[str, Any]) -> str:
    """Write the page as text.

    Args:
        results: in the order they are shown.
        about: what stands beside the parts in the JSON.
    """
    body = "\n".join([_head(results, about), _summary(results), *map(_section, results), _foot(about)])
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>qrsim validation</title><style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def number(value: float) -> str:
    """Format a number with four significant digits."""
    return f"{value:.4g}".replace("e-0", "e-").replace("-", "\N{MINUS SIGN}")


def _text(words: str) -> str:
    return html.escape(words, quote=False)


def _head(results: Sequence[Result], about: Mapping[str, Any]) -> str:
    failed = [check for result in results if result.outcome for check in result.outcome.checks if not check.passed]
    count = sum(len(result.outcome.checks) for result in results if result.outcome)
    verdict = (
        f'<p class="verdict fail">{len(failed)} of {count} checks failed.</p>'
        if failed
        else f'<p class="verdict pass">All {count} checks passed.</p>'
    )
    made = f"{about['made']}, {about['platform']}, jax {about['jax']}"
    return (
        f"<h1>Validation of qrsim {_text(about['qrsim'])}</h1>\n"
        f'<p class="small">{_text(made)}</p>\n{verdict}\n'
        f"<p>The simulator follows {_text(SOURCE)}. That paper made its models credible with figures of thrust,"
        " rotation, translation, turbulence and GNSS. Each is made again here, with numbers: from the same public"
        " recordings, or, where there is none, from a closed form and an independent program.</p>\n"
        "<p>Two kinds of statement are kept apart. A <b>check</b> asks whether the program computes what it should: a"
        " reference score of the published constants to 3 digits, a closed form within the stated confidence. A check"
        " that fails is an error, and the command says so by exit code 1. A <b>finding</b> says how well the model"
        " describes what was recorded; a"
        " model may be computed without a flaw and still not fit. For simulated signals, “fits” means at least"
        f" {100 * FITS:.0f} % of the variance of the record explained (1 - mean squared error/variance), “fits in part”"
        f" at least {100 * FITS_IN_PART:.0f} %. For Allan deviations they mean the same shares of windows within the"
        " 90 % band; for spectra, “fits” means within 1 dB of the closed form.</p>"
    )


def _summary(results: Sequence[Result]) -> str:
    rows = []
    for result in results:
        name = f'<a href="#{result.part.name}">{_text(result.part.title)}</a>'
        outcome = result.outcome
        if outcome is None:
            skipped = '<td class="verdict skip">skipped</td><td></td>'
            rows.append(f"<tr><td>{name}</td>{skipped}<td>{_text(result.skipped)}</td></tr>")
            continue
        good = sum(check.passed for check in outcome.checks)
        state = "pass" if outcome.passed else "fail"
        rows.append(
            f'<tr><td>{name}</td><td class="verdict {state}">{good} of {len(outcome.checks)} checks</td>'
            f"<td>{_fits(outcome.findings)}</td><td>{_text(outcome.reading)}</td></tr>"
        )
    head = "<tr><th>part</th><th>checks</th><th>findings</th><th>what it says</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _fits(findings: Sequence[Finding]) -> str:
    """Return how many findings have each verdict."""
    counts = Counter(found.verdict for found in findings)
    return "<br>".join(
        f'<span class="verdict {style}">{verdict}: {counts[verdict]}</span>'
        for verdict, style in _CLASSES.items()
        if counts[verdict] and verdict != "to note"
    )


def _section(result: Result) -> str:
    part, outcome = result.part, result.outcome
    head = f'<h2 id="{part.name}">{_text(part.title)}</h2>\n<p>Answers {_text(part.answers)}.</p>'
    if outcome is None:
        return f'{head}\n<p class="skip">Skipped: {_text(result.skipped)}.</p>'
    pieces = [head, f"<p>{_text(outcome.method)}</p>", f'<p class="reading">{_text(outcome.reading)}</p>']
    pieces += [f'<p class="skip">Skipped: {_text(words)}.</p>' for words in outcome.skipped]
    pieces += map(_figure, outcome.pictures)
    if outcome.findings:
        pieces.append(_findings(outcome.findings))
    pieces.append(_checks(outcome.checks))
    return "\n".join(pieces)


def _figure(shown: Picture) -> str:
    data = base64.b64encode(shown.png).decode("ascii")
    caption = html.escape(shown.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def _findings(findings: Sequence[Finding]) -> str:
    rows = "".join(
        f'<tr><td>{_text(found.name)}</td><td class="verdict {_CLASSES[found.verdict]}">{found.verdict}</td>'
        f"<td>{_text(found.number)}</td><td>{_text(found.reading)}</td></tr>"
        for found in findings
    )
    return f"<table><tr><th>finding</th><th>verdict</th><th>number</th><th>reading</th></tr>{rows}</table>"


def _checks(checks: Sequence[Check]) -> str:
    rows = "".join(_check(check) for check in checks)
    narrow = worst(checks)
    used = 100 * abs(narrow.value - narrow.expected) / narrow.tolerance
    return (
        '<table><tr><th>check</th><th></th><th class="number">number</th><th class="number">expected</th>'
        f'<th class="number">bound ±</th><th>unit</th><th>why this bound</th></tr>{rows}</table>'
        f'<p class="small">Nearest to its bound: {_text(narrow.name)}, at {used:.0f} % of it.</p>'
    )


def _check(check: Check) -> str:
    state = "pass" if check.passed else "fail"
    return (
        f'<tr><td>{_text(check.name)}</td><td class="verdict {state}">{state}</td>'
        f'<td class="number">{number(check.value)}</td><td class="number">{number(check.expected)}</td>'
        f'<td class="number">{check.tolerance:.2g}</td><td>{_text(check.unit)}</td><td>{_text(check.reason)}</td></tr>'
    )


def _foot(about: Mapping[str, Any]) -> str:
    files = "".join(f"<li>{_text(name)}: sha256 <code>{sha}</code></li>" for name, sha in about["recordings"].items())
    listed = f"<p>Recordings, checked before use:</p><ul>{files}</ul>" if files else "<p>No recording was used.</p>"
    return (
        f'<h2>Behind the numbers</h2>\n<div class="small">{listed}<p>Every number, and those behind the curves, is in'
        " the JSON file beside this page. Random numbers have fixed seeds: the same program gives the same report on"
        " one kind of processor. Made by <code>qrsim validate</code>.</p></div>"
    )
