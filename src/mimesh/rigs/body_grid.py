"""Corresponding points on the surfaces of people: rings around trunk, head, arms and legs.

A part of the body is a line between two joints in a T-pose. Its points have the same place along the line and the same
direction from it on every person; only their distance, the girth, is the person's own. They move with the skin.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..bodies.joint_names import ancestors
from ..core.geometry import unit_vectors
from ..core.mesh import Mesh
from ..core.rig import Rig
from ..core.skinning import SkinnedMesh, skin_points
from ..core.surface_points import SurfacePoints, generator, interpolate

Line = tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]
"""Start and end of a part's line."""
ROWS: dict[str, tuple[int, list[tuple[float, float]]]] = {
    "Trunk": (16, [(0, -50), (0, 0), (0.2, 0), (0.4, 0), (0.6, 0), (0.8, 0), (1, 0), (1, 40)]),
    "Head": (12, [(0, -45), (0, -15), (0.5, 0), (1, 15), (1, 45), (1, 80)]),
    "UpLeg": (10, [(0.1, 0), (0.3, 0), (0.5, 0), (0.7, 0), (0.9, 0)]),
    "Leg": (8, [(0.1, 0), (0.35, 0), (0.6, 0), (0.85, 0)]),
    "Arm": (8, [(0.35, 0), (0.65, 0), (0.95, 0)]),
    "ForeArm": (8, [(0.2, 0), (0.45, 0), (0.7, 0), (0.95, 0)]),
    "Hand": (8, [(0.3, 0), (0.8, 0), (1, 10), (1, 60)]),
}
"""Of each part the points of a ring, and the rings: share of the line, and elevation at its ends (degrees)."""
PARTS = ("Trunk", "Head", *(side + part for side in SIDES for part in ROWS if part not in ("Trunk", "Head")))
NEEDED = frozenset(side + joint for side in SIDES for joint in ("Arm", "ForeArm", "Hand", "UpLeg"))
"""Joints without which there are no points."""
SAMPLES = 16384
"""Points of a surface among which its girths are measured. With a quarter of them, others of the same
surface moved hands by up to 2 to 5 % of the height, where contacts move them by 6 to 9; now by 0.7 to 2."""
NEAREST = 32
"""Samples of the surface whose mean distance is the girth at a point, for each 4096 of all."""
WIDTH = 0.25
"""Standard deviation of their weights (radians around the line). Medians of 8 samples differed twice as much between
samples of one surface (hands 1.5 cm, heads 0.8)."""
FEWEST = 12
"""Samples of the surface that a part has at least."""
HEAD_TOP, FINGERTIPS = 1.2, 0.7
"""Where the line of a head ends: median height of its surface over the joint times this (hair and ears are above it).
Where that of a hand does: share of the length of the hand."""

END_OF_FOREARM = 0.75
"""Share of its length from which on a forearm is the hand, where no joint of a hand moves a surface."""


@dataclass(frozen=True, eq=False)
class BodyGrid:
    """Points on the surface of a person, and which part each belongs to."""

    skinned: SkinnedMesh
    """The G points, then the same points moved along their normals."""
    rest: Float[np.ndarray, "G 3"]
    """The points in a T-pose."""
    parts: dict[str, slice]
    """Part, such as Trunk or LeftHand -> its points among the G."""
    arm: float
    """Length of an arm, from shoulder to wrist: the unit of distances."""
    rings: SkinnedMesh
    """Centres of the R rings of points."""
    radius: Float[np.ndarray, " R"]
    """Radii of spheres around them that the points are in (arm lengths)."""
    ring: Int[np.ndarray, " G"]
    """Ring of each point."""

    @classmethod
    def of_pose(cls, mesh: Mesh, rig: Rig, names: tuple[str, ...], parents: tuple[int, ...]) -> BodyGrid | None:
        """Find the points on a surface in any pose; see `of`.

        Args:
            mesh: the surface; without triangles, samples of it.
            rig: the joints in that pose, with the weights of its vertices.
        """
        bones = np.concatenate([np.zeros((1, 3)), rig.bones(parents)])
        joints = np.stack([bones[ancestors(parents, j)].sum(axis=0) for j in range(len(parents))])
        undo = rig.rotation.swapaxes(-1, -2)
        points, weights = mesh.vertices, rig.weights
        points = skin_points(points, weights, undo, joints - (undo @ rig.joints[..., None])[..., 0])
        if len(mesh.faces):  # sampled in the T-pose, so that samples of one body in two poses are the same
            surface = SurfacePoints.of(Mesh(points, mesh.faces), SAMPLES, generator(0, 2))
            points, weights = surface.points(points), interpolate(weights, surface.corners, surface.barycentric)
        return cls.of(points, weights, joints, names, parents)

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "N 3"],
        weights: Float[np.ndarray, "N J"],
        joints: Float[np.ndarray, "J 3"],
        names: tuple[str, ...],
        parents: tuple[int, ...],
    ) -> BodyGrid | None:
        """Find the points on a surface in a T-pose; None where shoulders, hips, elbows or wrists are not known.

        Args:
            points: samples of the surface.
            weights: their weights.
            joints: positions of the joints.
            names: for each joint the joint of the shipped body that it is or is below.
            parents: parent of each joint.
        """
        place = {name: joints[j] for j, name in reversed(list(enumerate(names)))}  # the topmost joint of a name
        if not place.keys() >= NEEDED:
            return None
        # Of the joints of a part together: with twist bones a limb has several.
        labels, column = np.unique([part_of_joint(name) for name in names], return_inverse=True)
        part_of = labels[(weights @ np.eye(len(labels))[column]).argmax(axis=1)]
        arm = float(np.mean([np.linalg.norm(place[f"{side}Hand"] - place[f"{side}Arm"]) for side in SIDES]))
        parts, found, sizes, count = {}, [], [], 0
        nearest = NEAREST * max(1, len(points) // 4096)
        for part in PARTS:
            rows = np.flatnonzero(part_of == part)
            if part.endswith("Hand"):
                above = part.replace("Hand", "ForeArm")
                wrist, elbow = place[part], place[above]
                length = np.linalg.norm(wrist - elbow)
                if len(rows) < FEWEST:  # of blocks whose forearms end in hands: the end
                    rows = np.flatnonzero(part_of == above)
                    rows = rows[(points[rows] - elbow) @ (wrist - elbow) / length**2 > END_OF_FOREARM]
                # Not of a prop in it: a hand is shorter than its forearm.
                rows = rows[np.linalg.norm(points[rows] - wrist, axis=1) < length]
            line = _line(part, place, points[rows]) if len(rows) >= FEWEST else None
            if line is not None:
                found.append(_rings(part, line, points[rows], weights[rows], nearest))
                parts[part] = slice(count, count := count + len(found[-1][0]))
                around, rows = ROWS[part.removeprefix("Left").removeprefix("Right")]
                sizes += len(rows) * [around]
        if not found:  # almost all of the surface is a prop's
            return None
        grid, normals, weights = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
        step, still = 0.1 * arm, np.broadcast_to(np.eye(3), (len(joints), 3, 3))
        skinned = SkinnedMesh.of(
            np.concatenate([grid, grid + step * normals]), Rig(still, joints, np.tile(weights, (2, 1))), parents
        )
        ring, starts = np.repeat(np.arange(len(sizes)), sizes), np.cumsum([0, *sizes[:-1]])
        centres, means = (np.add.reduceat(of, starts) / np.array(sizes)[:, None] for of in (grid, weights))
        radius = np.maximum.reduceat(np.linalg.norm(grid - centres[ring], axis=1), starts) / arm
        rings = SkinnedMesh.of(centres, Rig(still, joints, means), parents)
        return cls(skinned, grid, parts, arm, rings, radius, ring)

    def chosen(self, parts: list[str]) -> BodyGrid:
        """Select parts, in this order."""
        ends = np.cumsum([0, *(self.parts[part].stop - self.parts[part].start for part in parts)])
        cells = self.cells(parts)
        skinned = self.skinned.part(np.concatenate([cells, cells + len(self.skinned.place) // 2]))
        return replace(
            self,
            skinned=skinned,
            rest=self.rest[cells],
            ring=self.ring[cells],
            parts=dict(zip(parts, map(slice, ends, ends[1:]), strict=True)),
        )

    def cells(self, parts: Iterable[str]) -> Int[np.ndarray, " P"]:
        """Return the indices of the points of parts."""
        return np.concatenate([np.r_[self.parts[part]] for part in parts] + [np.zeros(0, int)])

    def posed(
        self, rotation: Float[np.ndarray, "T J 3 3"], positions: Float[np.ndarray, "T J 3"]
    ) -> Float[np.ndarray, "6 T G"]:
        """Return the points, relative to the root joint and in arm lengths, and their unit normals."""
        both = self.skinned.posed_frames_at(rotation, positions - positions[:, :1]) / self.arm
        points, normals = np.split(np.moveaxis(both, 2, 0).astype(np.float32, order="C"), 2, axis=2)
        normals = normals - points
        normals /= np.maximum(np.sqrt(np.square(normals).sum(axis=0)), 1e-12)
        return np.concatenate([points, normals])

    def spheres(
        self, rotation: Float[np.ndarray, "T J 3 3"], positions: Float[np.ndarray, "T J 3"]
    ) -> Float[np.ndarray, "T R 3"]:
        """Return the centres of the rings, relative to the root joint and in arm lengths."""
        return self.rings.posed_frames_at(rotation, positions - positions[:, :1]) / self.arm


def part_of_joint(name: str) -> str:
    """Return the part of the body that a joint of the shipped body moves; "" for feet."""
    if name in ("Neck", "Neck1", "Head"):
        return "Head"
    if name in ("LThumb", "RThumb"):
        return {"L": "Left", "R": "Right"}[name[0]] + "Hand"
    side = next((side for side in SIDES if name.startswith(side)), "")
    own = name.removeprefix(side)
    if own.startswith(("Hand", "FingerBase")):
        return f"{side}Hand"
    if side and own in ("Foot", "ToeBase"):
        return ""
    return f"{side}{own}" if own in ROWS and side else "Trunk"


def _line(part: str, place: dict[str, np.ndarray], surface: Float[np.ndarray, "N 3"]) -> Line | None:
    side = next((side for side in SIDES if part.startswith(side)), "")
    own = part.removeprefix(side)
    following = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}
    if own == "Trunk":  # hips and shoulders, because rigs have the joint of the hips anywhere in the pelvis
        start, end = (np.mean([place[f"{s}{joint}"] for s in SIDES], axis=0) for joint in ("UpLeg", "Arm"))
    elif own == "Head":
        start = np.median(surface, axis=0)
        start[1] = place["Head" if "Head" in place else "Neck"][1]
        end = start + [0, HEAD_TOP * (np.median(surface[:, 1]) - start[1]), 0]
    elif own == "Hand":
        start = place[part]
        end = start + [FINGERTIPS * float(np.percentile(surface[:, 0] - start[0], 98 if side == "Left" else 2)), 0, 0]
    elif part in place and side + following[own] in place:
        start, end = place[part], place[side + following[own]]
    else:
        return None
    return (start, end) if np.linalg.norm(end - start) > 1e-6 else None


def _rings(
    part: str, line: Line, surface: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, "N J"], most: int
) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, "P 3"], Float[np.ndarray, "P J"]]:
    """Return the points of a part, their unit normals and weights, from samples of its surface in a T-pose.

    A point is found by its direction from the line: its distance is that of the samples in about this direction.
    """
    from scipy import sparse
    from scipy.spatial import KDTree

    count, rows = ROWS[part.removeprefix("Left").removeprefix("Right")]
    start, along = line[0], line[1] - line[0]
    length, axis = float(np.linalg.norm(along)), along / np.linalg.norm(along)
    front = np.array([0.0, 0.0, 1.0]) if abs(axis[1]) > abs(axis[0]) else np.array([0.0, 1.0, 0.0])
    front = unit_vectors(front - (front @ axis) * axis)
    across = np.cross(axis, front)
    share = np.clip((surface - start) @ axis / length, 0, 1)
    offset = surface - start - share[:, None] * along
    distance = np.linalg.norm(offset, axis=1)
    stretch = length / float(np.median(distance))  # so that steps along the line and around it count alike
    tree = KDTree(np.column_stack([share * stretch, offset / np.maximum(distance, 1e-12)[:, None]]))
    at, up = np.repeat(np.array(rows, float), count, axis=0).T
    up, angle = np.radians(up), np.tile(np.arange(count) * (2 * np.pi / count), len(rows))
    level = np.cos(angle)[:, None] * front + np.sin(angle)[:, None] * across
    direction = np.cos(up)[:, None] * level + np.sin(up)[:, None] * axis
    apart, nearest = tree.query(np.column_stack([at * stretch, direction]), min(most, len(surface)))
    near = np.exp((np.square(apart[:, :1]) - np.square(apart)) / (2 * WIDTH**2))
    near /= near.sum(axis=1, keepdims=True)
    first = np.arange(0, near.size + 1, near.shape[1])
    mean = sparse.csr_array((near.ravel(), nearest.ravel(), first), shape=(len(near), len(surface)))
    grid = start + at[:, None] * along + (mean @ distance)[:, None] * direction
    return grid, _normals(grid.reshape(len(rows), count, 3), direction), mean @ weights


def _normals(grid: Float[np.ndarray, "R C 3"], outward: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
    """Compute the unit normals of rings; where they are folded, the direction away from the line."""
    around = np.roll(grid, -1, axis=1) - np.roll(grid, 1, axis=1)
    normals = unit_vectors(np.cross(around, np.gradient(grid, axis=0)).reshape(-1, 3))
    cosine = (normals * outward).sum(axis=1, keepdims=True)
    normals = normals * np.sign(cosine)
    return unit_vectors(np.where(np.abs(cosine) > 0.3, normals, outward))
