"""Collect facts about a mesh file, and problems of its surface: `mimesh look`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..bodies.anatomy import body_of_joints
from ..bodies.joint_names import person_joints
from ..core.errors import RefusedMeshError
from ..core.geometry import component_labels, edges, face_areas, face_vectors, weld
from ..core.mesh import Clip, Mesh
from ..core.printable import listed, printable
from ..io.beside import missing_images, missing_images_notes
from ..io.polygons import polygon_sizes
from ..methods.find import find_mime
from ..pipeline.file_rigs import NO_RIGS
from ..pipeline.gltf_rigs import Stance, known_joints, rig_facts
from ..pipeline.joint_route import found_character
from ..pipeline.known import Corrections
from ..pipeline.look import KINDS, Subject, joint_finder
from .notes import unit_guess

MOST_NAMES = 6
"""Names of parts or materials that are listed."""
UNLIKE = "looks neither like a person nor like a four-legged animal, as far as can be told"


@dataclass(frozen=True)
class FileFacts:
    """Everything `mimesh look` prints about one file; None where a fact does not apply or is unknown."""

    name: str
    format: str
    vertices: int
    positions: int
    """Distinct positions; formats that split vertices at seams hold fewer of these than vertices."""
    faces: int
    """Triangles; larger polygons are split into fans."""
    polygons: int | None
    """Faces in the file before they are split, where known."""
    components: int
    """Connected components, across vertices at one position; 0 for a point cloud."""
    low: tuple[float, float, float]
    """Corner of the bounding box, in the file's unit."""
    high: tuple[float, float, float]
    """The opposite corner."""
    unit_guess: str | None
    """Unit in which the longest side would be that of a person: m, dm, cm, mm or inch."""
    watertight: bool
    """Every edge joins exactly two faces."""
    boundary_edges: int
    non_manifold_edges: int
    """Edges of three faces or more."""
    consistent_winding: bool
    """Adjacent faces agree on which side is the outside."""
    inside_out: bool | None
    """The enclosed volume is negative; None for sheets, point clouds and mixed winding."""
    degenerate_faces: int
    """Triangles without area."""
    duplicate_faces: int
    """Triangles on the same three positions as an earlier one."""
    loose_vertices: int
    """Vertices of no face; 0 for a point cloud."""
    has_uv: bool
    has_normals: bool
    has_colors: bool
    parts: tuple[str, ...]
    materials: tuple[str, ...]
    textures: int
    frames: int
    """1 for a mesh that does not move."""
    fps: float | None
    seconds: float | None
    animations: tuple[str, ...]
    """Names of the animations in the file; the clip is the first."""
    details: tuple[tuple[str, str], ...]
    """Further facts of the format, as name and value: unit, axes, joints, blend shapes, body of a motion."""
    stands: str | None
    """Axes up and front, by the rig or detected from the shape, and what it is taken for; None for a point cloud."""
    axes: tuple[str, str] | None
    """These axes, such as "+y", "+z"; None where nothing is known of them."""
    notes: tuple[str, ...]
    """Contents of the file that a result in its format will not have, one line each."""
    missing_images: tuple[str, ...]
    """Images that the file names and that do not exist."""

    @property
    def size(self) -> tuple[float, float, float]:
        """Extent along x, y and z, in the file's unit."""
        x, y, z = (high - low for low, high in zip(self.low, self.high, strict=True))
        return x, y, z

    def text(self) -> str:
        """Return one aligned line for each fact; warnings come last."""
        rows = list(_rows(self))
        rows += [("on writing", note) for note in self.notes] + [("warning", warning) for warning in self.warnings()]
        width = max(len(key) for key, _ in rows) + 2
        lines = [self.name, *(f"  {key:<{width}}{value}" for key, value in rows)]
        return "\n".join(map(printable, lines))  # names in the file may contain line ends

    def warnings(self) -> list[str]:
        """Return problems that may spoil a transfer, most serious first, each with what to do."""
        return list(_warnings(self))

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON, with `size` and `warnings`."""
        return dataclasses.asdict(self) | {"size": self.size, "warnings": self.warnings()}


def inspect_file(path: str | Path) -> FileFacts:
    """Read a mesh, a clip or a folder of frames and collect its facts."""
    from ..io import load_clip

    clip = load_clip(path)
    facts = facts_of(clip.mesh, clip, path)
    facts = dataclasses.replace(facts, details=facts.details + tuple(("note", note) for note in clip.notes))
    if clip.mesh.source is not None:
        return facts
    animations, details = _other_facts(Path(path), clip)
    return dataclasses.replace(facts, animations=animations, details=facts.details + details)


def facts_of(mesh: Mesh, clip: Clip | None = None, path: str | Path | None = None) -> FileFacts:
    """Collect the facts of a mesh in memory, and of its clip and its file where given."""
    path = None if path is None else Path(path)
    rig = rig_facts(mesh, lambda character: joint_finder(find_mime("mime"), (None, None))(character))
    rig_details = () if rig is None else (("rig", rig.text if rig.used else f"not used: {rig.text}"),)
    stance = (rig and rig.stance) or (_stance(mesh) if len(mesh.faces) else None)
    merged, index = weld(mesh.vertices)
    faces = index[mesh.faces]
    # Faces between three distinct positions.
    proper = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    # The topology is that of welded positions: formats split vertices at seams of UVs and normals.
    counts, balance = _edge_use(proper)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    materials = list(dict.fromkeys(part.material for part in mesh.parts if part.material))
    consistent = not (balance != 0)[counts == 2].any()
    moving = clip is not None and len(clip) > 1
    return FileFacts(
        name=path.name if path else mesh.name,
        format="memory" if path is None else "folder" if path.is_dir() else path.suffix.lstrip(".").lower(),
        vertices=len(mesh.vertices),
        positions=len(merged),
        faces=len(mesh.faces),
        polygons=len(polygon_sizes(mesh)) if hasattr(mesh.source, "sizes") else None,
        components=len(np.unique(component_labels(edges(proper), len(merged))[proper[:, 0]])),
        low=_triple(low),
        high=_triple(high),
        unit_guess=unit_guess(float((high - low).max())),
        watertight=len(counts) > 0 and bool((counts == 2).all()),
        boundary_edges=int((counts == 1).sum()),
        non_manifold_edges=int((counts > 2).sum()),
        consistent_winding=consistent,
        inside_out=_inside_out(merged, proper, counts) if consistent else None,
        degenerate_faces=int((face_areas(mesh.vertices, mesh.faces) == 0).sum()),
        duplicate_faces=len(proper) - len(np.unique(np.sort(proper, axis=1), axis=0)),
        loose_vertices=len(mesh.vertices) - len(np.unique(mesh.faces)) if len(mesh.faces) else 0,
        has_uv=mesh.corner_uv is not None,
        has_normals=mesh.corner_normals is not None,
        has_colors=mesh.vertex_colors is not None,
        parts=tuple(part.name for part in mesh.parts),
        materials=tuple(material.name for material in materials),
        textures=len({material.texture for material in materials if material.texture}),
        frames=len(clip) if clip is not None else 1,
        fps=float(clip.fps) if clip is not None and moving else None,
        seconds=float(clip.seconds) if clip is not None and moving else None,
        animations=getattr(mesh.source, "animations", ()),  # not all formats have these three
        details=getattr(mesh.source, "details", ()) + rig_details,
        stands=stance.text if stance else None if not len(mesh.faces) else UNLIKE,
        axes=stance.axes if stance else None,
        notes=getattr(mesh.source, "notes", ()) if rig is None or not rig.used else (),
        missing_images=missing_images(mesh),
    )


def _rows(facts: FileFacts) -> Iterator[tuple[str, str]]:
    split = f" at {facts.positions:,} positions" if facts.positions != facts.vertices else ""
    yield "format", facts.format
    yield from facts.details
    yield "vertices", f"{facts.vertices:,}{split}"
    triangles = f" triangles from {facts.polygons:,} polygons" if facts.polygons not in (None, facts.faces) else ""
    yield "faces", f"{facts.faces:,}{triangles}" if facts.faces else "none (a point cloud)"
    if facts.faces:
        yield "components", f"{facts.components:,}"
    unit = f" (a person, if the unit is {facts.unit_guess})" if facts.unit_guess else ""
    yield "size", " x ".join(f"{side:.4g}" for side in facts.size) + unit
    yield "bounds", " to ".join("(" + ", ".join(f"{v:.4g}" for v in corner) + ")" for corner in (facts.low, facts.high))
    if facts.stands:
        yield "stands", facts.stands
    if facts.faces:
        border = f"open, {_plural(facts.boundary_edges, 'boundary edge')}" if facts.boundary_edges else ""
        yield "surface", "closed" if facts.watertight else border or "closed, non-manifold"
    looks = ["UVs"] * facts.has_uv + ["normals"] * facts.has_normals + ["vertex colours"] * facts.has_colors
    looks += [_plural(facts.textures, "texture")] * bool(facts.textures)
    yield "looks", ", ".join(looks) or "no UVs, normals or textures"
    if facts.parts:
        yield "parts", _names(facts.parts)
    if facts.materials:
        yield "materials", _names(facts.materials)
    if facts.fps and facts.seconds:
        yield "clip", f"{facts.frames:,} frames at {facts.fps:g} per second, {facts.seconds:.2f} s"


def _warnings(facts: FileFacts) -> Iterator[str]:
    yield from missing_images_notes(facts.missing_images)
    if facts.inside_out:
        yield "the faces look inwards; flip them"
    if not facts.consistent_winding:
        yield "neighbouring faces disagree on which side is out; recalculate the winding"
    if facts.non_manifold_edges:
        yield f"{_plural(facts.non_manifold_edges, 'edge')} of three or more faces; a clean surface has none"
    if facts.degenerate_faces:
        yield f"{_plural(facts.degenerate_faces, 'face')} without area; dissolve them"
    if facts.duplicate_faces:
        yield f"{_plural(facts.duplicate_faces, 'face')} drawn twice; delete the copies"
    if facts.loose_vertices:
        yield f"{_plural(facts.loose_vertices, 'vertex', 'vertices')} of no face; delete them if they mean nothing"


def _names(names: tuple[str, ...]) -> str:
    return f"{len(names)}: {listed(list(dict.fromkeys(names)), MOST_NAMES)}"


def _plural(count: int, singular: str, plural: str | None = None) -> str:
    return f"{count:,} {singular if count == 1 else plural or singular + 's'}"


def _other_facts(path: Path, clip: Clip) -> tuple[tuple[str, ...], tuple[tuple[str, str], ...]]:
    from ..io.formats import ANIMATED, is_body_model
    from ..io.gltf.animation import animation_names, document_details
    from ..io.gltf.document import open_document
    from ..io.gltf.motion import gltf_joints, read_skeleton
    from ..motions.amass import recording_facts
    from ..motions.on_body import BVH, is_motion_file, motion_joints

    if path.suffix.lower() in ANIMATED:
        document = open_document(path)
        skeleton = read_skeleton(document)
        motion = _motion_detail(gltf_joints(document), skeleton.joint_names, skeleton.parents, clip)
        return animation_names(document), (motion, *document_details(document))
    if path.is_file() and is_body_model(path):
        return (), (("body model", "its mean shape at rest, which these facts describe"),)
    if not is_motion_file(path):
        return (), ()
    names, parents = motion_joints(path)
    recorded = () if path.suffix.lower() == BVH else recording_facts(path)
    return (), (_motion_detail(len(names), names, parents, clip), *recorded)


def _motion_detail(joints: int, names: tuple[str, ...], parents: tuple[int, ...], clip: Clip) -> tuple[str, str]:
    animal = clip.skeleton is not None and body_of_joints(clip.skeleton.person().joints) == "quadruped"
    known = "of a four-legged animal" if animal else known_joints(person_joints(names, parents))
    return "motion", f"{_plural(joints, 'joint')}, {known}, played on the shipped body, which these facts describe"


def _stance(mesh: Mesh) -> Stance | None:
    """Find up and front of a mesh, and what it is taken for, as `mimesh rig` takes it; None of what is refused."""
    subject = Subject(mesh, (None, None))
    try:
        seen, _, norm = found_character(find_mime("mime"), subject, "auto", NO_RIGS, Corrections())
    except RefusedMeshError:
        return None
    by_file = " (by the file)" if norm.up_from == "file" else ""
    guess = " (a guess)" if norm.unsure else ""
    text = f"up {norm.up}{by_file}, front {norm.front}, taken for {KINDS[seen.body]}{guess}"
    return Stance((norm.up, norm.front), text)


def _triple(vector: Float[np.ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in vector)
    return x, y, z


def _edge_use(faces: Int[np.ndarray, "F 3"]) -> tuple[Int[np.ndarray, " E"], Int[np.ndarray, " E"]]:
    """Count the faces at each edge, and how many more have it from the smaller index to the larger than reversed."""
    pairs = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forward = np.where(pairs[:, 0] < pairs[:, 1], 1, -1)
    _, edge, counts = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True, return_counts=True)
    balance = np.bincount(edge.reshape(-1), forward, minlength=len(counts)).astype(np.int64)
    return counts.astype(np.int64), balance


def _inside_out(vertices: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "F 3"], counts) -> bool | None:
    """Whether the faces enclose a negative volume; None where more than 5 % of the edges are open."""
    if len(faces) == 0 or (counts == 1).sum() > 0.05 * len(counts):
        return None
    # Signed volumes of the tetrahedra from the centroid to each face; the centroid makes open edges matter least.
    local = vertices - vertices[faces].mean(axis=(0, 1))
    return bool((local[faces[:, 0]] * face_vectors(local, faces)).sum() < 0)
