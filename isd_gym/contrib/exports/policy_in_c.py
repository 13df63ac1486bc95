"""A policy as plain C without dependencies (C99 and libm), for a controller on a car or a bench.

Memory, estimate and network are written as numbers. A step allocates nothing and has a fixed number of
operations. The header documents inputs, units, order and step.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.files import make_folder, write_text
from isd_gym.physics._vehicle import vehicle
from isd_gym.physics.network import Network

if TYPE_CHECKING:
    from pathlib import Path

    from isd_gym.agents._memory import Memory, Recall
    from isd_gym.agents.policy import Policy

HEADER = """\
/* Policy {name}: {origin}.
 *
 * One call of {id}_step every {step:g} s with what was measured at its end; it {returns},
 * within +-{limit:g} A. The drive slews {them} by 0.5 A a step.
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
    float wanted[{currents}]; /* A, of the law that the estimate follows */{met}
    int begun;
}} {id}_state;

void {id}_reset({id}_state *s);
{step_function};

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
    """Write a policy as C code.

    The arithmetic is that of `Policy` in float: commands agree to rounding.

    Args:
        policy: The policy.
        folder: Folder of the files; created if missing.

    Returns:
        Paths of the header NAME.h and the source NAME.c.

    Raises:
        InputError: A file cannot be written.
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
    known = _signals(policy)
    order = [f" *   {i}: {known[i] if known else 'signal'}" for i in range(n)]
    if ahead:
        order.append(
            f" *   {n} to {n + ahead - 1}: height of the road above that under the wheel [m], "
            f"{step:g} s, {2 * step:g} s, ... {ahead * step:g} s ahead"
        )
    training = policy.info.get("training")
    command = training.get("command") if isinstance(training, dict) else None
    # text from a file must not end the surrounding comment
    origin = re.sub(r"[^ -~]|[*/\\]", " ", str(command or "a policy folder"))
    echo, several = policy.memory.echo, policy.currents > 1
    met = ""
    if policy.memory.late:
        rows, columns = _past(policy.memory)
        met += f"\n    float past[{rows}][{columns}]; /* earlier features of the front corners; for {policy.memory.speed:g} m/s */"
    if echo is not None:
        leaders, ages, _ = echo.weights(step).shape
        met += f"\n    float met[{leaders}][{ages}]; /* m, rises of the road under the leading wheels; for {echo.speed:g} m/s */"
    return HEADER.format(
        currents=policy.currents,
        met=met,
        returns=f"writes {policy.currents} commanded currents [A]"
        if several
        else "returns the commanded current [A]",
        them="each" if several else "it",
        step_function=_signature(policy, name),
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


def _signals(policy: Policy) -> list[str]:
    """Return the names of the signals of the car that a policy was made for; of a quarter car where none is known."""
    car = vehicle(policy.model or Network.load("quarter-car-isd"))
    known = [f"{signal.name} [{signal.unit}]" for signal in car.measured]
    return known if len(known) == policy.signals else []


def _signature(policy: Policy, name: str) -> str:
    given = f"{name}_state *s, const float observation[{name.upper()}_SIGNALS]"
    if policy.currents == 1:
        return f"float {name}_step({given})"
    return f"void {name}_step({given}, float current[{policy.currents}])"


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
    for j, (i, keep, gain) in enumerate(zip(recall.leaks, recall.keep, recall.gain, strict=True), at):
        see.append(f"    f[{j}] = f[{j}] * {_number(keep)} + y[{i}] * {_number(gain)};")
    if memory.late:
        see += _repeat(recall, at + len(recall.leaks))
    road = at + len(recall.leaks) + len(memory.late)
    rises = ""
    width = memory.ahead
    if memory.echo is not None:
        width, followers = memory.echo.width, len(memory.echo.followers)
        of = f"f[{road} + i * {memory.echo.points}] * {_number(memory.echo.rise)}"
        see += [
            f"    float risen[{followers}];",
            f"    for (int i = 0; i < {followers}; i++) risen[i] = {of};",
        ]
    if memory.ahead:
        rises = (
            f"    for (int i = 0; i < {memory.ahead}; i++)\n        f[{road} + i] = y[{n} + i] / {_number(memory.rise)} - "
            f"(i > 0 ? y[{n} + i - 1] / {_number(memory.rise)} : 0.0f);"
        )
        if recall.filter is not None and recall.filter.given.road:
            see.append(f"    const float risen[1] = {{f[{road}] * {_number(memory.rise)}}};")
        see.append(rises)
    if recall.filter is not None:
        made, lines = _filter(recall, road + width, road)
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
            f"{_signature(policy, name)} {{",
            f"    float y[{name.upper()}_SIGNALS];",
            f"    for (int i = 0; i < {name.upper()}_SIGNALS; i++) y[i] = isfinite(observation[i]) ? observation[i] : 0.0f;",
            "    if (s->begun) see(s, y); else begin(s, y);",
            "    s->begun = 1;",
            f"    float share[{policy.currents}];",
            "    network(s->features, share);",
            *_head(policy),
            "}\n",
        ]
    )


def _past(memory: Memory) -> tuple[int, int]:
    """Return the number of kept control steps and of repeated features."""
    return max(memory.ages) + 1, len({column for column, _, _ in memory.late})


def _repeat(recall: Recall, at: int) -> list[str]:
    """Return lines of `see` that keep the repeated features and write the late ones from feature `at` on."""
    rows, columns = _past(recall.memory)
    lines = ["    memmove(s->past[1], s->past[0], sizeof s->past - sizeof s->past[0]);"] if rows > 1 else []
    lines += [f"    s->past[0][{j}] = f[{column}];" for j, column in enumerate(recall.repeated)]
    return lines + [
        f"    f[{at + i}] = s->past[{age}][{place}];"
        for i, (age, place) in enumerate(zip(recall.ages, recall.places, strict=True))
    ]


def _filter(recall: Recall, at: int, road: int) -> tuple[list[str], list[str]]:
    """Return constants, and lines of `see`, of the estimate and the law behind it.

    Args:
        recall: Memory of one car, with a filter.
        at: Place of the first feature of the filter.
        road: Place of the first rise of the road ahead.
    """
    filter = recall.filter
    assert filter is not None
    given, n, nf, ny, m = filter.given, filter.n, filter.nf, filter.ny, filter.m
    now = n + m
    # columns of each product are contiguous
    constants = [
        _array("filter_free", filter.free.T),
        _array("filter_gain", filter.gain.T),
        _array("filter_rows", filter.rows.T),
        _array("filter_push", filter.push),
    ]
    lines = [
        f"    float x[{now}], z[{n}];",
        f"    for (int i = 0; i < {n}; i++) x[i] = f[{at} + i];",
        f"    for (int i = 0; i < {m}; i++) x[{n} + i] = y[{given.current} + i];",
    ]
    roads = given.roads if recall.memory.ahead or recall.echo is not None else 0
    if nf:
        constants += [_array("filter_stick", filter.stick.T), _array("filter_force", filter.force.T)]
        constants += [_array("filter_road_stick", filter.road_stick.T)] if roads else []
        known = (
            f"\n        for (int i = 0; i < {roads}; i++) t += risen[i] * filter_road_stick[j * {roads} + i];"
        )
        lines += [
            f"    float rest[{nf}], held[{nf}];",
            f"    for (int j = 0; j < {nf}; j++) {{\n        float t = 0.0f;",
            f"        for (int i = 0; i < {now}; i++) t += x[i] * filter_stick[j * {now} + i];{known if roads else ''}",
            "        rest[j] = t;\n        held[j] = limited(rest[j], -1.0f, 1.0f);\n    }",
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
        f"        for (int i = 0; i < {now}; i++) t += x[i] * filter_free[k * {now} + i];",
    ]
    if nf:
        lines.append(f"        for (int j = 0; j < {nf}; j++) t += held[j] * filter_force[k * {nf} + j];")
    lines.append(f"        for (int i = 0; i < {ny}; i++) t += y[i] * filter_gain[k * {ny} + i];")
    if roads:
        constants.append(_array("filter_road", filter.road.T))
        lines.append(
            f"        for (int i = 0; i < {roads}; i++) t += risen[i] * filter_road[k * {roads} + i];"
        )
    lines += ["        z[k] = t;\n    }", f"    for (int k = 0; k < {n}; k++) f[{at} + k] = z[k];"]
    if nf:
        lines.append(f"    for (int j = 0; j < {nf}; j++) f[{at + n} + j] = held[j];")
    if recall.echo is not None:
        made, more = _echo(recall, road)
        constants += made
        lines += more
    points = len(filter.ahead) if recall.memory.ahead or recall.echo is not None else 0
    lines += [
        f"    for (int j = 0; j < {m}; j++) {{\n        float law = 0.0f, rate = 0.0f;",
        f"        for (int k = 0; k < {n}; k++) {{\n            law += z[k] * filter_rows[j * {n} + k];",
        f"            rate += z[k] * filter_rows[(j + {m}) * {n} + k];\n        }}",
    ]
    if points:
        constants.append(_array("filter_ahead", filter.ahead.T))
        rise = _number(recall.memory.echo.rise if recall.memory.echo else recall.memory.rise)
        lines += [
            "        float law_ahead = 0.0f, rate_ahead = 0.0f;",
            f"        for (int i = 0; i < {points}; i++) {{",
            f"            law_ahead += f[{road} + i] * filter_ahead[j * {points} + i];",
            f"            rate_ahead += f[{road} + i] * filter_ahead[(j + {m}) * {points} + i];\n        }}",
            f"        law += law_ahead * {rise};\n        rate += rate_ahead * {rise};",
        ]
    reach, slew = _number(given.reach), _number(given.slew)
    wanted = f"(s->wanted[j] - y[{given.current} + j]) / {slew}"
    lines += [
        "        s->wanted[j] = law - filter_push[j] * tanhf(rate);",
        f"        f[{at + n + nf} + j] = limited({wanted}, -{reach}, {reach});\n    }}",
    ]
    return constants, lines


def _echo(recall: Recall, road: int) -> tuple[list[str], list[str]]:
    """Return constants and lines that keep the rises met by the leading wheels, and tell those ahead of the others."""
    assert recall.echo is not None
    _, leaders, ages = recall.echo.met.shape
    n, width = recall.echo.rows.shape[0], recall.echo.weights.shape[1]
    constants = [
        _array("echo_rows", recall.echo.rows.T),
        # most of them are 0: of each rise ahead, the first age that tells it, and the shares of that age and the next
        *_sparse(recall.echo.weights),
    ]
    lines = [
        f"    for (int l = 0; l < {leaders}; l++) {{",
        f"        for (int a = {ages - 1}; a > 0; a--) s->met[l][a] = s->met[l][a - 1];",
        "        float t = 0.0f;",
        f"        for (int k = 0; k < {n}; k++) t += z[k] * echo_rows[l * {n} + k];",
        "        s->met[l][0] = t;\n    }",
        "    const float *met = &s->met[0][0];",
        f"    for (int i = 0; i < {width}; i++)",
        f"        f[{road} + i] = met[echo_first[i]] * echo_share[2 * i] + met[echo_second[i]] * echo_share[2 * i + 1];",
    ]
    return constants, lines


def _sparse(weights: np.ndarray) -> list[str]:
    """Return the constants of a matrix (rows, columns) of which each column has two entries at most."""
    first, second, shares = [], [], []
    for column in weights.T:
        places = [int(i) for i in np.flatnonzero(column)]
        places += [places[0] if places else 0] * (2 - len(places)) if len(places) < 2 else []
        first.append(places[0])
        second.append(places[1])
        shares += [column[places[0]], column[places[1]] if places[1] != places[0] else 0.0]
    integers = [
        f"static const int {name}[{len(values)}] = {{{', '.join(map(str, values))}}};\n"
        for name, values in (("echo_first", first), ("echo_second", second))
    ]
    return [*integers, _array("echo_share", shares)]


def _network(policy: Policy) -> list[str]:
    inputs = policy.weights[0][0].shape[1]
    widest = max(inputs, *(w.shape[0] for w, _ in policy.weights))
    squash = {"tanh": "tanhf(t)", "relu": "t > 0.0f ? t : 0.0f"}[policy.activation]
    bound = _number(policy.bound) if np.isfinite(policy.bound) else ""
    feature = f"limited(f[i], -{bound}, {bound})" if bound else "f[i]"
    lines = [
        "static void network(const float *f, float *share) {",
        f"    float a[{widest}], b[{widest}];",
        f"    for (int i = 0; i < {inputs}; i++) {{\n        const float x = ({feature} - mean[i]) / spread[i];",
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
    out = f"tanhf({have}[j])" if policy.output == "tanh" else f"limited({have}[j], -1.0f, 1.0f)"
    return [*lines, f"    for (int j = 0; j < {policy.currents}; j++) share[j] = {out};", "}\n"]


def _head(policy: Policy) -> list[str]:
    """Return the lines that make currents of the output of the network."""
    head, limit, m = policy.head, _number(policy.head.limit), policy.currents
    present = policy.signals - m
    if head.mode == "target":
        wanted = f"share[j] * {limit}"
    elif head.mode == "increment":
        wanted = f"limited(y[{present} + j] + share[j] * {_number(head.slew)}, -{limit}, {limit})"
    else:
        wanted = f"limited(s->wanted[j] + offset[j], -{limit}, {limit})"
    lines = []
    if head.mode == "residual":
        first = policy.weights[0][0].shape[1] - m
        lines = [
            f"    float *offset = s->features + {first};",
            f"    for (int j = 0; j < {m}; j++) offset[j] = offset[j] * {_number(head.keep)} + {_number(head.gain)} * share[j];",
        ]
    if m == 1:
        return [*lines, f"    return {wanted.replace('[j]', '[0]').replace(' + j]', ']')};"]
    return [*lines, f"    for (int j = 0; j < {m}; j++) current[j] = {wanted};"]
