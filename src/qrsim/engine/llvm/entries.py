"""Functions of a compiled module that call its tick: for many worlds, and for one whose states are kept."""

from __future__ import annotations


def for_each(pointers: int) -> list[str]:
    """Write the function that advances the worlds of each row of a table of addresses, one row after the other.

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


def keeping(pointers: int) -> list[str]:
    """Write the function that copies the state, the last two pointers, after each tick to the next of some rows."""
    arguments = [f"ptr %pointer.{i}" for i in range(pointers)]
    state = {"floats": pointers - 2, "integers": pointers - 1}
    rows = ", ".join(f"ptr %{kind}, i64 %{kind}.bytes" for kind in state)
    return [
        f"define void @advance_keeping({', '.join(arguments)}, ptr %scratch, i32 %first, i32 %count, {rows}) {{",
        "entry:",
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
                f"  call void @llvm.memcpy.p0.p0.i64(ptr %{kind}.row, ptr %pointer.{number}, "
                f"i64 %{kind}.bytes, i1 false)",
            )
        ),
        "  %next = add i32 %done, 1",
        "  %more = icmp ult i32 %next, %count",
        "  br i1 %more, label %tick, label %end",
        "end:",
        "  ret void",
        "}",
    ]
