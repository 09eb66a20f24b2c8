"""YAML 1.2 (https://yaml.org/spec/1.2.2, the core schema) with limits, safe for text from anybody.

``045`` is 45, ``yes`` and ``1:30`` are texts, a date is a text. The values are built from the parser's events and not
by PyYAML's constructors, which follow YAML 1.1, recurse, and expand aliases without end.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, NoReturn

import yaml

from qrsim.errors import ScenarioError

# A file within these is refused or read within a second or two; a thousand vehicles with routes are.
DEEPEST, MOST_NODES, MOST_DIGITS, LONGEST_TEXT = 64, 250_000, 100, 16 * 2**20
_TAG = "tag:yaml.org,2002:"
_NULL = re.compile(r"~|null|Null|NULL|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = re.compile(r"\.nan|\.NaN|\.NAN")
# What YAML text may not hold, line breaks of other alphabets included, which parsers count differently.
_UNPRINTABLE = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _FaultError(Exception):
    """Something wrong at a line and a column, both from 1."""

    def __init__(self, problem: str, mark: Any = None):
        self.problem = problem
        self.where = _where(mark.line, mark.column) if mark else ""
        super().__init__(problem)


def parse_yaml(text: str, source: str, own: bool = False) -> Any:
    """Parse YAML 1.2 text to dicts with text keys, lists, texts, numbers, booleans and None; raises errors that name
    ``source``.

    Args:
        text: to parse.
        source: named by errors.
        own: whether this program wrote it, from content that may have been larger than files are allowed to be; then
            the limit is as many values as the text has characters, which only aliases exceed.

    Raises:
        ScenarioError: it is no YAML, has a key twice, a tag beyond those of the core schema, or is beyond the limits;
            names line and column.
    """
    try:
        if len(text) > LONGEST_TEXT:
            raise _FaultError(f"{len(text)} characters; allowed: up to {LONGEST_TEXT}")
        if bad := _UNPRINTABLE.search(text):
            line, last = text.count("\n", 0, bad.start()) + 1, text.rfind("\n", 0, bad.start())
            where = f"line {line}, column {bad.start() - last}"
            raise _FaultError(f"{where}: the character #x{ord(bad[0]):04x} is not allowed in YAML")
        return _Builder(max(MOST_NODES, len(text)) if own else MOST_NODES).build(text)
    except _FaultError as fault:
        raise ScenarioError(source, [f"{fault.where}{fault.problem}"]) from None
    except yaml.MarkedYAMLError as error:
        mark, lines = error.problem_mark or error.context_mark, text.split("\n")
        # The library's end of a text is the beginning of the line after its last.
        where = "" if mark is None else _where(mark.line, mark.column)
        if mark is not None and mark.line >= len(lines):
            where = _where(len(lines) - 1, len(lines[-1]))
        words = error.problem or error.context
        if mark is not None and mark.line < len(lines) and "\t" in lines[mark.line][: mark.column + 1]:
            words = "a tab; YAML is indented by spaces"
        raise ScenarioError(source, [f"{where}{words}"]) from None
    except yaml.YAMLError as error:
        raise ScenarioError(source, [" ".join(str(error).split())]) from None


def _where(line: int, column: int) -> str:
    """Return a text for messages on a line and column of a document, both counted from 0 here."""
    return f"line {line + 1}, column {column + 1}: "


@dataclass
class _Open:
    """A list or mapping that is being read; ``key`` is the one whose value comes next."""

    value: Any
    anchor: str | None
    first: int
    mark: Any
    lines: dict[str, int]
    key: str | None = None


class _Builder:
    """Builds the value of one document from its events."""

    def __init__(self, most: int) -> None:
        self.most = most
        self.stack: list[_Open] = []
        self.count = 0
        # Value, how many values it is, and how deeply nested.
        self.anchors: dict[str, tuple[Any, int, int]] = {}
        self.result: Any = None

    def build(self, text: str) -> object:
        """Parse a YAML text and return its content; raises an error for a second document."""
        parser = _PARSER(text)
        documents = 0
        try:
            while (event := parser.get_event()) is not None:
                if isinstance(event, yaml.DocumentStartEvent):
                    documents += 1
                    if documents > 1:
                        raise _FaultError("a second document begins; allowed: one", event.start_mark)
                elif isinstance(event, yaml.NodeEvent | yaml.CollectionEndEvent):
                    self._take(event)
        finally:
            parser.dispose()
        return self.result

    def _take(self, event: Any) -> None:
        """Process one event of the YAML parser (start of a list, scalar, alias and so on)."""
        if isinstance(event, yaml.CollectionEndEvent):
            done = self.stack.pop()
            self._keep(done.anchor, done.value, self.count - done.first)
            self._place(done.value, done.mark)
            return
        mark = event.start_mark
        self._add(1, mark)
        if isinstance(event, yaml.AliasEvent):
            self._place(self._of_alias(event), mark)
        elif isinstance(event, yaml.ScalarEvent):
            value = _scalar(event)
            self._keep(event.anchor, value, 1)
            self._place(value, mark, plain=event.value)
        else:
            self._begin(event, mark)

    def _begin(self, event: Any, mark: Any) -> None:
        """Open a list or mapping; raises an error if it is nested too deeply or has a tag."""
        sequence = isinstance(event, yaml.SequenceStartEvent)
        if event.tag not in (None, "!", _TAG + ("seq" if sequence else "map")):
            _refuse_tag(event.tag, mark)
        if len(self.stack) >= DEEPEST:
            raise _FaultError(f"nested deeper than {DEEPEST} levels", mark)
        if self.stack and isinstance(self.stack[-1].value, dict) and self.stack[-1].key is None:
            raise _FaultError(f"a key is a {'list' if sequence else 'mapping'}; expected a text", mark)
        if event.anchor:
            self.anchors.pop(event.anchor, None)
        self.stack.append(_Open([] if sequence else {}, event.anchor, self.count - 1, mark, {}))

    def _add(self, nodes: int, mark: object) -> None:
        """Count ``nodes`` more values; raises an error if there are too many."""
        self.count += nodes
        if self.count > self.most:
            raise _FaultError(f"more than {self.most} values, those that aliases stand for included", mark)

    def _keep(self, anchor: str | None, value: object, size: int) -> None:
        """Store a value of ``size`` nodes under its anchor, for aliases; do nothing without an anchor."""
        if anchor:
            self.anchors[anchor] = value, size, _depth(value)

    def _of_alias(self, event: Any) -> object:
        """Return an independent copy of the value that an alias names; raises an error for an undefined anchor."""
        name, mark = event.anchor, event.start_mark
        if any(part.anchor == name for part in self.stack) and name not in self.anchors:
            raise _FaultError(f"'*{name}' stands inside of what it stands for", mark)
        if name not in self.anchors:
            raise _FaultError(f"'*{name}' has no '&{name}' before it", mark)
        value, size, depth = self.anchors[name]
        self._add(size - 1, mark)
        if len(self.stack) + depth > DEEPEST:
            raise _FaultError(f"'*{name}': nested deeper than {DEEPEST} levels", mark)
        return _copied(value)

    def _place(self, value: object, mark: object, plain: str = "") -> None:
        """Store a value as the document's result, or in the open list or mapping as an element, key or value;
        ``plain``: its text in the document."""
        if not self.stack:
            self.result = value
            return
        parent = self.stack[-1]
        if isinstance(parent.value, list):
            parent.value.append(value)
        elif parent.key is None:
            self._take_key(parent, value, mark, plain)
        else:
            parent.value[parent.key] = value
            parent.key = None

    def _take_key(self, parent: _Open, key: Any, mark: Any, plain: str) -> None:
        """Store the key of a mapping's next value; raises an error if it is repeated or no text (``plain``: as
        written)."""
        if not isinstance(key, str):
            raise _FaultError(f"the key {plain[:40] or 'null'} is not a text; to make it one, write it in quotes", mark)
        if key == "<<":
            raise _FaultError("'<<' is not supported; write the values out", mark)
        if key in parent.lines:
            raise _FaultError(f"'{key}' is given twice, first in line {parent.lines[key]}", mark)
        parent.lines[key] = mark.line + 1
        parent.key = key


def _depth(value: object) -> int:
    """Return how deeply lists and dicts are nested in a value."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return 0 if parts is None else 1 + max(map(_depth, parts), default=0)


def _copied(value: object) -> object:
    """Return a copy of a value, with all lists and dicts in it copied."""
    if isinstance(value, dict):
        return {key: _copied(part) for key, part in value.items()}
    return [_copied(part) for part in value] if isinstance(value, list) else value


def _scalar(event: Any) -> object:
    """Return the value of a YAML scalar: by its tag, as text if quoted, else by YAML 1.2's rules."""
    tag, text, mark = event.tag, event.value, event.start_mark
    if tag in (None, "!"):
        return _plain(text, mark) if event.implicit[0] and tag is None else text
    kind = tag.removeprefix(_TAG)
    if kind == "str":
        return text
    readers = {
        "null": ((_NULL,), _plain),
        "bool": ((_BOOL,), _plain),
        "int": ((_INT,), _plain),
        "float": ((_FLOAT, _INFINITE, _NAN), lambda text, mark: float(_plain(text, mark))),
    }
    if tag != _TAG + kind or kind not in readers:
        _refuse_tag(tag, mark)
    patterns, read = readers[kind]
    if not any(pattern.fullmatch(text) for pattern in patterns):
        raise _FaultError(f"'{text[:40]}' is not what its tag !!{kind} says", mark)
    return read(text, mark)


def _plain(text: str, mark: object) -> Any:
    """Return the value of unquoted text by the rules of YAML 1.2: null, boolean, number or text."""
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text[0] in "tT"
    if _INT.fullmatch(text):
        if len(text) > MOST_DIGITS:
            raise _FaultError(f"an integer of {len(text)} digits; allowed: up to {MOST_DIGITS}", mark)
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
    if _FLOAT.fullmatch(text):
        return float(text)
    if _INFINITE.fullmatch(text):
        return float(text.replace(".", ""))
    return float("nan") if _NAN.fullmatch(text) else text


def _refuse_tag(tag: str, mark: object) -> NoReturn:
    """Raise an error for a YAML tag that is not supported."""
    shown = f"!!{tag.removeprefix(_TAG)}" if tag.startswith(_TAG) else tag
    raise _FaultError(f"the tag {shown[:60]} is not supported; known: !!str, !!int, !!float, !!bool, !!null", mark)


class _Dumper(yaml.SafeDumper):
    """Quotes what a reader of YAML 1.2, or of 1.1, would not take for a text."""


_Dumper.yaml_implicit_resolvers = {key: list(value) for key, value in yaml.SafeDumper.yaml_implicit_resolvers.items()}
for _first in "-+.0123456789":
    for _kind, _pattern in (("int", _INT), ("float", _FLOAT)):
        _whole = re.compile(f"^(?:{_pattern.pattern})$")
        _Dumper.yaml_implicit_resolvers.setdefault(_first, []).append((f"{_TAG}{_kind}", _whole))


def dump_yaml(content: object) -> str:
    """Return a value as YAML text, from which ``parse_yaml`` reads the same value."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100)


def dump_line(content: object) -> str:
    """Return a value as YAML in one line, without a line break."""
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=True, width=float("inf"))
    return text.rstrip("\n")
