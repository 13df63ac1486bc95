"""A policy as plain C without dependencies (C99 and libm): what a controller on a car or a bench compiles in.

The memory, the estimate and the network are written out as numbers; a step allocates nothing and takes a fixed number of
operations. The header says inputs, units, order and step.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym.env import MEASURED
from isd_gym.files import make_folder, write_text

from .policy import CURRENT_SIGNAL, Policy

if TYPE_CHECKING:
    from pathlib import Path

HEADER = """\
/* Policy {name}: {origin}.
 *
 * One call of {id}_step every {step:g} s with what was measured at its end; it returns the commanded current [A],
 * within +-{limit:g} A. The drive slews it by 0.5 A a step.
 *
 * observation, float, SI units, in this order:
{order}
 *
 * A reading that is not finite counts as 0. {id}_reset before the first step and whenever a drive begins anew.
 */
#ifndef {ID}_H
#define {ID}_H

#define {ID}_SIGNALS {signals}
#define {ID}_FEATURES {features}
#define {ID}_STEP {step:.9g}

typedef struct {{
    float features[{ID}_FEATURES];
    float wanted; /* A, of the law that the estimate follows */
    int begun;
}} {id}_state;

void {id}_reset({id}_state *s);
float {id}_step({id}_state *s, const float observation[{ID}_SIGNALS]);

#endif
"""


def _number(value: Any) -> str:
    text = f"{float(np.float32(value)):.9g}"
    return f"{text if re.search('[.e]', text) else text + '.0'}f"


def _array(name: str, values: Any) -> str:
    flat = [_number(v) for v in np.asarray(values).ravel()]
    lines = [", ".join(flat[i : i + 8]) for i in range(0, len(flat), 8)]
    return f"static const float {name}[{len(flat)}] = {{\n    " + ",\n    ".join(lines) + "};\n"


def export_c(policy: Policy, folder: str | Path) -> tuple[Path, Path]:
    """Write `policy` as NAME.h and NAME.c into `folder`, which is made; their paths.

    Arithmetic is that of `Policy`, in float: commands agree to rounding. Raises `InputError` where nothing can be written.
    """
    folder = make_folder(folder)
    name = re.sub(r"\W", "_", policy.name, flags=re.ASCII)
    name = name if name[:1].isalpha() else f"policy_{name}"
    header, source = folder / f"{name}.h", folder / f"{name}.c"
    write_text(header, _header(policy, name))
    write_text(source, _source(policy, name))
    return header, source


def _header(policy: Policy, name: str) -> str:
    n, ahead, step = policy.signals, policy.memory.ahead, policy.memory.step
    known = [f"{signal} [{unit}]" for signal, unit, _ in MEASURED] if n == len(MEASURED) else []
    order = [f" *   {i}: {known[i] if known else 'signal'}" for i in range(n)]
    if ahead:
        order.append(
            f" *   {n} to {n + ahead - 1}: height of the road above that under the wheel [m], "
            f"{step:g} s, {2 * step:g} s, ... {ahead * step:g} s ahead"
        )
    training = policy.info.get("training")
    command = training.get("command") if isinstance(training, dict) else None
    # what a file says of itself may not end the comment it stands in
    origin = re.sub(r"[^ -~]|[*/\\]", " ", str(command or "a policy folder"))
    return HEADER.format(
        name=name,
        id=name,
        ID=name.upper(),
        origin=origin,
        step=step,
        limit=policy.head.limit,
        order="\n".join(order),
        signals=n + ahead,
        features=policy.weights[0][0].shape[1],
    )


def _source(policy: Policy, name: str) -> str:
    memory, n = policy.memory, policy.signals
    recall = memory.start(np.zeros((1, n + memory.ahead), np.float32))
    constants = [_array("scale", recall.scale)]
    see = [f"    float now[{n}];", f"    for (int i = 0; i < {n}; i++) now[i] = y[i] / scale[i];"]
    for k, ratio in enumerate(recall.ratios):
        constants.append(_array(f"ratio{k}", np.broadcast_to(ratio, n)))
        see.append(
            f"    for (int i = 0; i < {n}; i++) {{\n        const float was = f[{n * k} + i];\n"
            f"        f[{n * k} + i] = now[i];\n        now[i] = (now[i] - was) * ratio{k}[i];\n    }}"
        )
    see.append(f"    for (int i = 0; i < {n}; i++) f[{n * memory.order} + i] = now[i];")
    at = n * (memory.order + 1)
    for j, (i, keep, gain) in enumerate(recall.leaks, at):
        see.append(f"    f[{j}] = f[{j}] * {_number(keep)} + y[{i}] * {_number(gain)};")
    road = at + len(recall.leaks)
    rises = ""
    if memory.ahead:
        rises = (
            f"    for (int i = 0; i < {memory.ahead}; i++)\n        f[{road} + i] = y[{n} + i] / {_number(memory.rise)} - "
            f"(i > 0 ? y[{n} + i - 1] / {_number(memory.rise)} : 0.0f);"
        )
        if recall.filter is not None and recall.filter.given.road:
            see.append(f"    const float risen = f[{road}] * {_number(memory.rise)};")
        see.append(rises)
    if recall.filter is not None:
        made, lines = _filter(recall.filter, road + memory.ahead, road, memory)
        constants += made
        see += lines
    constants += [_array("mean", policy.mean), _array("spread", policy.scale)]
    for i, (w, b) in enumerate(policy.weights):
        constants += [_array(f"weight{i}", w), _array(f"bias{i}", b)]
    begin = [f"    for (int i = 0; i < {n}; i++) f[i] = y[i] / scale[i];", *([rises] if rises else [])]
    return "\n".join(
        [
            f'#include "{name}.h"\n#include <math.h>\n#include <string.h>\n',
            *constants,
            "static float limited(float x, float low, float high) { return x < low ? low : x > high ? high : x; }\n",
            f"void {name}_reset({name}_state *s) {{ memset(s, 0, sizeof *s); }}\n",
            f"static void begin({name}_state *s, const float *y) {{\n    float *f = s->features;",
            *begin,
            "}\n",
            f"static void see({name}_state *s, const float *y) {{\n    float *f = s->features;",
            *see,
            "}\n",
            *_network(policy),
            f"float {name}_step({name}_state *s, const float observation[{name.upper()}_SIGNALS]) {{",
            f"    float y[{name.upper()}_SIGNALS];",
            f"    for (int i = 0; i < {name.upper()}_SIGNALS; i++) y[i] = isfinite(observation[i]) ? observation[i] : 0.0f;",
            "    if (s->begun) see(s, y); else begin(s, y);",
            "    s->begun = 1;",
            "    const float share = network(s->features);",
            *_head(policy),
            "}\n",
        ]
    )


def _filter(filter: Any, at: int, road: int, memory: Any) -> tuple[list[str], list[str]]:
    """The estimate and the law behind it, whose features begin at `at`: constants, and lines of `see`."""
    given, n, nf, ny = filter.given, filter.n, filter.nf, filter.ny
    # columns of each product lie side by side
    constants = [
        _array("filter_free", filter.free.T),
        _array("filter_gain", filter.gain.T),
        _array("filter_rows", filter.rows.T),
    ]
    lines = [
        f"    float x[{n + 1}], z[{n}];",
        f"    for (int i = 0; i < {n}; i++) x[i] = f[{at} + i];",
        f"    x[{n}] = y[{given.current}];",
    ]
    seen = bool(memory.ahead and given.road)
    if nf:
        constants += [_array("filter_stick", filter.stick.T), _array("filter_force", filter.force.T)]
        constants += [_array("filter_road_stick", filter.road_stick)] if seen else []
        known = " + risen * filter_road_stick[j]" if seen else ""
        lines += [
            f"    float rest[{nf}], held[{nf}];",
            f"    for (int j = 0; j < {nf}; j++) {{\n        float t = 0.0f;",
            f"        for (int i = 0; i < {n + 1}; i++) t += x[i] * filter_stick[j * {n + 1} + i];",
            f"        rest[j] = t{known};\n        held[j] = limited(rest[j], -1.0f, 1.0f);\n    }}",
        ]
    if nf > 1:
        constants.append(_array("filter_others", filter.others.T))
        lines += [
            f"    for (int sweep = 0; sweep < 2; sweep++)\n        for (int j = 0; j < {nf}; j++) {{",
            "            float t = rest[j];",
            f"            for (int i = 0; i < {nf}; i++) t -= held[i] * filter_others[j * {nf} + i];",
            "            held[j] = limited(t, -1.0f, 1.0f);\n        }",
        ]
    lines += [
        f"    for (int k = 0; k < {n}; k++) {{\n        float t = 0.0f;",
        f"        for (int i = 0; i < {n + 1}; i++) t += x[i] * filter_free[k * {n + 1} + i];",
    ]
    if nf:
        lines.append(f"        for (int j = 0; j < {nf}; j++) t += held[j] * filter_force[k * {nf} + j];")
    lines.append(f"        for (int i = 0; i < {ny}; i++) t += y[i] * filter_gain[k * {ny} + i];")
    if seen:
        constants.append(_array("filter_road", filter.road))
        lines.append("        t += risen * filter_road[k];")
    lines += ["        z[k] = t;\n    }", f"    for (int k = 0; k < {n}; k++) f[{at} + k] = z[k];"]
    if nf:
        lines.append(f"    for (int j = 0; j < {nf}; j++) f[{at + n} + j] = held[j];")
    lines += [
        "    float law = 0.0f, rate = 0.0f;",
        f"    for (int k = 0; k < {n}; k++) {{\n        law += z[k] * filter_rows[k];\n        rate += z[k] * filter_rows[{n} + k];\n    }}",
    ]
    points = len(filter.ahead)
    if memory.ahead and points:
        constants.append(_array("filter_ahead", filter.ahead.T))
        lines += [
            "    float law_ahead = 0.0f, rate_ahead = 0.0f;",
            f"    for (int i = 0; i < {points}; i++) {{\n        law_ahead += f[{road} + i] * filter_ahead[i];",
            f"        rate_ahead += f[{road} + i] * filter_ahead[{points} + i];\n    }}",
            f"    law += law_ahead * {_number(memory.rise)};\n    rate += rate_ahead * {_number(memory.rise)};",
        ]
    reach = _number(given.reach)
    lines += [
        f"    s->wanted = law - {_number(given.force)} * tanhf(rate);",
        f"    f[{at + n + nf}] = limited((s->wanted - y[{given.current}]) / {_number(given.slew)}, -{reach}, {reach});",
    ]
    return constants, lines


def _network(policy: Policy) -> list[str]:
    inputs = policy.weights[0][0].shape[1]
    widest = max(inputs, *(w.shape[0] for w, _ in policy.weights))
    squash = {"tanh": "tanhf(t)", "relu": "t > 0.0f ? t : 0.0f"}[policy.activation]
    lines = [
        "static float network(const float *f) {",
        f"    float a[{widest}], b[{widest}];",
        f"    for (int i = 0; i < {inputs}; i++) {{\n        const float x = (f[i] - mean[i]) / spread[i];",
    ]
    clip = _number(policy.clip) if np.isfinite(policy.clip) else ""
    lines.append(f"        a[i] = {f'limited(x, -{clip}, {clip})' if clip else 'x'};\n    }}")
    have, other = "a", "b"
    for k, (w, _) in enumerate(policy.weights):
        rows, columns = w.shape
        last = k == len(policy.weights) - 1
        lines += [
            f"    for (int r = 0; r < {rows}; r++) {{\n        float t = 0.0f;",
            f"        for (int i = 0; i < {columns}; i++) t += {have}[i] * weight{k}[r * {columns} + i];",
            f"        t += bias{k}[r];\n        {other}[r] = {'t' if last else squash};\n    }}",
        ]
        have, other = other, have
    out = f"tanhf({have}[0])" if policy.output == "tanh" else f"limited({have}[0], -1.0f, 1.0f)"
    return [*lines, f"    return {out};", "}\n"]


def _head(policy: Policy) -> list[str]:
    head, limit = policy.head, _number(policy.head.limit)
    if head.mode == "target":
        return [f"    return share * {limit};"]
    if head.mode == "increment":
        wanted = f"y[{CURRENT_SIGNAL}] + share * {_number(head.slew)}"
        return [f"    return limited({wanted}, -{limit}, {limit});"]
    last = policy.weights[0][0].shape[1] - 1
    return [
        f"    float *offset = s->features + {last};",
        f"    *offset = *offset * {_number(head.keep)} + {_number(head.gain)} * share;",
        f"    return limited(s->wanted + *offset, -{limit}, {limit});",
    ]
