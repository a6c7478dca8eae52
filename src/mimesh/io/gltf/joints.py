"""Writes joints without a mesh: a node for each, in the hierarchy of the skeleton, and animations of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.rig import homogeneous
from .animation import AnimationChannel, add_animation, rotation_channels
from .draft import Draft


def write_gltf_joints(
    name: str,
    names: tuple[str, ...],
    parents: tuple[int, ...],
    rest: Float[np.ndarray, "J 3"],
    rotation: Float[np.ndarray, "T J 3 3"],
    root: Float[np.ndarray, "T 3"],
    fps: float,
    path: Path,
) -> None:
    """Write one motion of joints as .glb or .gltf by the suffix of `path`; arguments as in `joints_draft` and below.

    A skin that no mesh uses lists the joints: Blender makes an armature of it, and three.js bones.
    """
    draft = joints_draft(names, parents, rest)
    bind = homogeneous(np.tile(np.eye(3), (len(rest), 1, 1)), -rest)
    skin = {"joints": list(range(len(names))), "skeleton": 0, "inverseBindMatrices": draft.add_matrices(bind)}
    draft.gltf["skins"] = [skin]
    draft.gltf["animations"] = [joint_animation(draft, name, parents, rotation, root, fps)]
    draft.save(path)


def joints_draft(names: Sequence[str], parents: tuple[int, ...], rest: Float[np.ndarray, "J 3"]) -> Draft:
    """Build a document of joints alone, none of which is rotated at rest; the root comes first, with parent -1."""
    nodes: list[dict[str, Any]] = []
    for k, (name, parent) in enumerate(zip(names, parents, strict=True)):
        step = rest[k] - (rest[parent] if parent >= 0 else 0.0)
        children = [j for j, above in enumerate(parents) if above == k]
        nodes.append({"name": name, "translation": step.tolist()} | ({"children": children} if children else {}))
    asset = {"version": "2.0", "generator": "mimesh"}
    return Draft({"asset": asset, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes})


def joint_animation(
    draft: Draft,
    name: str,
    parents: tuple[int, ...],
    rotation: Float[np.ndarray, "T J 3 3"],
    root: Float[np.ndarray, "T 3"],
    fps: float,
) -> dict[str, Any]:
    """Add an animation of all joints: world rotations since rest, and the path of the root in every frame."""
    path = AnimationChannel(0, "translation", np.arange(len(root)) / fps, root)
    return add_animation(draft, name, [path, *rotation_channels(range(len(parents)), rotation, parents, fps)])
