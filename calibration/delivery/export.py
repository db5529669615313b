"""Export a calibration: `export` writes it as one of several kinds of files.

`Document.notes` says which parts of the calibration the file cannot hold.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Geometry
from pickenv.base import InputError, register, require, write_whole
from pickenv.base.registry import get, names
from pickenv.calibration.delivery.document import Document, Order, provenance
from pickenv.calibration.delivery.onto_files import mjcf_files
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.residuals.bpnn import Bpnn
from pickenv.calibration.residuals.residual_models import LearntResidual

# The learnt residual as ONNX, for programs without pickenv; needs the extra ``export``.

OPSET = 17
"""Version of the ONNX operator set that is written; every onnxruntime since 2022 reads it."""


@register("exporter", "onnx")
def onnx_document(calibration: Calibration, _: Order) -> Document:
    """Make an ONNX document of the learnt network: input ``joints`` (N, n), rad and m, output ``residual`` (N, 6 or 3).

    If the network was learnt with conditions, they are a second input ``conditions`` (N, c). The network is in double
    precision, so that its output equals the output of `LearntResidual.predict`.

    Raises:
        InputError: If there is no learnt residual, its kind has no ONNX form, or the package ``onnx`` is missing.
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
    return Document(model.SerializeToString())


def _onnx_model(learnt: LearntResidual, network: Bpnn, geometry: Geometry, words: tuple[str, ...]) -> Any:
    """Build the ONNX model of a network, with the two scalings of its inputs.

    Joints that turn far enter the network as sine and cosine.

    Args:
        learnt: The learnt residual; its ``inputs`` hold the first scaling.
        network: The network of the learnt residual; it holds the second scaling and the layers.
        geometry: The arm.
        words: Lines of the model's documentation.
    """
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
    widths = {"joints": geometry.joints}
    if inputs.conditions:
        parts.append("conditions")
        widths["conditions"] = inputs.conditions
    widths["residual"] = len(network.output_mean)
    ports = (helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["N", width]) for name, width in widths.items())
    *arguments, result = ports
    value = node("Concat", parts, "inputs", axis=1)
    scalings = {"of_training": (inputs.mean, inputs.std), "of_network": (network.input_mean, network.input_std)}
    for stage, (mean, std) in scalings.items():
        centred = node("Sub", [value, constant(f"mean_{stage}", mean)], f"centred_{stage}")
        value = node("Div", [centred, constant(f"std_{stage}", std)], f"scaled_{stage}")
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        if i:
            value = node("Relu", [value], f"active{i - 1}")
        product = node("MatMul", [value, constant(f"weight{i}", np.ascontiguousarray(weight.T))], f"product{i}")
        value = node("Add", [product, constant(f"bias{i}", bias)], f"layer{i}")
    scaled = node("Mul", [value, constant("output_std", network.output_std)], "spread")
    node("Add", [scaled, constant("output_mean", network.output_mean)], "residual")
    graph = helper.make_graph(nodes, "learnt_residual", arguments, [result], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="pickenv")
    model.ir_version = 8
    model.doc_string = "\n".join(words)
    joints = f"rad or m, in the order {', '.join(geometry.joint_names)}"
    helper.set_model_props(model, {"joints": joints, "residual": "true minus identified pose: m, rotation vector rad"})
    return model


BY_ENDING = {".toml": "toml", ".urdf": "urdf", ".xml": "mjcf", ".onnx": "onnx"}
"""For each ending of a new file's name, the kind of the file."""

YAML = "kinematics-yaml"
BY_OWN_ENDING = {".urdf": "urdf", ".xml": "mjcf", ".json": "lerobot", ".yaml": YAML, ".yml": YAML}
"""For each ending of the name of the robot's own file, the kind of the file to write."""


def export(
    calibration: Calibration,
    out: str | Path,
    *,
    kind: str | None = None,
    onto: str | Path | None = None,
    arm: Arm | None = None,
    counts_per_turn: int | None = None,
    sample: int = 0,
    seed: int = 0,
) -> Document:
    """Write a calibration to a file that a robot, a controller, a simulator or another program reads.

    Args:
        calibration: The calibration.
        out: The file to write.
        kind: Name of a registered exporter; if None, it follows from the name of ``onto`` or else of ``out``.
        onto: The robot's own file (URDF, MJCF, kinematics YAML, LeRobot's JSON, a description with ros2_control). The
            written copy differs only in what the calibration corrects. In "robot.urdf#link", the link is the tip.
        arm: The arm, for the joint speeds of a new arm file or URDF. It is not needed for a shipped arm.
        counts_per_turn: Encoder counts per turn, for tables of offsets.
        sample: Number of arms that are drawn from the calibration's posterior and written beside a new MJCF.
        seed: Seed of these draws.

    Returns:
        The written document, with its path and its notes.

    Raises:
        InputError: If the kind is unknown or cannot hold the calibration, or if the robot's own file is of another arm.
    """
    out = Path(out)
    robot_file, tip = _robot_file(onto)
    if robot_file is not None and robot_file.exists() and not robot_file.is_file():
        raise InputError(f"{robot_file} is no file on a disk; give `onto` the robot's own file")
    kind = kind or _kind(robot_file, out)
    if calibration.arm.tree is not None and (kind not in ("urdf", "mjcf") or robot_file is None):
        raise InputError("the calibration of a whole robot goes onto its own URDF or MJCF; give that file as `onto`")
    exporter = get("exporter", kind)
    if counts_per_turn is not None and (kind != "offsets" or counts_per_turn < 1):
        raise InputError("counts per turn are a whole number above zero and belong to `kind='offsets'`")
    if robot_file is not None and kind in ("toml", "onnx", "table", "offsets"):
        raise InputError(f"a file of kind '{kind}' is written anew; leave `onto` out, or give another `kind`")
    if sample and (kind != "mjcf" or robot_file is not None):
        raise InputError("`sample` goes with a new MJCF; leave it and `onto` out, or give `kind='mjcf'`")
    if seed and not sample:
        raise InputError("`seed` is of the arms that `sample` draws; give `sample` with it, or leave `seed` out")
    if tip is not None and (calibration.arm.tree is not None or kind in (YAML, "lerobot", "ros2-control")):
        raise InputError(f"{robot_file} needs no tip here, so leave #{tip} of `onto` out")
    if kind == "mjcf" and robot_file is None:
        out = mjcf_files(out, 0)[0]
    document: Document = exporter(calibration, Order(out, robot_file, tip, arm, counts_per_turn, sample, seed))
    for path, data in {out: document.data, **document.beside}.items():
        write_whole(path, partial(Path.write_bytes, data=data))
    caution = () if calibration.caution is None else (f"caution: {calibration.caution}",)
    return replace(document, path=out, notes=(*caution, *document.notes))


def _robot_file(onto: str | Path | None) -> tuple[Path | None, str | None]:
    """Return the robot's own file and the link that is named after its "#"; each is None if it is not given."""
    if onto is None:
        return None, None
    path, mark, tip = str(onto).rpartition("#")
    return (Path(path), tip or None) if mark and path else (Path(onto), None)


def _kind(robot_file: Path | None, out: Path) -> str:
    """Return the exporter's name by the ending of the robot's own file or, without one, of the file to write."""
    endings, path = (BY_ENDING, out) if robot_file is None else (BY_OWN_ENDING, robot_file)
    if path.suffix == ".xacro":
        words = "is a xacro, which takes its numbers from elsewhere"
        raise InputError(f"{path} {words}; give `onto` its kinematics YAML, or the URDF that xacro makes of it")
    kind = endings.get(path.suffix.lower())
    if kind is None:
        raise InputError(f"{path} does not tell what to write; give `kind`, one of {', '.join(names('exporter'))}")
    return kind
