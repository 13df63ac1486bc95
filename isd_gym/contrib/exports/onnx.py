"""ONNX export for deployment: one control step as a graph, with the memory as an input and an output."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym._common.files import whole

if TYPE_CHECKING:
    from isd_gym.agents.policy import Policy

OPSET = 17


def export_onnx(policy: Policy, path: str | Path) -> Path:
    """Write one control step of a policy as an ONNX graph.

    Inputs are ``observation`` (cars, signals) in SI units, ``memory`` (cars, features), and ``first`` (cars,
    1), which is 1 at the start of an episode and 0 otherwise. Outputs are ``current`` (cars, currents) [A]
    and ``next_memory``, the memory of the next step.

    Args:
        policy: The policy.
        path: File to write.

    Returns:
        The path.

    Raises:
        InputError: The package onnx is missing, or the policy cannot be exported.
    """
    try:
        import onnx
        from onnx import TensorProto, helper, numpy_helper
    except ImportError:
        raise InputError("ONNX export needs the package onnx: pip install onnx") from None
    nodes, constants = [], []

    def constant(name: str, value: Any) -> str:
        array = np.asarray(value)
        constants.append(
            numpy_helper.from_array(array if array.dtype == np.int64 else array.astype(np.float32), name)
        )
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    memory, n = policy.memory, policy.signals
    if memory.ahead:
        raise InputError(
            f"policy '{policy.name}' sees the road ahead, which the ONNX export does not know: write it as C (--c DIR)"
        )
    if memory.echo is not None or memory.late:
        raise InputError(
            f"policy '{policy.name}' keeps the road that the front wheels met, which the ONNX export does not know: "
            "write it as C (--c DIR)"
        )
    recall = memory.start(np.zeros((1, n), np.float32))
    width = recall.features.shape[1]

    def estimate(filter: Any, at: int) -> list[str]:
        """Return the blocks of a filter's features from column `at`; the current of the law is named `wanted`."""
        if filter.nf > 1:
            raise InputError(
                f"policy '{policy.name}': the ONNX export knows one dry friction, not {filter.nf}"
            )
        given = filter.given
        current = part("observation", given.current, given.current + filter.m, "present")
        now = node("Concat", [part("memory", at, at + filter.n, "estimate"), current], "before", axis=1)
        rest = node("MatMul", [now, constant("stick", filter.stick)], "rest")
        friction = node("Clip", [rest, constant("left", -1.0), constant("right", 1.0)], "friction")
        free = node("MatMul", [now, constant("free", filter.free)], "unheld")
        held = node("MatMul", [friction, constant("force", filter.force)], "held")
        heard = part("observation", 0, filter.ny, "heard")
        told = node("MatMul", [heard, constant("gain", filter.gain)], "told")
        z = node("Mul", [node("Sum", [free, held, told], "z0"), "keep"], "z")
        law = node("MatMul", [z, constant("law", filter.rows[:, : filter.m])], "linear")
        turn = node(
            "Tanh", [node("MatMul", [z, constant("rate", filter.rows[:, filter.m :])], "rates")], "turn"
        )
        push = node("Mul", [turn, constant("push", filter.push)], "pushed")
        wanted = node("Sub", [law, push], "law_current")
        ahead = node(
            "Div", [node("Sub", [wanted, current], "lacking"), constant("law_slew", given.slew)], "ahead"
        )
        ahead = node(
            "Clip", [ahead, constant("near", -given.reach), constant("far", given.reach)], "told_ahead"
        )
        end = at + filter.width
        return [
            z,
            node("Mul", [friction, "keep"], "held_on"),
            node("Mul", [ahead, "keep"], "law_share"),
            node("Mul", [part("memory", end - filter.m, end, "old_offset"), "keep"], "offset"),
        ]

    def part(source: str, begin: int, end: int, output: str) -> str:
        ends = [
            constant(f"{output}.{k}", np.array([v], np.int64))
            for k, v in (("a", begin), ("b", end), ("c", 1))
        ]
        return node("Slice", [source, *ends], output)

    keep = node("Sub", [constant("one", 1.0), "first"], "keep")
    blocks = [node("Div", ["observation", constant("scale", recall.scale)], "x0")]
    for k, ratio in enumerate(recall.ratios):
        change = node("Sub", [blocks[-1], part("memory", n * k, n * (k + 1), f"old{k}")], f"change{k}")
        scaled = node("Mul", [change, constant(f"ratio{k}", ratio)], f"scaled{k}")
        blocks.append(node("Mul", [scaled, keep], f"x{k + 1}"))
    for j, (i, decay, gain) in enumerate(zip(recall.leaks, recall.keep, recall.gain, strict=True)):
        at = n * (memory.order + 1) + j
        old = node("Mul", [part("memory", at, at + 1, f"leak{j}"), constant(f"decay{j}", decay)], f"kept{j}")
        new = node(
            "Mul", [part("observation", i, i + 1, f"signal{j}"), constant(f"gain{j}", gain)], f"fed{j}"
        )
        blocks.append(node("Mul", [node("Add", [old, new], f"sum{j}"), keep], f"integral{j}"))
    offset = ""
    if recall.filter is not None:
        blocks += estimate(recall.filter, n * (memory.order + 1) + len(recall.leaks))
        offset = blocks[-1]
    features = node("Concat", blocks, "features", axis=1)
    x = features
    if np.isfinite(policy.bound):
        x = node("Clip", [x, constant("least", -policy.bound), constant("most", policy.bound)], "bounded")
    x = node("Sub", [x, constant("mean", policy.mean)], "centred")
    x = node("Div", [x, constant("spread", policy.scale)], "normal")
    if np.isfinite(policy.clip):
        x = node("Clip", [x, constant("low", -policy.clip), constant("high", policy.clip)], "clipped")
    for i, (w, b) in enumerate(policy.weights):
        x = node("MatMul", [x, constant(f"w{i}", w.T)], f"product{i}")
        x = node("Add", [x, constant(f"b{i}", b)], f"layer{i}")
        if i < len(policy.weights) - 1:
            x = node({"tanh": "Tanh", "relu": "Relu"}[policy.activation], [x], f"hidden{i}")
    if policy.output == "tanh":
        x = node("Tanh", [x], "share")
    else:
        x = node("Clip", [x, constant("minus_one", -1.0), "one"], "share")
    head = policy.head
    if head.mode == "residual":
        gained = node("Mul", [x, constant("head_gain", head.gain)], "gained")
        kept = node("Mul", [offset, constant("head_keep", head.keep)], "kept_offset")
        blocks[-1] = node("Add", [kept, gained], "new_offset")
        wanted = node("Add", ["law_current", blocks[-1]], "wanted")
        node("Clip", [wanted, constant("lowest", -head.limit), constant("highest", head.limit)], "current")
    elif head.mode == "target":
        node("Mul", [x, constant("limit", head.limit)], "current")
    else:
        step = node("Mul", [x, constant("slew", head.slew)], "step")
        wanted = node("Add", [part("observation", n - policy.currents, n, "now"), step], "wanted")
        node("Clip", [wanted, constant("lowest", -head.limit), constant("highest", head.limit)], "current")

    node("Concat", blocks, "next_memory", axis=1)

    def tensor(name: str, columns: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["cars", columns])

    graph = helper.make_graph(
        nodes,
        policy.name,
        [tensor("observation", n), tensor("memory", width), tensor("first", 1)],
        [tensor("current", policy.currents), tensor("next_memory", width)],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="isd_gym")
    model.ir_version = 8
    onnx.checker.check_model(model)
    path = Path(path)
    with whole(path) as temporary:
        temporary.write_bytes(model.SerializeToString())
    return path
