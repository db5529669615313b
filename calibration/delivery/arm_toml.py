"""The corrected arm as an arm file that `pickenv.arm.load_arm` reads, with all its digits.

Parametric terms and the residual have no place in a geometry and are said to be left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Geometry, rotation_vector
from pickenv.arm.files.urdf_text import leading_links
from pickenv.calibration.delivery.origin_lines import provenance
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.texts import one_line


def arm_toml(calibration: Calibration, arm: Arm) -> str:
    """The corrected arm as the text of an arm file; base and tool are those of the calibration.

    Hayati's beta is written (``beta_deg``) only for joints that have one. Links that follow another joint are joint
    tables with ``follows`` and ``ratio``.

    Raises:
        InputError: If a joint moves no link of its own kind (a rack and its pinion): only URDF has joints without one.
    """
    geometry = calibration.identified
    leaders = _leading_tables(geometry)
    lines = [f"# {one_line(line)}" for line in provenance(calibration)]
    lines += _entries({"name": f"{arm.name}_calibrated", "source": f"pickenv calibration of {arm.name}; {arm.source}"})
    lines += ['convention = "modified" # Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d)']
    lines += _entries({"joint_count": geometry.links})
    for i, owner in enumerate(geometry.owners):
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


def _entries(table: Mapping[str, Any]) -> list[str]:
    """Lines of a TOML table of texts, numbers and vectors."""
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: Any) -> str:
    """A text, which has JSON's escapes and no control characters, a number with all its digits, or a vector."""
    if isinstance(value, str):
        return '"' + one_line(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value if isinstance(value, int) else float(value))
