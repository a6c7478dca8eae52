"""glTF 2.0 in and out (.glb, .vrm, .gltf): a character at rest, the same file with its points moved, an animated one.

gltf_check -> gltf_document -> gltf_scene -> gltf_read          a file becomes a Mesh
gltf_draft -> gltf_move -> gltf_primitives -> gltf_edit         its source, written back
gltf_animation -> gltf_bake                                     its animations as points
              gltf_motion                                       joints without a mesh, on the shipped body
              gltf_build, gltf_clip                             a Mesh from elsewhere, frames as morph targets
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ...core.frame_buffer import Progress, store_frames
from ...core.mesh import Clip, Mesh, check_mesh
from ..timing import DEFAULT_FPS
from .animation import frame_rate, select_channels
from .bake import bake_frames
from .blend_shapes import fit_blend_shapes
from .build import build_document
from .check import is_supported
from .clip import add_morph_animation
from .document import Document, open_document
from .edit import GltfSource, edit_document, with_normals
from .motion import is_motion, read_motion_clip, read_motion_mesh
from .read import RestScene, read_rest


def read_gltf(path: Path) -> Mesh:
    """Read the default scene of a .glb, .vrm or .gltf file at rest, in world coordinates and the file's units.

    Node transforms, default morph weights and skins (at the rest transforms of their joints) are applied. Vertices keep
    the file's order and its splits at seams. Animations, lines, points beside triangles, and scenes other than the
    default are not read; they stay in `Mesh.source`, whose `notes` say what writing the file again leaves out. Of a
    file with animations and no mesh it is the shipped body in the first frame (see `gltf_motion`), without a source.

    Raises:
        InputError: the file is damaged, compressed, not glTF 2.0, or shows no triangles and no person's joints move.
    """
    document = open_document(path)
    return read_motion_mesh(document) if is_motion(document) else _read_mesh(document)


def _read_mesh(document: Document) -> Mesh:
    path = document.path
    mesh, rest = read_rest(document)
    check_mesh(mesh, path)
    source = GltfSource(document, rest, mesh.vertices, path.suffix.lower(), _list_notes(document, rest))
    return dataclasses.replace(mesh, source=source)


def read_gltf_clip(
    path: Path, fps: float | None = None, animation: str | None = None, progress: Progress | None = None
) -> Clip:
    """An animation of a .glb, .vrm or .gltf file, baked to points; one frame where it has none and none is wanted.

    Joints without a mesh are played by the shipped body (see `gltf_motion`).

    Args:
        fps: frames a second; None: those that the file's keys lie on, else 30. Frame k is at k / fps seconds.
        animation: its name, the name behind its last "|", or its number; None: the first, and with it those that move
            other nodes.

    Raises:
        InputError: as `read_gltf`, no such animation, or a damaged one.
    """
    document = open_document(path)
    if is_motion(document):
        return read_motion_clip(document, fps, animation, progress)
    mesh = _read_mesh(document)
    assert isinstance(mesh.source, GltfSource)
    if animation is None and not mesh.source.animations:
        return Clip(mesh, mesh.vertices[None], fps or DEFAULT_FPS)
    channels = select_channels(document, animation)
    fps = fps or frame_rate(channels) or DEFAULT_FPS
    count, frames = bake_frames(document, mesh.source.rest, channels, fps)
    vertices = store_frames(frames, count, len(mesh.vertices), progress=progress)
    return Clip(mesh.with_vertices(vertices[0]), vertices, fps)


def write_gltf(mesh: Mesh, path: Path) -> None:
    """Write a mesh as .glb or as .gltf with everything inside: the file it came from, points moved, if it has one.

    A mesh from elsewhere gets a document of its own, with smooth normals if it has none (viewers show a mesh without
    normals faceted). Skin and animations are not written; see `gltf_edit`.
    """
    if isinstance(mesh.source, GltfSource):
        mesh.source.write(mesh, path)
    else:
        mesh = with_normals(mesh)
        build_document(mesh, mesh)[0].save(path)


def write_gltf_clip(
    clip: Clip, path: Path, progress: Progress | None = None, blendshapes: int | None = None
) -> float | None:
    """Write a clip as .glb or .gltf: the mesh at frame 0 and one morph target for each later frame (see `gltf_clip`).

    A mesh that came from a glTF file keeps all of it but skin, animations and morph targets of its own. One frame
    gives a file without animation. The size is about 24 bytes a vertex and frame (normals included).

    Args:
        blendshapes: so many morph targets in all, mixed to show every frame as well as they can (see `blend_shapes`).

    Returns:
        How far a vertex is then from its frame at most, in the mesh's unit; None without `blendshapes`.
    """
    mesh = with_normals(clip.mesh)
    blend = None if blendshapes is None or len(clip) == 1 else fit_blend_shapes(clip, blendshapes, progress)
    first = np.asarray(clip.vertices[0], np.float64) if blend is None else blend.base
    shown = mesh.with_vertices(first)
    if isinstance(mesh.source, GltfSource):
        draft, groups = edit_document(mesh.source, shown, keep_targets=False)
    else:
        draft, groups = build_document(mesh, shown)
    if len(clip) > 1:
        add_morph_animation(draft, groups, mesh, clip, progress, blend)
    draft.save(path)
    return None if blend is None else blend.max_error


def _list_notes(document: Document, rest: RestScene) -> tuple[str, ...]:
    """What a written file does not have, or has in another way, one line each."""
    gltf = document.gltf
    notes = []
    skins, animations = len(gltf.get("skins", [])), len(gltf.get("animations", []))
    if skins or animations:
        found = [_count_text(skins, "skin"), _count_text(animations, "animation")]
        notes.append(f"dropped {' and '.join(text for text in found if text)} that the file had")
    nodes = list(dict.fromkeys(span.node for span in rest.vertex_ranges))
    meshes = {gltf["nodes"][node]["mesh"] for node in nodes}
    if len(meshes) < len(nodes):
        notes.append(
            f"gave each of {len(nodes)} nodes a mesh of its own, {len(meshes)} were shared: they now move apart"
        )
    for image, content in zip(gltf.get("images", []), document.images, strict=True):
        if content is None:
            notes.append(f"kept the reference to image {image.get('uri', '')[:80]!r}, which is not there")
    for name in gltf.get("extensionsUsed", []):
        if not is_supported(str(name)):
            notes.append(f"kept the data of extension {name} as it is: it does not follow the new shape")
    return tuple(notes)


def _count_text(number: int, name: str) -> str:
    return "" if not number else f"the {name}" if number == 1 else f"{number} {name}s"
