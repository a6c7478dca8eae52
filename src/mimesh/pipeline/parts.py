"""Take the part of a mesh that is meant: a character in a scene with floors, pedestals, props and other people.

The part is looked at and moved as a mesh of its own; all other vertices stay where they are. A part is what its file
calls so: an object, a group, a node with all that is below it. Of a file with a rig, what no joint carries is left out
by itself.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.animated_rig import AnimatedRig
from ..core.errors import InputError, option
from ..core.frame_buffer import LazyFrames, Progress
from ..core.geometry import component_labels, edges, face_areas, weld
from ..core.mesh import Clip, Mesh, chosen_faces
from ..core.normalization import flat_side, opposite
from ..core.options import MotionOptions
from ..core.printable import listed
from ..io.formats import may_have_joints
from .placed import FoundJoints, Moved
from .result import Precision, Timer

if TYPE_CHECKING:
    from ..io.gltf.edit import GltfSource
    from .joint_route import JointRoute
    from .node_route import NodeRoute
    from .vertex_route import VertexRoute

BASE_FLAT = 0.1
"""Share of the surface of a base that lies in its flat side, at least; of a person on it soles do, 0.02."""
LONGEST_SHOE, SAME_SHOE = 0.35, 0.05
"""Length of a shoe over the height of a mesh, at most, and by how much areas of a pair differ. Shoes and boots that are
pieces of their own are as flat as a base."""
MOST_NAMED = 12
"""Parts that a message names."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A part of a mesh, as a mesh of its own."""

    whole: Mesh
    mesh: Mesh
    index: Int[np.ndarray, " U"]
    """Vertices of the whole that are those of the part."""
    notes: tuple[str, ...] = ()
    """What the user should know of the choice."""

    def placed(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
        """Return the vertices of the whole, of which those of the part are moved."""
        placed = self.whole.vertices.copy()
        placed[self.index] = vertices
        return placed

    def frames(self, moved: LazyFrames) -> LazyFrames:
        """Return the whole in frames of the part."""

        def make(chosen: Int[np.ndarray, " N"]) -> Iterator[Float[np.ndarray, "V 3"]]:
            return (self.placed(points) for points in moved.at(chosen))

        return LazyFrames((len(moved), len(self.whole.vertices)), make, moved.dtype)

    def rig(self, skeleton: AnimatedRig) -> AnimatedRig:
        """Return the rig of the part as that of the whole, of which all else has no joints."""
        mine = np.arange(len(self.index)) if skeleton.group is None else skeleton.group
        group = np.full(len(self.whole.vertices), -1)
        group[self.index] = mine
        whole = dataclasses.replace(self.whole, up=skeleton.mesh.up)
        mesh = whole.with_vertices(self.placed(skeleton.mesh.vertices))
        return dataclasses.replace(skeleton, mesh=mesh, group=group)

    def clip(self, clip: Clip) -> Clip:
        """Return the part of a clip of the whole, with the joints of its file that carry it."""
        skeleton: Any = clip.skeleton
        if getattr(skeleton, "mesh", None) is not None:
            at_rest = dataclasses.replace(self.mesh, vertices=skeleton.mesh.vertices[self.index])
            skeleton = dataclasses.replace(skeleton, mesh=at_rest)
        first = dataclasses.replace(self.mesh, vertices=clip.mesh.vertices[self.index])
        return dataclasses.replace(clip, mesh=first, vertices=clip.vertices[:, self.index], skeleton=skeleton)


@dataclass(frozen=True, eq=False)
class PartRoute:
    """The way from a part of an identity to a result; all else stays."""

    route: JointRoute | VertexRoute | NodeRoute
    part: MeshPart | None
    """Part of the identity; None: it is moved as a whole, and the driving has parts."""
    driving: MeshPart | None

    @property
    def identity(self) -> Mesh:
        """The whole."""
        moved = self.route.identity
        return moved if self.part is None else dataclasses.replace(self.part.whole, up=moved.up)

    @property
    def clip(self) -> Clip:
        """The clip that is followed."""
        return self.route.clip

    def with_refinement(self, refine: bool | None) -> PartRoute:
        """Switch refinement on or off."""
        return dataclasses.replace(self, route=self.route.with_refinement(refine))

    def frame(self, t: int) -> Float[np.ndarray, "V 3"]:
        """Make the identity's vertices in frame t only."""
        return self.placed(self.route.frame(t))

    def placed(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
        """Return the identity with moved vertices of its part."""
        return vertices if self.part is None else self.part.placed(vertices)

    def joints(self, t: int) -> FoundJoints | None:
        """Return the joints of both meshes, if these have any with roles."""
        return self.route.joints(t)

    def play(
        self, timer: Timer, options: MotionOptions, progress: Progress | None = None, dtype: Precision = np.float64
    ) -> Moved:
        """Move the part in all frames, and report."""
        moved = self.route.play(timer, options, progress, dtype)
        notes = tuple(note for part in (self.part, self.driving) if part is not None for note in part.notes)
        moved = dataclasses.replace(moved, notes=moved.notes + notes)
        if self.part is None:
            return moved
        skeleton = moved.skeleton and self.part.rig(moved.skeleton)
        source: Any = self.part.whole.source
        own = moved.own and dataclasses.replace(moved.own, source=source)
        return dataclasses.replace(moved, frames=self.part.frames(moved.frames), skeleton=skeleton, own=own)


def find_part(mesh: Mesh, name: str | None, asked: str = "part") -> MeshPart | None:
    """Find the part of a mesh that is meant; None: all of it.

    Args:
        name: of a part, or of a node above some; one with a skin stands for all that its joints move. None: what joints
            carry, in a file with the rig of a character.
        asked: the option that names it.

    Raises:
        InputError: no such part, or nobody says which of several characters is meant.
    """
    source = _gltf_source(mesh)
    if name is not None:
        chosen = _named(mesh, name, asked)
        if source is not None:
            from ..io.gltf.parts import with_skeleton

            chosen = with_skeleton(mesh, chosen)
        return _cut(mesh, chosen)
    if source is None:
        return _without_base(mesh, asked)
    from ..io.gltf.parts import characters, static_parts
    from .gltf_rigs import rig_facts

    people = characters(mesh)
    if len(people) > 1:
        raise InputError(
            f"{mesh.name}: expected one character, found {len(people)}: {', '.join(people)}; say which with "
            f"{option(asked, ...)}"
        )
    static = static_parts(mesh)
    if static.any() and not static.all():
        part = _cut(mesh, ~static)
        facts = rig_facts(part.mesh)
        if facts is not None and facts.used:
            names = listed(
                list(dict.fromkeys(part.name for part in itertools.compress(mesh.parts, static))), MOST_NAMED
            )
            note = f"{mesh.name} has parts that no joint and no animation moves, which stay where they are: {names}"
            return dataclasses.replace(part, notes=(note,) if asked == "part" else ())
    return None if source.document.gltf.get("skins") else _without_base(mesh, asked)


def _gltf_source(mesh: Mesh) -> GltfSource | None:
    """Return the glTF file that a mesh was read from; None for other formats, without loading what reads glTF."""
    if not may_have_joints(mesh):
        return None
    from ..io.gltf.edit import GltfSource

    return mesh.source if isinstance(mesh.source, GltfSource) else None


def _without_base(mesh: Mesh, asked: str) -> MeshPart | None:
    """Find the figure on a base that no edge connects with it; None where there is no base, or no figure is left."""
    side, lying = flat_side(mesh)
    if side is None or mesh.up not in (None, opposite(side)):
        return None
    merged, position = weld(mesh.vertices)
    faces = position[mesh.faces]
    component = component_labels(edges(faces), len(merged))[faces[:, 0]]
    area, count = face_areas(mesh.vertices, mesh.faces), component.max() + 1
    lies, all_of = np.bincount(component[lying], area[lying], count), np.bincount(component, area, count)
    flat = lies / all_of.clip(1e-30) > BASE_FLAT  # soles on a floor may be in its side, too
    flat[_shoes(mesh, component, np.flatnonzero(flat), np.stack([lies, all_of], axis=1), side)] = False
    base = flat[component]
    kept = np.flatnonzero(~base)
    if not base.any() or len(kept) < len(mesh.faces) / 2:
        return None
    note = f"the base of {mesh.name} stays where it is, and is not looked at; {option(asked, ...)} takes another part"
    if _gltf_source(mesh) is not None:
        whole = np.array([not base[part.start : part.stop].any() for part in mesh.parts], bool)
        pure = all(base[part.start : part.stop].all() for part, kept in zip(mesh.parts, whole, strict=True) if not kept)
        return dataclasses.replace(_cut(mesh, whole), notes=(note,)) if pure and whole.any() else None
    index = np.unique(mesh.faces[kept])
    return MeshPart(mesh, chosen_faces(mesh, kept, index), index, (note,))


def _shoes(
    mesh: Mesh,
    component: Int[np.ndarray, " F"],
    flat: Int[np.ndarray, " K"],
    areas: Float[np.ndarray, "C 2"],
    side: str,
) -> Int[np.ndarray, " S"]:
    """Find the flat components that are shoes: short, and another one has the same areas, in the side and in all.

    A floor may be of thousands of tiles: none of them is compared with all others.
    """
    from scipy.spatial import KDTree

    up = "xyz".index(side[1])
    points, of = np.delete(mesh.vertices[mesh.faces.ravel()], up, axis=1), np.repeat(component, 3)
    low, high = np.full((len(areas), 2), np.inf), np.full((len(areas), 2), -np.inf)
    np.minimum.at(low, of, points)
    np.maximum.at(high, of, points)
    length = (high - low).max(axis=1)[flat]
    short = flat[length < LONGEST_SHOE * np.ptp(mesh.vertices[:, up])]
    if len(short) < 2:
        return short[:0]
    logs = np.log(areas[short])
    apart = np.asarray(KDTree(logs).query(logs, k=2, p=np.inf)[0])[:, 1]
    return short[apart <= np.log1p(SAME_SHOE)]


def named_parts(mesh: Mesh) -> dict[str, Bool[np.ndarray, " P"]]:
    """Return the parts of a mesh by each name that finds them: characters, parts, and nodes above these."""
    above = [(part.name, part.object) for part in mesh.parts]
    people: dict[str, np.ndarray] = {}
    if _gltf_source(mesh) is not None:
        from ..io.gltf.parts import characters, names_above

        above, people = names_above(mesh), characters(mesh)
    named = dict(people)
    for k, names in enumerate(above):
        for name in names:
            if name not in people:
                named.setdefault(name, np.zeros(len(above), bool))[k] = True
    return named


def _named(mesh: Mesh, name: str, asked: str) -> Bool[np.ndarray, " P"]:
    """Tell which parts of a mesh have a name, or are below a node that has it; case counts only where it decides."""
    named = named_parts(mesh)
    for fold in (str, str.casefold):
        same = [mask for known, mask in named.items() if fold(known) == fold(name)]
        if same:
            return np.any(same, axis=0)
    found = listed(list(named), MOST_NAMED) or "it has none"
    raise InputError(f"{mesh.name}: expected one of its parts ({found}) for {option(asked, name)}; name one of them")


def _cut(mesh: Mesh, chosen: Bool[np.ndarray, " P"]) -> MeshPart:
    faces = np.concatenate([np.arange(p.start, p.stop) for p, take in zip(mesh.parts, chosen, strict=True) if take])
    if _gltf_source(mesh) is not None:
        from ..io.gltf.parts import gltf_part

        return MeshPart(mesh, *gltf_part(mesh, chosen, faces))
    index = np.unique(mesh.faces[faces])
    return MeshPart(mesh, chosen_faces(mesh, faces, index), index)
