"""Functions of a compiled module around its tick: for many worlds, for states that are kept, for several threads."""

from __future__ import annotations

from collections.abc import Sequence

# Where a thread finds what it needs, its seat: words of 8 bytes. ``arrivals`` (how often a thread came to a place where
# all wait) and ``given_up`` (whether they end before they begin) lie at one place for all; ``pause`` is a function that
# lets the system run something else.
SEAT = ("scratch", "local", "thread", "threads", "arrivals", "given_up", "pause")
# How often a thread looks for the others before it pauses.
_LOOKS = 1000


def head(shared: Sequence[str], seated: bool) -> str:
    """Return the LLVM function's head for running ticks; ``shared``: its pointers, ``seated``: for several threads.

    Args:
        shared: pointers to inputs and working memory.
        seated: whether several threads may run it.
    """
    # No two buffers overlap, which lets LLVM keep loads in registers across stores.
    arguments = [f"ptr noalias {pointer}" for pointer in shared]
    if seated:
        arguments += ["ptr noalias %local", "ptr %seat", "i64 %thread", "i64 %thread.next", "i64 %threads"]
    name = "advance.part" if seated else "advance"
    return f"define void @{name}({', '.join([*arguments, 'i32 %first', 'i32 %count'])}) noinline #0 {{"


def seated(shared: Sequence[str], triple: str) -> list[str]:
    """Return LLVM text for the machine ``triple``: a barrier, and a function that runs ticks from a thread's seat.

    Args:
        shared: pointers to inputs and working memory.
        triple: LLVM's name of the machine.
    """
    processor = triple.split("-")[0]
    resting = {
        "x86_64": ("void @llvm.x86.sse2.pause()", "void @llvm.x86.sse2.pause()"),
        "aarch64": ("void @llvm.aarch64.hint(i32)", "void @llvm.aarch64.hint(i32 1)"),
        "arm64": ("void @llvm.aarch64.hint(i32)", "void @llvm.aarch64.hint(i32 1)"),
    }.get(processor)
    inputs = [f"ptr {pointer}" for pointer in shared[:-1]]
    given = ", ".join([*inputs, "ptr %scratch"])
    return [
        *([f"declare {resting[0]}"] if resting else []),
        # The pointers are arguments so that nothing of what they point to stays in registers.
        f"define internal i1 @wait(ptr %seat, i1 %begins, {given}) noinline nounwind {{",
        "entry:",
        *_loaded("threads", "i64"),
        "  %alone = icmp ule i64 %threads, 1",
        "  br i1 %alone, label %here, label %arrive",
        "arrive:",
        *_loaded("arrivals", "ptr"),
        *_loaded("given_up", "ptr"),
        *_loaded("pause", "ptr"),
        "  %before = atomicrmw add ptr %arrivals, i64 1 acq_rel",
        "  %turn = udiv i64 %before, %threads",
        "  %following = add i64 %turn, 1",
        "  %goal = mul i64 %following, %threads",
        "  %deaf = icmp eq ptr %pause, null",
        "  br label %look",
        "look:",
        f"  %looks = phi i32 [0, %arrive], [%more, %again], [{_LOOKS}, %rest], [{_LOOKS}, %yield]",
        "  %now = load atomic i64, ptr %arrivals acquire, align 8",
        "  %all = icmp uge i64 %now, %goal",
        "  br i1 %all, label %here, label %again",
        "again:",
        *([f"  call {resting[1]}"] if resting else []),
        "  %more = add i32 %looks, 1",
        f"  %often = icmp ult i32 %more, {_LOOKS}",
        "  br i1 %often, label %look, label %late",
        "late:",
        "  %stop = load atomic i64, ptr %given_up acquire, align 8",
        "  %stopped = icmp ne i64 %stop, 0",
        "  %leaves = and i1 %begins, %stopped",
        "  br i1 %leaves, label %leave, label %rest",
        "rest:",
        "  br i1 %deaf, label %look, label %yield",
        "yield:",
        "  call i32 %pause()",
        "  br label %look",
        "here:",
        "  ret i1 true",
        "leave:",
        "  ret i1 false",
        "}",
        f"define void @advance({', '.join(inputs)}, ptr %seat, i32 %first, i32 %count) nounwind {{",
        "entry:",
        *_loaded("scratch", "ptr"),
        *_loaded("local", "ptr"),
        *_loaded("thread", "i64"),
        *_loaded("threads", "i64"),
        "  %thread.next = add i64 %thread, 1",
        f"  %begun = call i1 @wait(ptr %seat, i1 true, {given})",
        "  br i1 %begun, label %run, label %end",
        "run:",
        f"  call void @advance.part({given}, ptr %local, ptr %seat, i64 %thread, i64 %thread.next, i64 %threads, "
        "i32 %first, i32 %count)",
        "  br label %end",
        "end:",
        "  ret void",
        "}",
    ]


def _loaded(name: str, kind: str, seat: str = "%seat") -> list[str]:
    """Return the LLVM lines that load the word ``name`` of a thread's working memory (seat)."""
    return [
        f"  %{name}.place = getelementptr i64, ptr {seat}, i64 {SEAT.index(name)}",
        f"  %{name} = load {kind}, ptr %{name}.place",
    ]


def for_each(pointers: int) -> list[str]:
    """Return the LLVM function that advances the worlds of each row of a table of ``pointers`` buffer addresses.

    In Python the way from one vector of worlds to the next takes as long as a tick of them does.
    """
    arguments = [f"ptr %pointer.{i}" for i in range(pointers)]
    return [
        "define void @advance_each(ptr %table, i64 %rows, ptr %scratch, i32 %first, i32 %count) nounwind {",
        "entry:",
        "  br label %row",
        "row:",
        "  %now = phi i64 [0, %entry], [%next, %row]",
        f"  %begin = mul i64 %now, {pointers}",
        "  %place = getelementptr ptr, ptr %table, i64 %begin",
        *(
            line
            for i in range(pointers)
            for line in (
                f"  %place.{i} = getelementptr ptr, ptr %place, i64 {i}",
                f"  %pointer.{i} = load ptr, ptr %place.{i}",
            )
        ),
        f"  call void @advance({', '.join(arguments)}, ptr %scratch, i32 %first, i32 %count)",
        "  %next = add i64 %now, 1",
        "  %more = icmp ult i64 %next, %rows",
        "  br i1 %more, label %row, label %end",
        "end:",
        "  ret void",
        "}",
    ]


def keeping(pointers: int, seated: bool) -> list[str]:
    """Return the LLVM function that runs ticks and copies the state to a row after each (``seated``: by threads).

    Several threads may run it where their seats are in place of working memory; each copies a part.
    """
    arguments = [f"ptr %pointer.{i}" for i in range(pointers)]
    state = {"floats": pointers - 2, "integers": pointers - 1}
    rows = ", ".join(f"ptr %{kind}, i64 %{kind}.bytes" for kind in state)
    return [
        f"define void @advance_keeping({', '.join(arguments)}, ptr %scratch, i32 %first, i32 %count, {rows}) {{",
        "entry:",
        *(_parts(list(state)) if seated else []),
        "  br label %tick",
        "tick:",
        "  %done = phi i32 [0, %entry], [%next, %tick]",
        "  %now = add i32 %first, %done",
        f"  call void @advance({', '.join(arguments)}, ptr %scratch, i32 %now, i32 1)",
        "  %row = zext i32 %done to i64",
        *(
            line
            for kind, number in state.items()
            for line in (
                f"  %{kind}.begin = mul i64 %row, %{kind}.bytes",
                f"  %{kind}.row = getelementptr i8, ptr %{kind}, i64 %{kind}.begin",
                *_copied(kind, number, seated),
            )
        ),
        # The next tick may overwrite what another thread still copies.
        *([f"  call i1 @wait(ptr %scratch, i1 false, {', '.join(arguments)}, ptr %scratch)"] if seated else []),
        "  %next = add i32 %done, 1",
        "  %more = icmp ult i32 %next, %count",
        "  br i1 %more, label %tick, label %end",
        "end:",
        "  ret void",
        "}",
    ]


def _copied(kind: str, number: int, seated: bool) -> list[str]:
    """Return the LLVM lines that copy state buffer ``number`` (``seated``: a thread's part) to the present row."""
    if not seated:
        return [
            f"  call void @llvm.memcpy.p0.p0.i64(ptr %{kind}.row, ptr %pointer.{number}, i64 %{kind}.bytes, i1 false)"
        ]
    return [
        f"  %{kind}.to = getelementptr i8, ptr %{kind}.row, i64 %{kind}.low",
        f"  %{kind}.from = getelementptr i8, ptr %pointer.{number}, i64 %{kind}.low",
        f"  call void @llvm.memcpy.p0.p0.i64(ptr %{kind}.to, ptr %{kind}.from, i64 %{kind}.size, i1 false)",
    ]


def _parts(kinds: Sequence[str]) -> list[str]:
    """Return the LLVM lines that compute which bytes of the state buffers (``kinds``) a thread copies."""
    lines = [*_loaded("thread", "i64", "%scratch"), *_loaded("threads", "i64", "%scratch")]
    lines.append("  %thread.next = add i64 %thread, 1")
    for kind in kinds:
        for name, turn in (("low", "%thread"), ("high", "%thread.next")):
            lines.append(f"  %{kind}.{name}.all = mul i64 %{kind}.bytes, {turn}")
            lines.append(f"  %{kind}.{name} = udiv i64 %{kind}.{name}.all, %threads")
        lines.append(f"  %{kind}.size = sub i64 %{kind}.high, %{kind}.low")
    return lines
