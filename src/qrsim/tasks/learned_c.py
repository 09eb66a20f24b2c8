"""Learned policies as a C file without dependencies, for flight computers: ``qrsim export POLICY.npz --format c``."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

from qrsim.tasks.learned import LIMIT, MOST_SUM, SHORTEST, PolicyFile

# The computation; all that differs between policies is in the tables in front of it.
FLY = """\
static float limited(float value, float limit) { return value > limit ? limit : value < -limit ? -limit : value; }

/* From an observation and what is remembered, which begins as zeros and is replaced, to an action in [-1, 1]. */
void qrsim_policy(const float observation[OBSERVED], float last[REMEMBERED], float action[ACTED])
{
    float seen[OBSERVED + SUMMED], one[WIDEST], other[WIDEST], *from = one, *to = other;
    for (int i = 0; i < OBSERVED; i++) seen[i] = observation[i];
    for (int i = 0; i < SUMMED; i++) seen[OBSERVED + i] = last[FLOWN + i];
    const float to_north = observation[AHEAD_NORTH], to_east = observation[AHEAD_EAST];
    const float range = fmaxf(sqrtf(to_north * to_north + to_east * to_east), SHORTEST);
    const float c = AHEAD ? to_north / range : cosf(observation[YAW]);
    const float s = AHEAD ? to_east / range : sinf(observation[YAW]);
    for (int i = 0; i < PAIRS; i++) {
        const float north = seen[pairs[i][0]], east = seen[pairs[i][1]];
        seen[pairs[i][0]] = c * north + s * east;
        seen[pairs[i][1]] = c * east - s * north;
    }
    for (int i = 0; i < INPUTS; i++) {
        const float input = i < INPUTS - FLOWN ? seen[kept[i]] : last[i - (INPUTS - FLOWN)];
        from[i] = limited((input - mean[i]) / deviation[i], LIMIT);
    }
    for (int layer = 0; layer < LAYERS; layer++) {
        for (int j = 0; j < sizes[layer + 1]; j++) {
            float sum = offsets[layer][j];
            for (int i = 0; i < sizes[layer]; i++) sum += from[i] * weights[layer][i * sizes[layer + 1] + j];
            to[j] = layer < LAYERS - 1 ? tanhf(sum) : sum;
        }
        float *swapped = from; from = to; to = swapped;
    }
    for (int i = 0; i < FLOWN; i++) last[i] = limited(from[i], LIMIT);
    for (int i = 0; i < SUMMED; i++) {
        last[FLOWN + i] = limited(last[FLOWN + i] + SECONDS * observation[summed[i]], MOST_SUM);
    }
    float out[FLOWN];
    for (int i = 0; i < FLOWN; i++) out[i] = last[i];
    if (TURNED) {
        out[TURNED_AHEAD] = c * last[TURNED_AHEAD] - s * last[TURNED_RIGHT];
        out[TURNED_RIGHT] = s * last[TURNED_AHEAD] + c * last[TURNED_RIGHT];
    }
    for (int i = 0; i < ACTED; i++) action[i] = limited(centre[i], 1.0f);
    for (int i = 0; i < FLOWN; i++) action[flown[i]] = limited(centre[flown[i]] + reach[flown[i]] * out[i], 1.0f);
}
"""


def c_source(file: PolicyFile) -> str:
    """Return a learned policy as the text of a C99 file with one function, ``qrsim_policy``."""
    view = file.view
    ahead, turned = view.ahead or (0, 0), view.turned or (0, 0)
    sizes = [view.inputs, *(len(offset) for _, offset in file.layers)]
    named = ", ".join(view.observed), ", ".join(view.acts)
    head = [
        f"Policy for {view.task} (version {view.version}), written by qrsim export.",
        f"Call it every {view.seconds:g} s. It needs libm and no memory but its arguments.",
        f"Observation: {named[0]}.",
        f"Action: {named[1]}.",
    ]
    # A comment cannot end inside one of its lines.
    comment = "\n".join(textwrap.fill(" ".join(line.split()), 116).replace("*/", "* /") for line in head)
    numbers: dict[str, int] = {
        "OBSERVED": len(view.observed),
        "ACTED": len(view.acts),
        "FLOWN": len(view.flown),
        "SUMMED": len(view.summed),
        "REMEMBERED": view.remembered,
        "INPUTS": view.inputs,
        "PAIRS": 0 if view.yaw is None and view.ahead is None else len(view.pairs),
        "YAW": view.yaw or 0,
        "AHEAD": int(view.ahead is not None),
        "AHEAD_NORTH": ahead[0],
        "AHEAD_EAST": ahead[1],
        "TURNED": int(view.turned is not None),
        "TURNED_AHEAD": turned[0],
        "TURNED_RIGHT": turned[1],
        "LAYERS": len(file.layers),
        "WIDEST": max(sizes),
    }
    tables = [
        # C has no arrays of length zero.
        _table("int", "pairs", [each for pair in view.pairs or ((0, 0),) for each in pair], "[][2]", 2),
        _table("int", "kept", list(view.kept) or [0]),
        _table("int", "flown", view.flown),
        _table("int", "summed", list(view.summed) or [0]),
        _table("int", "sizes", sizes),
        _table("float", "centre", view.centre),
        _table("float", "reach", view.reach),
        _table("float", "mean", file.scaling.mean),
        _table("float", "deviation", file.scaling.deviation),
    ]
    for number, (weights, offset) in enumerate(file.layers):
        tables += [_table("float", f"weights_{number}", weights.ravel()), _table("float", f"offset_{number}", offset)]
    for name, part in (("weights", "weights"), ("offsets", "offset")):
        which = ", ".join(f"{part}_{number}" for number in range(len(file.layers)))
        tables.append(f"static const float *const {name}[] = {{{which}}};")
    enum = ", ".join(f"{name} = {value}" for name, value in numbers.items())
    given = {"LIMIT": LIMIT, "SHORTEST": SHORTEST, "MOST_SUM": MOST_SUM, "SECONDS": view.seconds}
    limit = "\n".join(f"#define {name} {_float(value)}" for name, value in given.items())
    return "\n".join([f"/* {comment} */", "#include <math.h>", "", f"enum {{ {enum} }};", limit, *tables, "", FLY])


def _table(kind: str, name: str, values: Any, rank: str = "[]", group: int = 1) -> str:
    """Return the C definition of a constant array; ``kind``: C type, ``rank``: dimensions, ``group``: last size."""
    shown = [_float(value) if kind == "float" else str(int(value)) for value in values]
    if group > 1:
        shown = [f"{{{', '.join(shown[at : at + group])}}}" for at in range(0, len(shown), group)]
    body = textwrap.fill(", ".join(shown), 116, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name}{rank} = {{\n{body}\n}};"


def _float(value: Any) -> str:
    """Return a number as a C constant of type float that reads back exactly."""
    text = np.format_float_scientific(np.float32(value), unique=True)
    return f"{text}f"
