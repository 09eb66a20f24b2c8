"""Count idioms, long sentences and clauses as subjects: ``python -m tools.prose``.

Each file has ceilings in ``prose_ceilings.json``, which may only fall; a file that is not listed there has none of any
kind. ``--write`` lowers the ceilings to the present counts, and ``--show FILE ...`` prints what is counted.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CEILINGS = Path(__file__).with_name("prose_ceilings.json")
LONGEST = 30  # words of a sentence
IDIOMS = re.compile(
    r"\b(?:beside|besides|anew|stands|likewise|whoever|whom|whose|anybody|nobody|of (?:its|their) own|so many|such an?|"
    r"by what|what it is|as it is|round where|hears?|is told|are told|looked at|looks at|in vain|for ever|the like|"
    r"at all|at that|there are none|there is none)\b",
    re.IGNORECASE,
)
OPENING = re.compile(r"(?:What|Where|Whether|Who|Whose|Whom|Of)\b")
KINDS = ("idioms", "long sentences", "openings")
# Files whose texts users see: pages, and the sources of generated pages, help texts and messages.
PAGES = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "SUPPORT.md", "docs/**/*.md")
SOURCES = tuple(f"src/qrsim/{room}/**/*.py" for room in ("apps", "control", "models", "scenarios", "tasks"))


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a page, without code, comments, headings and tables."""
    text = re.sub(r"\A---\n.*?\n---\n", "", text, flags=re.DOTALL)
    text = re.sub(r"^ *(```+|~~~+).*?^ *\1 *$", "\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    # Entries of lists and rows of tables are paragraphs.
    for paragraph in re.split(r"\n\s*\n|\n(?=\s*(?:[-*|]|\d+\.)\s)", text):
        plain = re.sub(r"\$`[^`]*`\$", "x", paragraph.strip())  # an equation is a word
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", plain)
        plain = " ".join(re.sub(r"^\s*(?:[-*>]|\d+\.)\s+", "", plain, flags=re.MULTILINE).split())
        if plain and not plain.startswith(("#", "|", ":::", "$$")):
            yield from (each for each in re.split(r"(?<=[.!?:])\s+(?=[A-Z`*\[(])", plain) if each)


def strings(source: str) -> Iterator[str]:
    """Yield the docstrings, messages and descriptions of a Python file: all of its strings with a space in them."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and re.search(r"\w | \w", node.value):
            yield " ".join(node.value.split())


def found(path: Path) -> dict[str, list[str]]:
    """Return what is counted in a file, by kind."""
    page = path.suffix == ".md"
    each = list((sentences if page else strings)(path.read_text("utf-8")))
    return {
        "idioms": [f"{match[0]}: {text}" for text in each for match in IDIOMS.finditer(re.sub("`[^`]*`", "", text))],
        "long sentences": [text for text in each if page and len(text.split()) > LONGEST],
        "openings": [text for text in each if OPENING.match(text) and not text.rstrip("*").endswith("?")],
    }


def files(root: Path) -> list[Path]:
    """Return the files that are checked."""
    return sorted({path for pattern in (*PAGES, *SOURCES) for path in root.glob(pattern) if path.is_file()})


def counted(root: Path) -> dict[str, list[int]]:
    """Return the counts of each file that has any, in the order of ``KINDS``."""
    each = {path.relative_to(root).as_posix(): found(path) for path in files(root)}
    counts = {name: [len(texts[kind]) for kind in KINDS] for name, texts in each.items()}
    return {name: numbers for name, numbers in counts.items() if any(numbers)}


def faults(counts: dict[str, list[int]], ceilings: dict[str, list[int]]) -> list[str]:
    """Return one line for each count above its ceiling."""
    return [
        f"{name}: {number} {kind}, {ceiling} allowed; see 'python -m tools.prose --show {name}'"
        for name, numbers in counts.items()
        for kind, number, ceiling in zip(KINDS, numbers, ceilings.get(name, [0, 0, 0]), strict=True)
        if number > ceiling
    ]


def lowered(counts: dict[str, list[int]], ceilings: dict[str, list[int]]) -> dict[str, list[int]]:
    """Return ceilings at the counts where these are lower; none rises and no file is added."""
    least = {
        name: [min(pair) for pair in zip(numbers, ceilings[name], strict=True)]
        for name, numbers in counts.items()
        if name in ceilings
    }
    return {name: numbers for name, numbers in least.items() if any(numbers)}


def main(arguments: list[str]) -> int:
    """Check, lower the ceilings, or show what is counted in files; return an exit code."""
    if arguments[:1] == ["--show"]:
        for name in arguments[1:]:
            for kind, texts in found(ROOT / name).items():
                print(*(f"{name}: {kind}: {text}" for text in texts), sep="\n", end="\n" if texts else "")
        return 0
    if arguments not in ([], ["--write"]):
        print("usage: python -m tools.prose [--write | --show FILE ...]", file=sys.stderr)
        return 2
    counts, ceilings = counted(ROOT), json.loads(CEILINGS.read_text("utf-8"))
    if arguments:
        lines = ",\n".join(f'"{name}": {json.dumps(ceiling)}' for name, ceiling in lowered(counts, ceilings).items())
        CEILINGS.write_text(f"{{\n{lines}\n}}\n", "utf-8")
    wrong = faults(counts, ceilings)
    totals = [sum(numbers[each] for numbers in counts.values()) for each in range(len(KINDS))]
    print(*wrong, sep="\n", end="\n" if wrong else "", file=sys.stderr)
    print(", ".join(f"{total} {kind}" for kind, total in zip(KINDS, totals, strict=True)))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
