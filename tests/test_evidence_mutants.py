"""The finder of numbers, its rules, and the record of the mutation study."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import nullcontext

import pytest
from evidence import _mutant_names as naming
from evidence import _mutant_tests as choosing
from evidence import _mutants as mutants
from evidence import mutation

EXAMPLE = '''"""A module of 3 numbers."""
GRAVITY = 9.81


class Wing:
    """Wings have 2 tips."""

    area: float = parameter(default=0.5, minimum=0.0, doc="one of 4")

    def lift(self, speed, n: Literal[7] = 3):
        """Return 5."""
        rows = jnp.zeros((6, n), float)
        first = rows[1] + rows[:, 2 : n - 8].sum(axis=-1)
        safe = jnp.maximum(speed, 1e-12) + jnp.maximum(speed, 0.3)
        return f"{speed + 11:.3f}", 0.7 * safe**2 * speed**1.5, -2.25
'''


def _written(rule: str) -> list[str]:
    return [item.text for item in mutants.literals(EXAMPLE, "qrsim/models/wing.py") if item.rule == rule]


@pytest.mark.parametrize(
    ("rule", "texts"),
    [
        ("", ["9.81", "0.5", "3", "0.3", "0.7", "1.5", "2.25"]),
        ("zero", ["0.0"]),
        ("annotation", ["7"]),
        ("shape", ["6"]),
        ("index", ["1", "2", "8"]),
        ("axis", ["1"]),
        ("tolerance", ["1e-12"]),
        ("exponent", ["2"]),
    ],
)
def test_rules(rule: str, texts: list[str]) -> None:
    assert _written(rule) == texts


def test_a_number_in_a_formatted_text_is_no_mutant() -> None:
    assert [item.rule for item in mutants.literals('f"{speed + 11:.3f}"', "a.py")] == ["message"]


@pytest.mark.parametrize(
    ("text", "left_out"),
    [
        ("where(c > 0, a / where(c > 0, b, 1.5), 2.5)", ["1.5"]),
        ("where(c > 0, 2.5, sqrt(where(c > 0, -1.5, b)))", ["1.5"]),
        ("where(c > 0, a / where(d > 0, b, 1.5), 2.5)", []),
        ("where(c > 0, where(c > 0, 1.5, b), 2.5)", []),
        ("where(c > 0, a / where(c > 0, b, 1.5 + d), 2.5)", []),
        ("where(c > 0, a / maximum(b, 1.5), 2.5)", []),
    ],
)
def test_a_value_that_its_own_condition_throws_away_is_no_mutant(text: str, left_out: list[str]) -> None:
    assert [item.text for item in mutants.literals(text, "a.py") if item.rule == "stand-in"] == left_out


@pytest.mark.parametrize(
    ("text", "larger", "sign"),
    [
        ("0.5", "0.6", "(-0.5)"),
        ("10", "12", "(-10)"),
        ("1", "2", "(-1)"),
        ("2", "3", "(-2)"),
        ("1e3", "1200.0", "(-1e3)"),
    ],
)
def test_what_a_literal_is_changed_to(text: str, larger: str, sign: str) -> None:
    assert mutants.changed(text, "larger") == larger
    assert mutants.changed(text, "sign") == sign


def test_bounds_are_told_from_other_numbers() -> None:
    text = "x: float = parameter(default=0.5, minimum=0.1, maximum=-2.0, above=3)"
    assert [item.kind for item in mutants.literals(text, "a.py")] == ["module", "bound", "bound", "bound"]


def test_one_place_is_changed() -> None:
    found = {str(item): item for item in mutants.mutants_of(EXAMPLE, "qrsim/models/wing.py")}
    mutant = found["src/qrsim/models/wing.py:15: 2.25 -> (-2.25) in `" + EXAMPLE.splitlines()[14].strip() + "`"]
    assert mutant.literal.owner == "Wing.lift"
    before, after = EXAMPLE.splitlines(), mutants.mutated(EXAMPLE, mutant).splitlines()
    assert [k for k, (old, new) in enumerate(zip(before, after, strict=True), 1) if old != new] == [15]
    assert after[14].endswith(", -(-2.25)")


def test_a_key_outlives_edits_of_other_lines() -> None:
    """Two lines with the same text have keys of their own."""
    text = "a = 2.0\nb = 3.0\na = 2.0\n"
    before = [item.key for item in mutants.mutants_of(text, "a.py")]
    assert len(set(before)) == 6
    assert [item.key for item in mutants.mutants_of("# moved down\n" + text, "a.py")] == before


def test_mutants_of_the_package() -> None:
    found = mutants.all_mutants()
    # The limit of a controller's yaw rate, and the drift of the barometer.
    texts = {(item.literal.file, item.literal.text) for item in found}
    assert ("qrsim/control/controllers.py", "4.4") in texts
    assert ("qrsim/models/sensors/barometer.py", "0.26") in texts
    assert len(found) > 5000
    assert len({item.key for item in found}) == len(found)
    left_out = mutants.left_out()
    assert left_out["zero"] > 1000
    assert set(left_out) == set(mutants.EXCLUDED)
    assert mutants.sample(found, 5, 1) == mutants.sample(found, 5, 1) != mutants.sample(found, 5, 2)


def test_an_equivalent_mutant_is_one_of_the_source() -> None:
    """A line that is edited takes its entry with it."""
    sources = {file: (mutants.SOURCE / file).read_text("utf-8") for file in mutants.files()}
    for (file, text, column, mutation_name), reason in mutants.EQUIVALENT.items():
        assert text in {line.strip() for line in sources[file].splitlines()}, (file, text)
        written = [
            item
            for item in mutants.literals(sources[file], file)
            if (line := sources[file].splitlines()[item.line - 1]).strip() == text
            and item.column - (len(line) - len(line.lstrip())) == column
        ]
        assert written, (file, text, column)
        assert mutation_name in mutants.MUTATIONS
        assert len(reason) > 10


def test_record_is_resumed(tmp_path, monkeypatch) -> None:
    """The last line of a mutant counts, and a line that was cut off does not."""
    path = tmp_path / "mutation.jsonl"
    gust = [item for item in mutants.all_mutants() if item.literal.file == "qrsim/models/atmosphere/gust.py"]
    first, second, third = gust[:3]
    lines = [
        {"key": first.key, "result": "survivor", "killer": ""},
        {"key": second.key, "result": "killed", "killer": "tests/conftest.py::a"},
        {"key": first.key, "result": "killed", "killer": "tests/conftest.py::b"},
        {"key": ["qrsim/models/gone.py", "x = 1.0", 0, 4, "sign"], "result": "survivor", "killer": ""},
    ]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines) + '{"key": ["qrs', "utf-8")
    counts = mutation.counted(path)
    assert (counts["tried"], counts["killed"], counts["survivors"]) == (2, 2, 0)
    mutation.tidy(path)
    assert len(path.read_text("utf-8").splitlines()) == 2
    assert mutation.nearby(third, mutation.recorded(path)) == [
        "tests/conftest.py::a",
        "tests/conftest.py::b",
    ]
    monkeypatch.setattr(mutation, "workshop", lambda: pytest.fail("nothing is left to be tried"))
    mutation.study([first, second], pytest.fail, path)


def test_what_escaped_is_no_verdict(tmp_path) -> None:
    path = tmp_path / "mutation.jsonl"
    first = mutants.all_mutants()[0]
    path.write_text(json.dumps({"key": first.key, "result": "escaped", "killer": ""}) + "\n", "utf-8")
    counts = mutation.counted(path)
    assert (counts["tried"], counts["escaped"], counts["survivors"]) == (0, 1, 0)
    assert mutation.survivors(path) == [first]
    # Nor does it take back what another process has found meanwhile; a survivor does.
    for result, killed in (("killed", 1), ("escaped", 1), ("survivor", 0)):
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": first.key, "result": result, "killer": "tests/conftest.py::a"}) + "\n")
        assert mutation.counted(path)["killed"] == killed


def test_a_kill_by_a_file_that_is_gone_is_no_verdict(tmp_path, monkeypatch) -> None:
    path = tmp_path / "mutation.jsonl"
    first = mutants.all_mutants()[0]
    path.write_text(json.dumps({"key": first.key, "result": "killed", "killer": "tests/gone.py::test"}) + "\n", "utf-8")
    counts = mutation.counted(path)
    assert (counts["tried"], counts["escaped"]) == (0, 1)
    monkeypatch.setattr(mutation, "workshop", nullcontext)
    assert mutation.again([first], path)["untried"] == [str(first)]


def test_wrong_shards_are_refused(capsys) -> None:
    for text in ("0/2", "3/2", "half"):
        with pytest.raises(SystemExit) as ended:
            mutation.main(["--shard", text])
        assert ended.value.code == 2
        assert f"'{text}' is no part: wanted K/N with K from 1 to N" in capsys.readouterr().err


def test_tests_that_enter_a_function_come_first() -> None:
    """Those with the module's name before all, the quick before the slow, and who never enters it is left out."""
    barometer = "qrsim/models/sensors/barometer.py"
    enters = frozenset({(barometer, "Barometer.step")})
    known = {
        "tests/laws/test_components.py::test_a": choosing.Measured(90.0, enters),
        "tests/laws/test_resume.py::test_b": choosing.Measured(9.0, enters),
        "tests/models/sensors/test_barometer.py::test_c": choosing.Measured(99.0, enters),
        "tests/models/radio/test_links.py::test_d": choosing.Measured(1.0, frozenset()),
        "tests/control/test_guidance.py::test_e": choosing.Measured(1.0, frozenset({(barometer, "Barometer.init")})),
    }
    literal = mutants.Literal(barometer, 1, 4, "1.0", "Barometer.step", "function", "")
    ordered = choosing.candidates(literal, known)
    assert ordered == [
        "tests/models/sensors/test_barometer.py::test_c",
        "tests/laws/test_resume.py::test_b",
        "tests/laws/test_components.py::test_a",
    ]
    assert choosing.batches(ordered, known) == [[test] for test in ordered]
    quick = {test: item._replace(seconds=1.0) for test, item in known.items()}
    assert choosing.batches(ordered, quick) == [ordered]


def test_who_computes_with_a_constant() -> None:
    """Functions that mention its name, or that of what is made of it, in its module and those that import that."""
    file = "qrsim/models/vehicles/quadrotor.py"
    found = next(item for item in mutants.all_mutants() if (item.literal.file, item.literal.text) == (file, "0.025"))
    assert "PITCH_ROLL_RAD_PER_RAW" in naming.defined(found.literal)
    assert any(place == file for place, _ in naming.computing(found.literal))
    inside = next(
        item for item in mutants.all_mutants() if item.literal.file == file and item.literal.kind == "function"
    )
    assert (file, inside.literal.owner) in naming.computing(inside.literal)


def test_constants_that_importing_does_not_compute_with() -> None:
    """By hand: 0.1 m is used in a function alone; the defaults of a class hold what its presets said."""
    found = {item.key[:2]: item.literal for item in mutants.all_mutants()}
    clear = naming.constants(found["qrsim/models/sensors/neighbours.py", "_CLEAR = 0.1"])
    assert clear is not None
    assert [sorted(item.names) for item in clear] == [["_CLEAR"]]
    preset = next(
        item.literal for item in mutants.all_mutants() if item.literal.file == "qrsim/models/sensors/imu_presets.py"
    )
    assert naming.constants(preset._replace(kind="module")) is None


IN_FORKS = """
from evidence._mutant_forks import collected
from evidence._mutant_runs import workshop
from evidence._mutants import all_mutants

TEST = "tests/models/atmosphere/test_gust.py"

def work(process):
    tests = list(process.items)
    plain = process.run(tests[:3], 60, watched=True)
    found = {True: [], False: []}
    for mutant in all_mutants():
        if mutant.literal.file == "qrsim/models/atmosphere/gust.py":
            found[process.is_for_this(mutant)].append(mutant)
    results = [process.run(tests, 60, mutant) for mutant in found[True][:2]]
    entered = ("qrsim/models/atmosphere/gust.py", "DiscreteGust.velocity_ned") in plain.entered
    after = process.run(tests[:3], 60)
    kinds = sorted({mutant.literal.kind for mutant in found[False]})
    print("told:", plain.result, entered, [item.result for item in results], results[0].killer, after.result, kinds)

with workshop() as shop:
    collected(shop, [TEST], work)
"""


@pytest.mark.long
def test_a_fork_computes_with_the_mutant_and_the_next_one_does_not() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IN_FORKS], cwd=mutants.ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    told = next(line for line in done.stdout.splitlines() if "told:" in line)
    assert "told: survivor True ['killed', 'killed'] tests/models/atmosphere/test_gust.py::" in told, told
    assert told.endswith(" survivor ['bound', 'class']"), told
