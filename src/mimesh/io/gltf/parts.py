"""Parts of a glTF scene: what joints carry, what nothing moves, and the characters of a file with several of them."""

from __future__ import annotations

import dataclasses
from typing import cast

import numpy as np
from jaxtyping import Bool, Float, Int

from ...bodies.joint_names import ancestors
from ...core.errors import InputError
from ...core.mesh import Mesh, chosen_faces
from .animation import animated_nodes
from .edit import GltfSource
from .motion import PLAYED_PATHS
from .read import PrimitiveKey, RestScene, VertexRange, find_skin
from .scene import node_parents

FEWEST_JOINTS = 8
"""Joints of a skeleton from which on it may be that of a second character: a flag or a door has fewer."""
AS_TALL = 0.4
"""Height of a second character, over that of the tallest."""


def static_parts(mesh: Mesh) -> Bool[np.ndarray, " P"]:
    """Tell which parts of a scene with skins nothing moves: they have no skin, and no joint or animation above them."""
    source = cast(GltfSource, mesh.source)
    document, keys = source.document, list(source.rest.faces)
    joints = {joint for skin in document.gltf.get("skins", []) for joint in skin["joints"]}
    if not joints:
        return np.zeros(len(keys), bool)
    try:
        moving = joints | animated_nodes(document, (*PLAYED_PATHS, "weights"))
    except InputError:  # a damaged animation, which may move anything
        return np.zeros(len(keys), bool)
    parents = node_parents(document)
    ranges = _ranges(source.rest)
    return np.array(
        [find_skin(document, ranges[key]) is None and not moving & set(ancestors(parents, key[0])) for key in keys],
        bool,
    )


def characters(mesh: Mesh) -> dict[str, Bool[np.ndarray, " P"]]:
    """Find the characters of a scene of several: skeletons whose surfaces stand side by side, by name -> their parts.

    A name is that of all parts of a character and of none of the others, else it gets a number. Clothes and levels of
    detail with skeletons of their own are where the body is, and count as one character with it. What hangs on a joint
    is a part of its character, and does not tell where this stands.
    """
    source = cast(GltfSource, mesh.source)
    document, roots = source.document, _root_joints(mesh)
    boxes: dict[int, list[Float[np.ndarray, "2 3"]]] = {}
    joints, names = dict[int, set[int]](), dict[int, list[str]]()
    for root, above, span in zip(roots.tolist(), names_above(mesh), _ranges(source.rest).values(), strict=True):
        skin = find_skin(document, span)
        if skin is None:
            continue
        of_skin = document.gltf["skins"][skin]["joints"]
        points = mesh.vertices[span.start : span.stop]
        boxes.setdefault(root, []).append(np.stack([points.min(axis=0), points.max(axis=0)]))
        names[root] = [name for name in names.get(root, above) if name in above]
        joints.setdefault(root, set()).update(of_skin)
    if len(boxes) < 2:
        return {}
    whole = {root: (np.min(some, axis=0)[0], np.max(some, axis=0)[1]) for root, some in boxes.items()}
    tallest = max(high[1] - low[1] for low, high in whole.values())
    found: list[int] = []
    for root, (low, high) in whole.items():
        tall = len(joints[root]) >= FEWEST_JOINTS and high[1] - low[1] >= AS_TALL * tallest
        if tall and all(_apart((low, high), whole[other]) for other in found):
            found.append(root)
    own_names = {}
    for k, root in enumerate(found, 1):
        others = {name for other, some in names.items() if other != root for name in some}
        own = (name for name in names[root] if name not in others)
        own_names[root] = next(own, f"{[*names[root], 'character'][0]} {k}")
    return {own_names[root]: roots == root for root in found}


def with_skeleton(mesh: Mesh, chosen: Bool[np.ndarray, " P"]) -> Bool[np.ndarray, " P"]:
    """Add to some parts all others that the joints of these move: a mesh with a skin stands for its whole character."""
    source, roots = cast(GltfSource, mesh.source), _root_joints(mesh)
    skinned = [find_skin(source.document, span) is not None for span in _ranges(source.rest).values()]
    return chosen | np.isin(roots, roots[chosen & np.array(skinned, bool)])


def _root_joints(mesh: Mesh) -> Int[np.ndarray, " P"]:
    """Return the topmost joint of the skeleton that moves each part, by a skin or from above its node; -1: none."""
    source = cast(GltfSource, mesh.source)
    document, parents = source.document, node_parents(source.document)
    every = {joint for skin in document.gltf.get("skins", []) for joint in skin["joints"]}
    roots = []
    for key, span in _ranges(source.rest).items():
        skin = find_skin(document, span)
        lowest = key[0] if skin is None else document.gltf["skins"][skin]["joints"][0]
        roots.append([-1, *(node for node in ancestors(parents, lowest) if node in every)][-1])
    return np.array(roots, int)


def names_above(mesh: Mesh) -> list[tuple[str, ...]]:
    """List for each part its name and those of its mesh, its node, its skeleton and all nodes above these."""
    source = cast(GltfSource, mesh.source)
    document, ranges = source.document, _ranges(source.rest)
    nodes, parents, named = document.gltf["nodes"], node_parents(document), []
    for part, (key, span) in zip(mesh.parts, ranges.items(), strict=True):
        above, skin = set(ancestors(parents, key[0])), find_skin(document, span)
        if skin is not None:
            above |= set(ancestors(parents, document.gltf["skins"][skin]["joints"][0]))
        of_mesh = document.gltf["meshes"][nodes[key[0]]["mesh"]].get("name")
        named.append(tuple(filter(None, (part.name, of_mesh, *(nodes[node].get("name") for node in above)))))
    return named


def gltf_part(
    mesh: Mesh, chosen: Bool[np.ndarray, " P"], faces: Int[np.ndarray, " G"]
) -> tuple[Mesh, Int[np.ndarray, " U"]]:
    """Make a mesh of some parts, which comes from the same file, and return which vertices of the whole it has.

    Parts that share vertices with one of them have these, too, but not their faces.
    """
    source = cast(GltfSource, mesh.source)
    ranges = _ranges(source.rest)
    taken = [key for key, take in zip(ranges, chosen, strict=True) if take]
    kept, spans, start = dict.fromkeys(ranges[key] for key in taken), [], 0
    for span in kept:
        primitives = tuple(p for p in span.primitives if (span.node, p) in taken)
        spans.append(VertexRange(span.node, start, start + span.stop - span.start, primitives))
        start = spans[-1].stop
    index = np.concatenate([np.arange(span.start, span.stop) for span in kept])
    ends = np.cumsum([0] + [stop - start for start, stop in (source.rest.faces[key] for key in taken)]).tolist()
    of_faces = {key: (ends[k], ends[k + 1]) for k, key in enumerate(taken)}
    rest = dataclasses.replace(source.rest, vertex_ranges=tuple(spans), faces=of_faces)
    of_part = dataclasses.replace(source, rest=rest, vertices=source.vertices[index])
    return dataclasses.replace(chosen_faces(mesh, faces, index), source=of_part), index


def _ranges(rest: RestScene) -> dict[PrimitiveKey, VertexRange]:
    """Return the range of vertices of each primitive with faces, in their order."""
    of_key = {(span.node, primitive): span for span in rest.vertex_ranges for primitive in span.primitives}
    return {key: of_key[key] for key in rest.faces}


def _apart(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> bool:
    """Tell whether two boxes (low, high) are side by side: the centre of neither is in the other, seen from above."""
    return all(
        ((a[0] + a[1]) / 2 < b[0])[[0, 2]].any() or ((a[0] + a[1]) / 2 > b[1])[[0, 2]].any()
        for a, b in ((one, other), (other, one))
    )
