"""What other programs take from a calibration: the corrected arm as TOML or URDF, the learnt residual as ONNX.

The TOML file is an arm file that `pickenv.arm.load_arm` reads; parametric terms and the residual have no place in a
geometry and are said to be left out. ONNX needs the extra package ``onnx``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Geometry, rotation_vector
from pickenv.arm.files.urdf_text import leading_links, urdf_text
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.residuals.bpnn import Bpnn
from pickenv.calibration.residuals.residual_models import LearntResidual
from pickenv.errors import InputError
from pickenv.extras import require
from pickenv.files import write_text, write_whole

OPSET = 17
"""ONNX operator set written; read by every onnxruntime since 2022."""


def export(
    calibration: Calibration,
    arm: Arm,
    *,
    toml: str | Path | None = None,
    urdf: str | Path | None = None,
    onnx: str | Path | None = None,
) -> list[Path]:
    """Write what other programs take: the corrected arm (TOML, URDF), its learnt network (ONNX); returns what was.

    Raises:
        InputError: If no file is named, or the calibration has no place in one.
    """
    writers: tuple[tuple[str | Path | None, Callable[[str | Path], Path]], ...] = (
        (toml, lambda path: write_arm_toml(calibration, arm, path)),
        (urdf, lambda path: write_arm_urdf(calibration, arm, path)),
        (onnx, lambda path: write_onnx(calibration, path)),
    )
    if all(path is None for path, _ in writers):
        raise InputError("nothing to write; give --toml, --urdf or --onnx with a file name")
    return [write(path) for path, write in writers if path is not None]


def provenance(calibration: Calibration) -> tuple[str, ...]:
    """Where a corrected arm comes from, one fact per line."""
    record = calibration.record
    lines = [
        f"Arm '{calibration.arm_name}' as calibrated by pickenv; do not edit, calibrate again.",
        f"nominal geometry: fingerprint {calibration.arm_fingerprint}",
        f"data: {record.get('source', 'unknown')}, {record.get('poses', '?')} poses ({record.get('kind', '?')}), "
        f"fingerprint {record.get('data_fingerprint', 'unknown')}",
        f"identified parameters: {record.get('rank', '?')}; redundant ones keep their nominal values: "
        + (", ".join(record.get("dropped", {})) or "none"),
    ]
    versions: Mapping[str, Any] = record.get("versions", {})
    if versions:
        lines.append("versions: " + ", ".join(f"{name} {value}" for name, value in versions.items()))
    left_out = [type(term).__name__ for term in calibration.model.terms]
    if calibration.learnt is not None:
        left_out.append(f"learnt residual '{calibration.learnt.kind}'")
    if left_out:
        lines.append(f"not in this file, because no geometry can hold it: {', '.join(left_out)}")
    return tuple(lines)


def arm_toml(calibration: Calibration, arm: Arm) -> str:
    """The corrected arm as the text of an arm file; base and tool are those of the calibration.

    Hayati's beta is written (``beta_deg``) only for joints that have one. Links that follow another joint are joint
    tables with ``follows`` and ``ratio``.

    Raises:
        InputError: If a joint moves no link of its own kind (a rack and its pinion): only URDF has joints without one.
    """
    geometry = calibration.identified
    leaders = _leading_tables(geometry)
    owners = range(geometry.links) if geometry.coupling is None else geometry.coupling.joint
    lines = [f"# {_one_line(line)}" for line in provenance(calibration)]
    lines += _entries({"name": f"{arm.name}_calibrated", "source": f"pickenv calibration of {arm.name}; {arm.source}"})
    lines += ['convention = "modified" # Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d)']
    lines += _entries({"joint_count": geometry.links})
    for i, owner in enumerate(owners):
        slides, leader, ratio = geometry.slides[i], leaders[owner], dict(geometry.links_of(owner))[i]
        unit, scale = ("mm", 1e3) if slides else ("deg", float(np.degrees(1.0)))
        joint: dict[str, Any] = {
            "number": i + 1,
            "name": geometry.joint_names[owner] if leader == i else geometry.link_names[i],
            "type": "P" if slides else "R",
            "alpha_deg": np.degrees(geometry.alpha[i]),
            "a_mm": geometry.a[i] * 1e3,
        }
        if geometry.beta[i]:
            joint["beta_deg"] = np.degrees(geometry.beta[i])
        joint |= {"theta_deg": np.degrees(geometry.theta[i]), "d_mm": geometry.d[i] * 1e3}
        if ratio != 1.0:
            joint["ratio"] = ratio
        if leader != i:
            joint["follows"] = leader + 1
        else:
            limits = {"lower": geometry.lower[owner], "upper": geometry.upper[owner]}
            joint |= {f"{key}_{unit}": value * scale for key, value in limits.items()}
            joint[f"speed_{unit}_per_s"] = arm.speed[owner] * scale
        lines += ["", "[[joints]]", *_entries(joint)]
    for key, pose in (("base", geometry.base), ("tool", geometry.tool)):
        vector = np.degrees(rotation_vector(pose.rotation))
        lines += ["", f"[{key}]", *_entries({"position_mm": pose.position * 1e3, "rotation_vector_deg": vector})]
    return "\n".join(lines) + "\n"


def _leading_tables(geometry: Geometry) -> list[int]:
    """For each joint, the link whose table is the joint's own: one that moves just as it does, or else by a ratio."""
    leaders = []
    for joint, found in enumerate(leading_links(geometry)):
        kind = [i for i, _ in geometry.links_of(joint) if geometry.slides[i] == geometry.prismatic[joint]]
        if not kind:
            raise InputError(f"joint '{geometry.joint_names[joint]}' moves no link of its own kind; write URDF instead")
        leaders.append(kind[0] if found is None else found)
    if leaders != sorted(leaders):
        raise InputError("the joints of this arm stand in another order than their links; write URDF instead")
    return leaders


def write_arm_toml(calibration: Calibration, arm: Arm, path: str | Path) -> Path:
    """Write `arm_toml`, whole or not at all."""
    return write_text(path, arm_toml(calibration, arm))


def write_arm_urdf(calibration: Calibration, arm: Arm, path: str | Path) -> Path:
    """Write the corrected arm as URDF, with a comment that says where it comes from."""
    text = urdf_text(calibration.identified, f"{arm.name}_calibrated", arm.speed)
    declaration, _, rest = text.partition("\n")
    comment = "\n".join(_one_line(line).replace("--", "- -") for line in provenance(calibration))
    return write_text(path, f"{declaration}\n<!--\n{comment}\n-->\n{rest}")


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _entries(table: Mapping[str, Any]) -> list[str]:
    """Lines of a TOML table of texts, numbers and vectors."""
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: Any) -> str:
    """A text, which has JSON's escapes and no control characters, a number with all its digits, or a vector."""
    if isinstance(value, str):
        return '"' + _one_line(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value if isinstance(value, int) else float(value))


def write_onnx(calibration: Calibration, path: str | Path) -> Path:
    """Write the learnt network as ONNX: input ``joints`` (N, n) in rad and m, output ``residual`` (N, 6 or 3).

    Conditions, if it was learnt with any, are a second input ``conditions`` (N, c). Double precision, so that it equals
    `LearntResidual.predict`.

    Raises:
        InputError: If there is no network, it is of a kind without ONNX form, or the package ``onnx`` is missing.
    """
    learnt = calibration.learnt
    if learnt is None:
        raise InputError("this calibration has no learnt residual, so there is nothing to write as ONNX")
    if not isinstance(learnt.model, Bpnn):
        raise InputError(f"the residual model '{learnt.kind}' cannot be written as ONNX; only 'bpnn' can")
    require("onnx")
    import onnx

    model = _onnx_model(learnt, learnt.model, calibration.identified, provenance(calibration))
    onnx.checker.check_model(model)
    return write_whole(path, lambda temporary: temporary.write_bytes(model.SerializeToString()))


def _onnx_model(learnt: LearntResidual, network: Bpnn, geometry: Geometry, words: tuple[str, ...]) -> Any:
    """Joints to inputs (sine and cosine where they turn far), both standardisations, then the layers."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    constants: list[Any] = []
    nodes: list[Any] = []

    def constant(name: str, value: Any) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    inputs = learnt.inputs
    direct, turning = np.flatnonzero(~inputs.periodic), np.flatnonzero(inputs.periodic)
    parts: list[str] = []
    if len(direct):
        parts.append(node("Gather", ["joints", constant("direct", direct)], "direct_joints", axis=1))
    if len(turning):
        turned = node("Gather", ["joints", constant("turning", turning)], "turning_joints", axis=1)
        parts += [node("Sin", [turned], "sine"), node("Cos", [turned], "cosine")]
    given = [helper.make_tensor_value_info("joints", TensorProto.DOUBLE, ["N", geometry.joints])]
    if inputs.conditions:
        parts.append("conditions")
        given.append(helper.make_tensor_value_info("conditions", TensorProto.DOUBLE, ["N", inputs.conditions]))
    value = node("Concat", parts, "inputs", axis=1)
    for stage, mean, std in (
        ("of_training", inputs.mean, inputs.std),
        ("of_network", network.input_mean, network.input_std),
    ):
        centred = node("Sub", [value, constant(f"mean_{stage}", mean)], f"centred_{stage}")
        value = node("Div", [centred, constant(f"std_{stage}", std)], f"scaled_{stage}")
    layers: list[tuple[Array, Array]] = list(zip(network.weights, network.biases, strict=True))
    for i, (weight, bias) in enumerate(layers):
        product = node("MatMul", [value, constant(f"weight{i}", np.ascontiguousarray(weight.T))], f"product{i}")
        value = node("Add", [product, constant(f"bias{i}", bias)], f"layer{i}")
        if i < len(layers) - 1:
            value = node("Relu", [value], f"active{i}")
    scaled = node("Mul", [value, constant("output_std", network.output_std)], "spread")
    node("Add", [scaled, constant("output_mean", network.output_mean)], "residual")
    result = helper.make_tensor_value_info("residual", TensorProto.DOUBLE, ["N", len(network.output_mean)])
    graph = helper.make_graph(nodes, "learnt_residual", given, [result], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="pickenv")
    model.ir_version = 8
    model.doc_string = "\n".join(words)
    names = ", ".join(geometry.joint_names)
    units = {
        "joints": f"rad or m, in the order {names}",
        "residual": "true minus identified pose: m, rotation vector rad",
    }
    helper.set_model_props(model, units)
    assert isinstance(model, onnx.ModelProto)
    return model
