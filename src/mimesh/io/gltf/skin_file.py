"""Reads a rigged mesh file as a character at rest, with the names and frames that its joints have there.

A file of its own, because `load_mesh` imports the rest of this package.
"""

from __future__ import annotations

from pathlib import Path

from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError
from ..load import load_mesh
from .edit import GltfSource
from .read import rig_on_nodes, skin_joints


def read_skin(path: str | Path) -> SkinnedCharacter:
    """Read a .glb, .vrm, .gltf or .fbx character with the joints of all skins that its default scene shows.

    Morph targets stay at their default weights. Animations are not read.

    Raises:
        InputError: as `load_mesh`; another format; or a scene without a skinned mesh.
    """
    mesh = load_mesh(path)
    source = mesh.source
    if not isinstance(source, GltfSource):
        raise InputError(
            f"{path}: expected a rigged mesh in a .glb, .gltf, .vrm or .fbx, found none in this {Path(path).suffix}; "
            "export the mesh and its armature together as glTF"
        )
    joint_nodes = skin_joints(source.document, source.rest)
    if not joint_nodes:
        raise InputError(f"{path}: expected a mesh with a skin, found none; export it together with its armature")
    return rig_on_nodes(mesh, source.document, source.rest, joint_nodes)[0]
