"""Reads and writes glTF 2.0 (.glb, .gltf, .vrm, .vrma): meshes at rest, baked animations, files with other vertices.

Files in .fbx are read as glTF (see `io.fbx`), and written as .glb.

check, compression -> document            opens files, also compressed and damaged ones
document -> scene -> read                 reads the scene of an open file at rest as a Mesh, or as a rigged character
draft -> edit                             writes the file of a Mesh again, with other vertices
build                                     builds a new file for a Mesh without a glTF source
animation                                 reads animations and bakes them to vertex positions
clip                                      writes a clip as morph targets with an animation
skinned                                   writes a mesh with joints
motion, vrm                               plays animated joints without a mesh on the shipped body; extensions of VRM
character -> own_rig                      finds the limbs of people and animals, and moves the own nodes of a file
copied_motion, own_animation              copies animations by name; writes a file with new animations of its nodes
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ...core.budgets import check_clip_size
from ...core.frame_buffer import Progress, store_frames
from ...core.mesh import Clip, Mesh, check_mesh
from ...motions.on_body import first_frame, on_body
from ..timing import DEFAULT_FPS
from .animation import frame_rate, frame_times, posed_vertices, sample_nodes, select_channels, unposed_vertices
from .build import build_document
from .check import is_supported, list_primitives
from .clip import add_morph_animation
from .document import Document, open_document
from .edit import GltfSource, edit_document, with_normals
from .motion import PLAYED_PATHS, is_motion, read_skeleton
from .own_rig import GltfJoints
from .read import RestScene, read_rest


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

    Raises:
        InputError: as `read_gltf`, no such animation, or a damaged one.
    """
    document = open_document(path)
    if is_motion(document):
        clip = on_body(read_skeleton(document, fps, animation), path).clip()
        return dataclasses.replace(clip, skeleton=_joints(document, animation, clip))
    mesh = _read_mesh(document)
    assert isinstance(mesh.source, GltfSource)
    if animation is None and not mesh.source.animations:
        clip = Clip(mesh, mesh.vertices[None], fps or DEFAULT_FPS)
        return dataclasses.replace(clip, skeleton=still_joints(mesh))
    channels = select_channels(document, animation)
    own_fps = frame_rate(channels) or DEFAULT_FPS
    fps = fps or own_fps
    times = frame_times(document, channels, fps)
    check_clip_size(len(times), len(mesh.vertices), path)
    parts = unposed_vertices(document, mesh.source.rest, [(channel.node, channel.path) for channel in channels])
    frames = posed_vertices(document, parts, sample_nodes(document, channels, times))
    vertices = store_frames(frames, len(times), len(mesh.vertices), progress=progress)
    skeleton = GltfJoints(document, channels, times, mesh, whole=fps == own_fps)
    return Clip(mesh.with_vertices(vertices[0]), vertices, fps, skeleton=skeleton)


def still_joints(mesh: Mesh) -> GltfJoints | None:
    """Return the joints of a mesh as its glTF file has them at rest; None for other files, and moved vertices."""
    source = mesh.source
    if not isinstance(source, GltfSource) or not np.array_equal(mesh.vertices, source.vertices):
        return None
    return GltfJoints(source.document, [], np.zeros(1), mesh)


def _joints(document: Document, animation: str | None, clip: Clip) -> GltfJoints:
    """Return the joints of a clip without a mesh, which the shipped body plays."""
    channels, times = select_channels(document, animation), np.arange(len(clip)) / clip.fps
    person = None if clip.skeleton is None else clip.skeleton.person()
    whole = clip.fps == (frame_rate([channel for channel in channels if channel.path in PLAYED_PATHS]) or DEFAULT_FPS)
    return GltfJoints(document, channels, times, None, person, whole=whole)


def write_gltf(mesh: Mesh, path: Path) -> None:
    """Write a mesh as .glb, or as .gltf with embedded buffers.

    A mesh with a glTF source gives that file with its vertices changed, without skins and animations (see `gltf.edit`).
    Another mesh gives a new document, with smooth normals if it has none, because viewers show a mesh without normals
    faceted.
    """
    if isinstance(mesh.source, GltfSource):
        mesh.source.write(mesh, path)
    else:
        mesh = with_normals(mesh)
        build_document(mesh, mesh)[0].save(path)


def write_gltf_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as .glb or .gltf: the mesh at frame 0 and one morph target for each later frame (see `gltf.clip`).

    A mesh with a glTF source keeps all of that file but its skins, animations and morph targets. One frame gives a file
    without animation. The size is about 24 bytes a vertex and frame: positions and normals in float32.
    """
    mesh = with_normals(clip.mesh)
    base = mesh.with_vertices(np.asarray(clip.vertices[0], np.float64))
    if isinstance(mesh.source, GltfSource):
        draft, groups = edit_document(mesh.source, base)
    else:
        draft, groups = build_document(mesh, base)
    if len(clip) > 1:
        add_morph_animation(draft, groups, mesh, clip, progress)
    draft.save(path)


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
