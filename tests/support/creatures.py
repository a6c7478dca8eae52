"""Rigged creatures of boxes: birds, snakes, spiders, given as tables of joints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.animated_rig import AnimatedRig, RigAnimation
from mimesh.core.mesh import Mesh
from mimesh.core.rig import Rig, homogeneous
from mimesh.core.skinning import place_joints
from mimesh.io.gltf.skinned import write_gltf_skinned

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
QUARTERS = np.concatenate([SIDES[:, [0, 1, 2]], SIDES[:, [0, 2, 3]]])
Table = dict[str, tuple[str, tuple[float, float, float], tuple[float, float, float]]]
"""Joint -> its parent ("" for none), its place, and where its bone ends (its own place: it moves nothing)."""


def pairs(table: Table) -> Table:
    """Add the right joint of each left one."""
    right = {}
    for name, (parent, place, end) in table.items():
        if name.endswith(".L"):
            x = np.array([-1.0, 1.0, 1.0])
            above = parent[:-2] + ".R" if parent.endswith(".L") else parent
            right[name[:-2] + ".R"] = (above, tuple(x * place), tuple(x * end))
    return table | right


BIRD: Table = pairs(
    {
        "Body": ("", (0, 0, 0), (0, 0, 0.4)),
        "Head": ("Body", (0, 0.1, 0.4), (0, 0.2, 0.7)),
        "Wing1.L": ("Body", (0.15, 0.1, 0.1), (0.6, 0.1, 0.1)),
        "Wing2.L": ("Wing1.L", (0.6, 0.1, 0.1), (1.2, 0.1, 0.0)),
        "Tail1": ("Body", (0, 0, -0.1), (0, 0, -0.4)),
        "Tail2": ("Tail1", (0, 0, -0.4), (0, 0, -0.8)),
    }
)
SPIDER: Table = pairs(
    {
        "Root": ("", (0, 0, 0), (0, 0, 0)),
        "Body": ("Root", (0, 0.5, 0), (0, 0.5, 0.4)),
        **{
            name: joint
            for k, z in enumerate((0.3, 0.1, -0.1, -0.3))
            for name, joint in {
                f"Leg{k}Upper.L": ("Body", (0.2, 0.5, z), (0.6, 0.8, 2 * z)),
                f"Leg{k}Lower.L": (f"Leg{k}Upper.L", (0.6, 0.8, 2 * z), (1.0, 0.05, 3 * z)),
                f"Leg{k}Foot.L": ("Root", (1.0, 0.05, 3 * z), (1.05, 0.0, 3.1 * z)),
            }.items()
        },
    }
)


def snake(joints: int, name: str = "Tail") -> Table:
    """Make a snake along z whose tail has some joints called by a name, with the head in front."""
    table: Table = {"Body": ("", (0, 0, 0.1), (0, 0, 0.5)), "Head": ("Body", (0, 0, 0.5), (0, 0.1, 0.9))}
    ends = np.linspace(0, -3, joints + 1)
    for k in range(joints):
        above = f"{name}{k - 1}" if k else "Body"
        table[f"{name}{k}"] = (above, (0, 0, float(ends[k])), (0, 0, float(ends[k + 1])))
    return table


@dataclass(frozen=True, eq=False)
class Boxes:
    """A creature of one box a bone."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    mesh: Mesh
    rig: Rig

    @classmethod
    def of(cls, table: Table, size: float = 1.0, thick: float = 0.05, turn: np.ndarray | None = None) -> Boxes:
        """Make a creature of a table of joints.

        Args:
            turn: rotation of the whole creature.
        """
        turn, names = np.eye(3) if turn is None else turn, tuple(table)
        vertices, faces, owners = [], [], []
        for j, (_, place, end) in enumerate(table.values()):
            start, step = np.array(place, float), np.subtract(end, place)
            length = np.linalg.norm(step)
            if length == 0:
                continue
            axes = Rotation.align_vectors(step[None] / length, [[0, 0, 1]])[0].as_matrix()
            faces.append(QUARTERS + sum(map(len, vertices)))
            vertices.append(start + step / 2 + (CUBE * [thick, thick, length / 2]) @ axes.T)
            owners += [j] * len(CUBE)
        weights = np.eye(len(names))[owners]
        joints = np.array([place for _, place, _ in table.values()], float)
        mesh = Mesh(size * np.concatenate(vertices) @ turn.T, np.concatenate(faces), name="boxes")
        rotations = np.tile(np.eye(3), (len(names), 1, 1))
        above = tuple(names.index(parent) if parent else -1 for parent, _, _ in table.values())
        return cls(names, above, mesh, Rig(rotations, size * joints @ turn.T, weights))

    @property
    def character(self) -> SkinnedCharacter:
        """The creature as it is read from a file."""
        frames = homogeneous(self.rig.rotation, self.rig.joints)
        owners = self.rig.weights.argmax(axis=1)[:, None]
        points = self.mesh.vertices[:, None]
        return SkinnedCharacter(self.mesh, self.names, self.parents, frames, owners, np.ones((len(owners), 1)), points)

    def renamed(self, seed: int) -> Boxes:
        """Shuffle the joints, parents first, and give all of them names that say nothing."""
        order: list[int] = []
        mixed = np.random.default_rng(seed).permutation(len(self.names))
        while len(order) < len(mixed):
            order += [int(j) for j in mixed if j not in order and self.parents[j] in (-1, *order)]
        parents = tuple(-1 if self.parents[j] < 0 else order.index(self.parents[j]) for j in order)
        rig = Rig(self.rig.rotation[order], self.rig.joints[order], self.rig.weights[:, order])
        names = tuple(f"Bone.{k:03d}" for k in range(len(order)))
        return replace(self, names=names, parents=parents, rig=rig)

    def world(self, turns: dict[str, np.ndarray]) -> np.ndarray:
        """Compute the world rotations of the joints from rotation vectors relative to the parents."""
        world = np.tile(np.eye(3), (len(self.names), 1, 1))
        for j, name in enumerate(self.names):
            above = world[self.parents[j]] if self.parents[j] >= 0 else np.eye(3)
            world[j] = above @ Rotation.from_rotvec(turns.get(name, np.zeros(3))).as_matrix()
        return world

    def skeleton(self, world: np.ndarray, path: np.ndarray) -> AnimatedRig:
        """Make the motion of world rotations, with a displacement of the root in each frame."""
        return AnimatedRig(self.mesh, self.names, self.parents, self.rig, world, self.rig.joints[0] + path, {})

    def posed(self, world: np.ndarray, path: np.ndarray) -> np.ndarray:
        """Compute the vertices under world rotations of the joints (J, 3, 3)."""
        places = place_joints(self.rig.joints[0] + path, self.rig.bones(self.parents), world, self.parents)
        owner = self.rig.weights.argmax(axis=1)
        step = self.mesh.vertices - self.rig.joints[owner]
        return places[owner] + (world[owner] @ step[..., None])[..., 0]

    def write(
        self, path: Path, frames: list[dict[str, np.ndarray]] | None = None, way: np.ndarray | None = None
    ) -> Path:
        """Write the creature with an animation "move"; `way` (T, 3) is the displacement of the root."""
        frames = [{}] if frames is None else frames
        world = np.stack([self.world(turns) for turns in frames])
        way = np.zeros((len(frames), 3)) if way is None else way
        write_gltf_skinned([RigAnimation("move", self.skeleton(world, way), 30.0)], path)
        return path


def flapping(names: tuple[str, ...], frames: int = 4, seed: int = 0) -> list[dict[str, np.ndarray]]:
    """Make random turns of joints by up to half a radian about each axis."""
    rng = np.random.default_rng(seed)
    return [{name: rng.uniform(-0.5, 0.5, 3) * (t > 0) for name in names} for t in range(frames)]
