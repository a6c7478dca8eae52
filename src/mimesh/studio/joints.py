"""Joints of the studio's meshes: those that a model found, and those that the user has corrected."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.joint_corrections import JointCorrections
from ..core.mesh import Clip, Mesh
from ..io.joint_file import describe_corrections, load_corrections, side_file
from ..methods.base import CorrectableMethod, Method
from ..pipeline.corrections import Corrections, correctable_joints, found_joints, shown_bones
from ..pipeline.move import PreparedMove
from ..pipeline.prepared import Prepared
from .items import Item


def read_side_file(path: Path | None) -> JointCorrections | None:
    """Read the corrections beside a mesh or clip; None if there are none.

    Raises:
        InputError: they cannot be read.
    """
    if path is None or not side_file(path).is_file():
        return None
    corrections = load_corrections(side_file(path))
    return corrections if corrections.positions else None


def check_corrections(item: Item, corrections: JointCorrections) -> None:
    """Check corrections of a mesh, or of the driving clip in their frame.

    Raises:
        InputError: they do not belong to it, or it has not been read.
    """
    if item.content is None:
        raise InputError(f"{item.name}: expected a mesh that has been read, found none; wait for it")
    vertices = item.content.vertices
    if isinstance(item.content, Clip):
        if corrections.frame >= len(item.content):
            raise InputError(
                f"{corrections.source}: expected a frame of {item.name}, which has {len(item.content)} counted from "
                f"0, found {corrections.frame}; correct the joints again"
            )
        vertices = vertices[corrections.frame]
    # Whether a person or an animal is moved is known later: the method checks the names again.
    corrections.check(np.asarray(vertices, np.float64), correctable_joints(), item.name)


def parse_positions(item: Item, positions: Any) -> JointCorrections | None:
    """Make corrections from the positions that the page sends, in the frame of the earlier ones; None from none.

    Raises:
        InputError: they are not positions of joints, or do not belong to the mesh.
    """
    if not isinstance(positions, Mapping):
        raise InputError("joints: expected an object of positions, found something else; reload the page")
    frame = 0 if item.corrections is None else item.corrections.frame
    corrections = JointCorrections.of(positions, "joints", frame=frame)
    check_corrections(item, corrections)
    return corrections if corrections.positions else None


def applicable_corrections(method: Method, identity: Item, driving: Item) -> Corrections:
    """Return the corrections of both items if the method can use them, else none."""
    if not isinstance(method, CorrectableMethod) or not isinstance(driving.content, Clip):
        return Corrections()
    return Corrections.read(identity.corrections, driving.corrections, driving.content)


def describe_joints(prepared: PreparedMove, identity: Item, driving: Item) -> dict[str, Any]:
    """Return the joints found on both meshes as JSON values; empty if the model has none."""
    frame = 0 if driving.corrections is None else driving.corrections.frame
    found = found_joints(prepared, frame) if isinstance(prepared, Prepared) else None
    if found is None:
        return {}
    shown = shown_bones(found.body)
    return {
        "parents": shown,
        "meshes": {
            str(item.number): {
                "frame": 0 if item is identity else frame,
                "joints": {name: [float(x) for x in joints[name]] for name in shown if name in joints},
            }
            for item, joints in ((identity, found.identity), (driving, found.driving))
        },
    }


def describe_file(item: Item) -> dict[str, Any]:
    """Return the contents of the side file with the corrections of an item."""
    corrections = item.corrections or JointCorrections()
    mesh = item.content.mesh if isinstance(item.content, Clip) else item.content
    count = len(mesh.vertices) if isinstance(mesh, Mesh) else None
    return describe_corrections(JointCorrections(corrections.positions, corrections.frame, item.name, count))
