"""Reads and writes glTF 2.0 (.glb, .gltf, .vrm, .vrma): meshes at rest, baked animations, files with other vertices.

Files in .fbx are read as glTF (see `io.fbx`), and written as .glb.

check -> document                         opens files, also compressed and damaged ones
document -> scene -> read                 reads the scene of an open file at rest as a Mesh, or as a rigged character
draft -> edit                             builds the file of any Mesh: its own one with other vertices, or a new one
animation                                 reads animations and bakes them to vertex positions
skinned                                   writes joints, with a mesh or alone
motion, vrm                               plays animated joints without a mesh on the shipped body; extensions of VRM
character -> own_rig                      finds the limbs of people and animals, and moves the own nodes of a file
copied_motion, own_animation              copies animations by name; writes a file with new animations of its nodes
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.budgets import check_clip_size
from ...core.frame_buffer import Progress, each_frame, store_frames
from ...core.geometry import normal_turner, unit_vectors
from ...core.mesh import Clip, Mesh, check_mesh
from ...motions.on_body import first_frame, on_body
from ..formats import gltf_file
from ..timing import DEFAULT_FPS
from .animation import (
    frame_rate,
    frame_times,
    posed_vertices,
    rate_extras,
    sample_nodes,
    select_channels,
    unposed_vertices,
)
from .check import ARRAY_BUFFER, is_supported, list_primitives
from .document import Document, open_document
from .draft import Draft, Spool
from .edit import GltfSource, PrimitiveGroup, build_document, with_normals
from .motion import is_motion, read_skeleton
from .own_rig import GltfJoints
from .read import RestScene, read_rest

Deltas = dict[str, Float[np.ndarray, "N 3"]]
"""What a morph target adds to the attributes of one primitive group, by attribute name."""


def read_gltf(path: Path) -> Mesh:
    """Read the default scene of a .glb, .vrm, .vrma, .gltf or .fbx file at rest, in world coordinates and metres.

    Node transforms, default morph weights and skins (at the rest transforms of their joints) are applied. Vertices keep
    the file's order and its splits at seams. Animations, lines, points beside triangles, and scenes other than the
    default are not read; they stay in `Mesh.source`, whose `notes` say what is lost when the file is written again. A
    file with animations and no mesh gives the shipped body in the first frame (see `gltf.motion`), without a source.

    Raises:
        InputError: the file is damaged, not glTF 2.0, or shows neither triangles nor a person's joints; a library that
            reads FBX or compressed data is not installed.
    """
    document = open_document(path)
    if is_motion(document):
        return first_frame(on_body(read_skeleton(document), path))
    return _read_mesh(document)


def _read_mesh(document: Document) -> Mesh:
    path = document.path
    mesh, rest = read_rest(document)
    check_mesh(mesh, path)
    # An .fbx file is a glTF here, and is written as such.
    suffix = path.suffix.lower() if path.suffix.lower() != ".fbx" else ".glb"
    source = GltfSource(document, rest, mesh.vertices, suffix, _list_notes(document, rest))
    return dataclasses.replace(mesh, source=source)


def read_gltf_clip(
    path: Path, fps: float | None = None, animation: str | None = None, progress: Progress | None = None
) -> Clip:
    """Read an animation of a .glb, .vrm, .vrma, .gltf or .fbx file, baked to vertex positions.

    A file without animations gives one frame, unless `animation` is given. Joints without a mesh are played by the
    shipped body (see `gltf.motion`).

    Args:
        fps: frames a second; None: the rate that the file's keys lie on, else 30. Frame k is at k / fps seconds.
        animation: its name, the part of its name after the last "|", or its index; None: the first animation, together
            with those that move other nodes.
    """
    document = open_document(path)
    if is_motion(document):
        clip = on_body(read_skeleton(document, fps, animation), path).clip()
        person = None if clip.skeleton is None else clip.skeleton.person()
        channels, times = select_channels(document, animation), np.arange(len(clip)) / clip.fps
        return dataclasses.replace(clip, skeleton=GltfJoints(document, channels, times, None, person))
    mesh = _read_mesh(document)
    assert isinstance(mesh.source, GltfSource)
    if animation is None and not mesh.source.animations:
        clip = Clip(mesh, mesh.vertices[None], fps or DEFAULT_FPS)
        return dataclasses.replace(clip, skeleton=still_joints(mesh))
    channels = select_channels(document, animation)
    fps = fps or frame_rate(channels) or DEFAULT_FPS
    times = frame_times(document, channels, fps)
    check_clip_size(len(times), len(mesh.vertices), path)
    parts = unposed_vertices(document, mesh.source.rest, [(channel.node, channel.path) for channel in channels])
    frames = posed_vertices(document, parts, sample_nodes(document, channels, times))
    vertices = store_frames(frames, len(times), len(mesh.vertices), progress=progress)
    return Clip(mesh.with_vertices(vertices[0]), vertices, fps, skeleton=GltfJoints(document, channels, times, mesh))


def still_joints(mesh: Mesh) -> GltfJoints | None:
    """Return the joints of a mesh as its glTF file has them at rest; None for other files, and moved vertices."""
    source = mesh.source
    if not isinstance(source, GltfSource) or not np.array_equal(mesh.vertices, source.vertices):
        return None
    return GltfJoints(source.document, [], np.zeros(1), mesh)


def write_gltf(mesh: Mesh, path: Path) -> None:
    """Write a mesh as .glb, or as .gltf with embedded buffers.

    A mesh with a glTF source gives that file with its vertices changed, without skins and animations (see `gltf.edit`).
    Another mesh gives a new document, with smooth normals if it has none, because viewers show a mesh without normals
    faceted.
    """
    mesh = with_normals(mesh)
    with gltf_file(path) as temporary:
        build_document(mesh, mesh)[0].save(temporary)


def write_gltf_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as .glb or .gltf: the mesh at frame 0 and one morph target for each later frame.

    A target has the weight 1 at its own key, k / fps for that of frame k, and 0 at all others, linear in between. At a
    key one target is active, between two keys two, and positions in between are linear between both frames. Clients may
    limit the active targets (glTF 2.0, 3.7.2.2 Morph Targets, recommends support of eight attributes), which two never
    reach. A client without morph targets shows frame 0. Targets of all frames wait in a temporary file.

    A mesh with a glTF source keeps all of that file but its skins, animations and morph targets. One frame gives a file
    without animation. The size is about 24 bytes a vertex and frame: positions and normals in float32.
    """
    mesh = with_normals(clip.mesh)
    base = mesh.with_vertices(np.asarray(clip.vertices[0], np.float64))
    draft, groups = build_document(mesh, base)
    if len(clip) > 1:
        deltas = _frame_deltas(groups, mesh, clip, base.vertices, progress)
        attributes: list[dict[str, Spool]] = [{} for _ in groups]
        for of_frame in itertools.islice(deltas, 1, None):  # frame 0 has no target
            for of_group, spools in zip(of_frame, attributes, strict=True):
                for name, values in of_group.items():
                    spools.setdefault(name, Spool()).append(values)
        for group, spools in zip(groups, attributes, strict=True):
            targets = _add_targets(draft, spools)
            for primitive in group.primitives:
                primitive["targets"] = [dict(target) for target in targets]
        # A node appears once, although several groups may be primitives of its mesh.
        nodes = list(dict.fromkeys(group.node for group in groups))
        names = [f"frame {number}" for number in range(1, len(clip))]
        for node in nodes:
            _complete_targets(draft, draft.gltf["meshes"][draft.gltf["nodes"][node]["mesh"]], names)
        draft.gltf["animations"] = [_morph_animation(draft, nodes, clip)]
    with gltf_file(path) as temporary:
        draft.save(temporary)


def _list_notes(document: Document, rest: RestScene) -> tuple[str, ...]:
    """List what is lost or changed when the file is written again, one line each."""
    gltf = document.gltf
    notes = []
    counts = {name: len(gltf.get(f"{name}s", [])) for name in ("skin", "animation")}
    dropped = [f"the {name}" if count == 1 else f"{count} {name}s" for name, count in counts.items() if count]
    dropped += ["the blend shapes"] * any("targets" in primitive for primitive in list_primitives(gltf))
    if dropped:
        notes.append(f"dropped {' and '.join(dropped)} that the file had")
    # Instances of one mesh get copies when written, because each is deformed on its own.
    nodes = list(dict.fromkeys(span.node for span in rest.vertex_ranges))
    meshes = {gltf["nodes"][node]["mesh"] for node in nodes}
    if len(meshes) < len(nodes):
        notes.append(
            f"gave each of {len(nodes)} nodes a mesh of its own, {len(meshes)} were shared: they now move apart"
        )
    for name in gltf.get("extensionsUsed", []):
        if not is_supported(str(name)):
            notes.append(f"kept the data of extension {name} as it is: it does not follow the new shape")
    return tuple(notes)


def _frame_deltas(
    groups: list[PrimitiveGroup], mesh: Mesh, clip: Clip, base: Float[np.ndarray, "V 3"], progress: Progress | None
) -> Iterator[list[Deltas]]:
    """Yield how the attributes of each frame differ from those of `base`, rounded to float32 as the file has them."""
    normals_of = None
    if any(group.has_normals for group in groups):
        assert mesh.corner_normals is not None
        normals_of = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)

    def attributes_of(vertices: Float[np.ndarray, "V 3"]) -> list[Deltas]:
        normals = normals_of(vertices).reshape(-1, 3) if normals_of else None
        return [_local_attributes(group, vertices, normals) for group in groups]

    base_attributes = [
        {name: values.astype(np.float32) for name, values in attributes.items()} for attributes in attributes_of(base)
    ]
    for vertices in each_frame(clip.vertices, progress):
        yield [
            {name: values - of_base[name] for name, values in attributes.items()}
            for attributes, of_base in zip(attributes_of(vertices), base_attributes, strict=True)
        ]


def _local_attributes(
    group: PrimitiveGroup, vertices: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "C 3"] | None
) -> Deltas:
    """Return positions and normals of a group's elements in their node's frame; a normal without a face is zero."""
    linear, origin = group.T_world_local[:3, :3], group.T_world_local[:3, 3]
    local = {"POSITION": (vertices[group.vertex_of] - origin) @ np.linalg.inv(linear).T}
    if group.has_normals and normals is not None:
        local["NORMAL"] = np.where(group.corner_of[:, None] >= 0, unit_vectors(normals[group.corner_of] @ linear), 0.0)
    return local


def _add_targets(draft: Draft, spools: dict[str, Spool]) -> list[dict[str, int]]:
    """Add one buffer view for each attribute and one accessor for each morph target; returns the targets' JSON."""
    targets: list[dict[str, int]] = [{} for _ in next(iter(spools.values())).bounds]
    for name, spool in spools.items():
        view = draft.add_view(spool, target=ARRAY_BUFFER, byteStride=12)
        size = spool.nbytes // max(len(spool.bounds), 1)  # bytes of one target: 12 an element
        for number, bounds in enumerate(spool.bounds):
            accessor: dict[str, Any] = {"bufferView": view, "byteOffset": number * size, "componentType": 5126}
            accessor |= {"count": size // 12, "type": "VEC3"} | (bounds if name == "POSITION" else {})
            targets[number][name] = draft.add_accessor(accessor)
    return targets


def _complete_targets(draft: Draft, mesh: dict[str, Any], names: list[str]) -> None:
    """Set the default weights (none) and names of a mesh's targets, and add zero targets to its lines and points.

    All primitives of a mesh must have the same number of targets (glTF 2.0, 3.7.2.2). An accessor without a buffer view
    is all zeros (3.6.2.3 Sparse Accessors). Names in `extras.targetNames` are a convention of most tools.
    """
    for primitive in mesh["primitives"]:
        if "targets" not in primitive:
            count = draft.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
            zeros = {"componentType": 5126, "count": count, "type": "VEC3", "min": [0.0] * 3, "max": [0.0] * 3}
            primitive["targets"] = [{"POSITION": draft.add_accessor(zeros)}] * len(names)
    mesh["weights"] = [0.0] * len(names)
    if isinstance(mesh.setdefault("extras", {}), dict):
        mesh["extras"]["targetNames"] = names


def _morph_animation(draft: Draft, nodes: list[int], clip: Clip) -> dict[str, Any]:
    """Return an animation of the morph weights with one key a frame; its channels share one sampler."""
    times = draft.add_floats(np.arange(len(clip))[:, None] / clip.fps, bounds=True)
    # The weights of all targets at one key lie next to each other (3.11 Animations). They are as many as the square of
    # the frames, 400 MB for 10,000, so they wait on disk, too.
    spool = Spool()
    for t in range(len(clip)):  # target k - 1 has weight 1 at key k and 0 at all others
        spool.append(np.eye(1, len(clip) - 1, t - 1).T)
    view = draft.add_view(spool)
    accessor = {"bufferView": view, "componentType": 5126, "count": spool.nbytes // 4, "type": "SCALAR"}
    values = draft.add_accessor(accessor)
    return {
        "name": clip.mesh.name,
        "samplers": [{"input": times, "interpolation": "LINEAR", "output": values}],
        "channels": [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in nodes],
    } | rate_extras(clip.fps)
