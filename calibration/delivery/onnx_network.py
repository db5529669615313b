"""The learnt residual as ONNX, for programs without pickenv; needs the extra ``export``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.delivery.origin_lines import provenance
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.residuals.bpnn import Bpnn
from pickenv.calibration.residuals.residual_models import LearntResidual
from pickenv.errors import InputError
from pickenv.extras import require
from pickenv.files import write_whole

OPSET = 17
"""ONNX operator set written; read by every onnxruntime since 2022."""


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
