"""YAML 1.2: what a text means (the tables of https://yaml.org/spec/1.2.2, 10.3.2), and what is refused."""

from __future__ import annotations

import math
import time

import pytest

from qrsim.errors import ScenarioError
from qrsim.files.yaml_text import DEEPEST, MOST_NODES, dump_yaml, parse_yaml
from qrsim.scenarios.scenario import load_scenario


def problem(text: str) -> str:
    began = time.process_time()
    with pytest.raises(ScenarioError) as caught:
        parse_yaml(text, "file")
    assert time.process_time() - began < 2.0
    (found,) = caught.value.problems
    assert len(found) < 300
    return found


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("045", 45), ("010", 10), ("-012", -12), ("+5", 5), ("0o17", 15), ("0x1F", 31), ("0", 0), ("00", 0),
        ("1.", 1.0), (".5", 0.5), ("+.5", 0.5), ("1e3", 1000.0), ("-1.5E-3", -0.0015), ("045.5", 45.5),
        (".inf", math.inf), ("-.INF", -math.inf), ("+.Inf", math.inf),
        ("true", True), ("True", True), ("TRUE", True), ("false", False), ("FALSE", False),
        ("null", None), ("~", None), ("NULL", None), ("", None),
        ("!!int 5", 5), ("!!float 5", 5.0), ("!!str 5", "5"), ("! 5", "5"), ("!!bool true", True), ("!!null ''", None),
    ],
)  # fmt: skip
def test_what_a_text_means(text: str, value: object) -> None:
    found = parse_yaml(f"a: {text}\n", "file")["a"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    "text",
    ["yes", "no", "on", "off", "Yes", "y", "1:30", "190:20:30", "1_000", "0b101", "2001-12-14", "2001-99-99", "0o8",
     "2026-06-21T10:00:00Z", "truE", "nUll", "=", "1e", "e3", ".", "0x", "1.2.3"],
)  # fmt: skip
def test_what_is_a_text(text: str) -> None:
    assert parse_yaml(f"a: {text}\n", "file") == {"a": text}


def test_not_a_number_is_one() -> None:
    assert math.isnan(parse_yaml("a: .NaN", "file")["a"])


def test_keys_that_were_booleans_are_texts() -> None:
    assert parse_yaml("yes: 1\non: 2\nn: 3\n", "file") == {"yes": 1, "on": 2, "n": 3}


def test_what_is_written_is_read_back_as_it_was() -> None:
    texts = ["045", "0o17", "0x1F", "yes", "1:30", "1e3", "1_000", ".inf", "-.INF", "~", "null", "true", "<<", "=", "",
             "2001-01-01", "a\nb\n\n", " x ", "é\u2028x", "# x", "- x", "a: b"]  # fmt: skip
    content = {f"k{i}": text for i, text in enumerate(texts)} | {"045": [45, 1e22, 1e-7, -math.inf, None, True, "1"]}
    assert parse_yaml(dump_yaml(content), "file") == content


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: !!int abc", "line 1, column 4: 'abc' is not what its tag !!int says"),
        ("a: !!bool yes", "'yes' is not what its tag !!bool says"),
        ("a:\n  b: !!timestamp 2001-01-01", "line 2, column 6: the tag !!timestamp is not supported"),
        ("a: !!binary aGk=", "the tag !!binary is not supported"),
        ("a: !!set {x}", "the tag !!set is not supported"),
        ("a: !mine 1", "the tag !mine is not supported"),
        ("a: &a [*a]", "line 1, column 8: '*a' stands inside of what it stands for"),
        ("a: *b", "'*b' has no '&b' before it"),
        ("[" * 2000 + "]" * 2000, f"nested deeper than {DEEPEST} levels"),
        ("- " * 100_000, f"nested deeper than {DEEPEST} levels"),
        ("a: " + "9" * 5000, "an integer of 5000 digits; allowed: up to 100"),
        ("a: 1\n---\nb: 2", "line 2, column 1: a second document begins"),
        ("? [1]\n: 2", "a key is a list; expected a text"),
        ("a:\n  b: 'x\0'", "line 2, column 8: the character #x0000 is not allowed"),
        ("[" + "1," * 2 * MOST_NODES + "]", f"more than {MOST_NODES} values"),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    assert words in problem(text)


def test_aliases_count_as_what_they_stand_for() -> None:
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    assert "aliases stand for included" in problem("\n".join(rows))
    levels = ["a0: &a0 [x]"] + [f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 2 * DEEPEST)]
    assert f"nested deeper than {DEEPEST} levels" in problem("\n".join(levels))


@pytest.mark.long
def test_what_the_program_wrote_itself_may_be_larger_but_for_aliases() -> None:
    """Content from Python is not limited to what files may hold, and its run is read again."""
    text = "[" + "1," * (MOST_NODES + 1) + "]"
    assert f"more than {MOST_NODES} values" in problem(text)
    assert len(parse_yaml(text, "text", own=True)) == MOST_NODES + 1
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    with pytest.raises(ScenarioError, match="aliases stand for included"):
        parse_yaml("\n".join(rows), "text", own=True)


def test_what_an_alias_stands_for_is_a_copy() -> None:
    """An override of one fleet leaves the other as it was."""
    fleet = "{controller: {type: waypoint, feed: truth}, vehicle: &v {type: pelican, mass: 1.5}"
    text = f"name: x\nfleets:\n  a: {fleet}, vehicles: [{{position_ned: [0, 0, -9]}}]}}\n"
    text += "  b: {controller: {type: waypoint, feed: truth}, vehicle: *v, vehicles: [{position_ned: [9, 0, -9]}]}\n"
    loaded = load_scenario(parse_yaml(text, "file"), ["fleets.a.vehicle.mass=1.7"])
    assert [loaded.spec.fleets[name].vehicle.mass for name in "ab"] == [1.7, 1.5]


def test_a_bearing_with_a_leading_zero_is_decimal() -> None:
    wind = load_scenario("patrol_plain", ["world.wind.wind_from_deg=045"]).spec.world.wind
    assert wind.wind_from_rad == pytest.approx(math.pi / 4)
    with pytest.raises(ScenarioError, match="'1:30' is not a number"):
        load_scenario("patrol_plain", ["world.wind.wind_from_deg=1:30"])


def test_words_for_true_and_false_get_a_hint() -> None:
    with pytest.raises(ScenarioError, match=r"'yes' is neither true nor false .*; did you mean true"):
        load_scenario("patrol_plain", ["fleets.pelicans.guidance.repeat=yes"])
