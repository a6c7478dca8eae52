"""glTF files of rigged characters: the shipped body after decimation, as various exporters would write it."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from engine_rigs import with_fingers
from people import decimation
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.io import load_mesh
from mimesh.io.gltf.document import open_document, read_accessor
from mimesh.io.gltf.draft import AccessorCopier, Draft
from mimesh.io.gltf.edit import GltfSource
from mimesh.io.gltf.read import rig_on_nodes, skin_joints
from mimesh.io.gltf.scene import read_inverse_bind_matrices

ARMATURE = np.array([[100.0, 0, 0, 0], [0, 0, 100.0, 0], [0, -100.0, 0, 0], [0, 0, 0, 1]])
"""T_world_armature of a z-up armature in hundredths of a unit."""
FPS = 20.0
LIMBS = ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")
MOVING = (
    *("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"),
    *(f"{side}{part}" for side in ("Left", "Right") for part in LIMBS),
)
"""Joints that rigs of all naming schemes have."""


def kept(faces: int = 300) -> np.ndarray:
    """List the vertices of the body that a character of so many faces has, in its order."""
    return decimation(faces)[0]


def read_skin(path: Path) -> SkinnedCharacter:
    """Read a character as its file has it, with the joints of all skins that its scene shows."""
    mesh = load_mesh(path)
    assert isinstance(mesh.source, GltfSource)
    document, rest = mesh.source.document, mesh.source.rest
    return rig_on_nodes(mesh, document, rest, skin_joints(document, rest))[0]


@dataclass(frozen=True, eq=False)
class Figure:
    """A person in the T-pose with any joints."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    joints: np.ndarray
    weights: np.ndarray
    """Of all vertices of the body."""
    vertices: np.ndarray

    def without(self, *names: str) -> Figure:
        """Remove joints; their weights and children go to their parents."""
        figure = self
        for name in names:
            j = figure.names.index(name)
            weights = figure.weights.copy()
            weights[:, figure.parents[j]] += weights[:, j]
            keep = [k for k in range(len(figure.names)) if k != j]
            above = [figure.parents[j] if figure.parents[k] == j else figure.parents[k] for k in keep]
            parents = tuple(parent - (parent > j) for parent in above)
            figure = Figure(
                tuple(figure.names[k] for k in keep), parents, figure.joints[keep], weights[:, keep], figure.vertices
            )
        return figure

    def with_twist(self, limb: str, tail: str, share: float = 0.5) -> Figure:
        """Add a joint in the middle of a limb that takes a share of its weights."""
        j = self.names.index(limb)
        middle = (self.joints[j] + self.joints[self.names.index(tail)]) / 2
        weights = np.concatenate([self.weights, share * self.weights[:, j : j + 1]], axis=1)
        weights[:, j] *= 1 - share
        joints = np.concatenate([self.joints, middle[None]])
        return dataclasses.replace(
            self, names=(*self.names, f"{limb}Twist"), parents=(*self.parents, j), joints=joints, weights=weights
        )

    def between(self, name: str, above: str, below: str) -> Figure:
        """Insert a joint without weights between a joint and its child."""
        child, j = self.names.index(below), self.names.index(above)
        middle = (self.joints[j] + self.joints[child]) / 2
        parents = tuple(p + (p >= child) for p in self.parents)
        parents = (*parents[:child], j, child, *parents[child + 1 :])
        return Figure(
            (*self.names[:child], name, *self.names[child:]),
            parents,
            np.insert(self.joints, child, middle, axis=0),
            np.insert(self.weights, child, 0.0, axis=1),
            self.vertices,
        )

    def pose(self, turns: Mapping[str, np.ndarray], root: np.ndarray | None = None) -> np.ndarray:
        """Compute the rigid transform of each joint from the T-pose, for rotations relative to the parents."""
        transforms = np.tile(np.eye(4), (len(self.names), 1, 1))
        for j, (name, parent) in enumerate(zip(self.names, self.parents, strict=True)):
            local, turn = np.eye(4), turns.get(name, np.eye(3))
            local[:3, :3], local[:3, 3] = turn, self.joints[j] - turn @ self.joints[j]
            if parent < 0 and root is not None:
                local[:3, 3] += root
            transforms[j] = transforms[parent] @ local if parent >= 0 else local
        return transforms


@cache
def figure(shape: int | None = 0, fingers: bool = False) -> Figure:
    """Make person `shape` (None: the mean, the only one with fingers)."""
    body = load_body()
    if fingers:
        names, parents, joints, weights = with_fingers()
        return Figure(names, parents, joints, weights, body.vertices)
    coefficients = np.zeros(1) if shape is None else sample_shape(body, 7, shape)
    vertices = body.posed(coefficients, np.tile(np.eye(3), (len(body.parents), 1, 1)))
    return Figure(body.joint_names, body.parents, body.shaped(coefficients)[1], body.weights, vertices)


def exercise(
    person: Figure, frames: int = 6, seed: int = 0, size: float = 0.3, joints: tuple[str, ...] = MOVING
) -> list[np.ndarray]:
    """Make a motion of all persons alike: transforms of all joints from the T-pose in each frame."""
    turns = {
        name: np.random.default_rng([seed, zlib.crc32(name.encode())]).normal(scale=size, size=3) for name in joints
    }
    return [
        person.pose(
            {name: Rotation.from_rotvec(t / frames * turn).as_matrix() for name, turn in turns.items()},
            np.array([0.02 * t, 0.01 * np.sin(t), 0.1 * t]),
        )
        for t in range(1, frames + 1)
    ]


def quantized(character: Path, path: Path, unit: float) -> Path:
    """Write the skinned mesh of a file in another unit, as optimizers do, with the skeleton named; returns `path`."""
    document = open_document(character)
    draft = AccessorCopier(document, whole=True).draft
    for mesh in draft.gltf["meshes"]:
        for primitive in mesh["primitives"]:
            points = read_accessor(document, primitive["attributes"]["POSITION"])
            primitive["attributes"]["POSITION"] = draft.add_floats(points / unit, 34962, bounds=True)
    for number, skin in enumerate(draft.gltf["skins"]):
        bound = read_inverse_bind_matrices(document, number) @ np.diag([unit, unit, unit, 1.0])
        skin |= {"inverseBindMatrices": draft.add_matrices(bound), "skeleton": min(skin["joints"])}
    draft.save(path)
    return path


def posed(person: Figure, frame: np.ndarray, rest: np.ndarray | None = None, faces: int = 300) -> np.ndarray:
    """Compute the vertices that a file of `character` has in a frame of a motion: its skin is bound in the rest pose.

    Args:
        rest: transforms of the joints from the T-pose to the rest pose.
    """
    at_rest = np.tile(np.eye(4), (len(person.names), 1, 1)) if rest is None else rest
    weights = _limited(person.weights[kept(faces)])
    vertices = _skinned(person.vertices[kept(faces)], person.weights[kept(faces)], at_rest)
    return _skinned(vertices, weights, frame @ np.linalg.inv(at_rest))


def _skinned(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    points = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    return np.einsum("vj,jkl,vl->vk", weights, transforms, points)[:, :3]


def _limited(weights: np.ndarray) -> np.ndarray:
    """Keep the eight largest weights of each vertex, which the files have."""
    smallest = np.sort(weights, axis=1)[:, -8:-7]
    weights = np.where(weights >= smallest, weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def arms_down(person: Figure | None = None) -> np.ndarray:
    """Rotations of a person's joints from the T-pose to arms that hang by 50 degrees, and spread legs."""
    names = (figure() if person is None else person).names
    rest = np.tile(np.eye(3), (len(names), 1, 1))
    for side, sign in (("Left", -1), ("Right", 1)):
        rest[names.index(f"{side}Arm")] = Rotation.from_euler("z", 50 * sign, degrees=True).as_matrix()
        rest[names.index(f"{side}UpLeg")] = Rotation.from_euler("z", -8 * sign, degrees=True).as_matrix()
    return rest


def changed(person: Figure, *changes: str) -> Figure:
    """Give a person other joints: "no toes", "no hands", "one joint a limb", "twists" or "spines"."""
    for change in changes:
        for side in ("Left", "Right"):
            hand = (f"{side}HandFinger1", f"{side}FingerBase", f"{side[0]}Thumb", f"{side}Hand")
            limbs = (*hand, f"{side}ForeArm", f"{side}ToeBase", f"{side}Foot", f"{side}Leg")
            if change == "twists":
                person = person.with_twist(f"{side}Arm", f"{side}ForeArm").with_twist(f"{side}UpLeg", f"{side}Leg")
            removed = {"no toes": (f"{side}ToeBase",), "no hands": hand, "one joint a limb": limbs}
            person = person.without(*removed.get(change, ()))
        if change == "spines":
            person = person.between("Spine0", "LowerBack", "Spine").between("SpineHalf", "Spine", "Spine1")
    return person


KINDS = {
    "no toes": dict(person=("no toes",)),
    "no hands": dict(person=("no toes", "no hands")),
    "twists": dict(person=("twists",)),
    "spines": dict(person=("spines",)),
    "feet on roots": dict(hold={"LeftFoot": "", "RightFoot": ""}),
    "three skins": dict(skins=3),
    "metres, y up": dict(armature=np.eye(4)),
    "A-pose": dict(rest="A"),
    "nodes in another pose": dict(moved="bent"),
}
"""Kinds of rigs, as options of `of_kind`."""


def of_kind(path: Path, kind: str, shape: int = 0, moving: bool = True, **options) -> tuple[Path, Figure, np.ndarray]:
    """Write a character of a kind; returns the path, its joints, and their transforms from the T-pose to rest."""
    chosen = dict(KINDS.get(kind, {}))
    person = changed(figure(shape), *chosen.pop("person", ()))
    turns = arms_down(person) if chosen.pop("rest", None) else None
    if chosen.pop("moved", None):
        options["moved"] = exercise(person, 1, seed=9)[0]
    if moving:
        options["clips"] = {"move": exercise(person)}
    character(path, person=person, rest=turns, **chosen, **options)
    return path, person, person.pose({} if turns is None else dict(zip(person.names, turns, strict=True)))


def character(
    path: Path,
    shape: int | None = 0,
    rest: np.ndarray | None = None,
    faces: int = 300,
    name: Callable[[str], str] = str,
    hold: dict[str, str] | None = None,
    frames: int | None = 0,
    moved: np.ndarray | None = None,
    turn: np.ndarray | None = None,
    person: Figure | None = None,
    clips: Mapping[str, list[np.ndarray]] | None = None,
    armature: np.ndarray = ARMATURE,
    skins: int = 1,
    order: np.ndarray | None = None,
    change: Callable[[Draft], None] | None = None,
) -> Path:
    """Write person `shape` (None: the mean) with a skin of two sets of influences, and return `path`.

    Args:
        rest: local joint rotations of the character's rest pose, in the order of its joints.
        name: maps our joint names to those of the file.
        hold: other parents of joints, by joint name ("": the armature).
        frames: seed of the random axes of the joints; None: parallel in the T-pose, turned with the joints.
        moved: world transforms of the joints' nodes after binding, relative to the rest pose.
        turn: rotation of the whole character.
        person: joints and vertices in place of those of `shape`.
        clips: motions by name, as `exercise` makes them; with them nodes have translation, rotation and scale.
        armature: transform of the node above all joints.
        skins: number of meshes, each with its triangles and a skin that lists the joints in another order.
        order: permutation of the vertices.
        change: changes the document before it is saved.
    """
    person, turn = figure(shape) if person is None else person, np.eye(3) if turn is None else turn
    count, (remaining, triangles) = len(person.parents), decimation(faces)
    turns = {} if rest is None else dict(zip(person.names, rest, strict=True))
    turned = np.eye(4)
    turned[:3, :3] = turn
    at_rest = person.pose(turns)
    vertices = _skinned(person.vertices[remaining], person.weights[remaining], at_rest) @ turn.T
    T_world_joint = np.tile(np.eye(4), (count, 1, 1))
    size = np.cbrt(abs(np.linalg.det(armature[:3, :3])))
    random = np.linalg.qr(np.random.default_rng(frames).normal(size=(count, 3, 3)))[0]
    T_world_joint[:, :3, :3] = size * (turn @ at_rest[:, :3, :3] if frames is None else random)
    joints = (at_rest[:, :3, :3] @ person.joints[..., None])[..., 0] + at_rest[:, :3, 3]
    T_world_joint[:, :3, 3] = joints @ turn.T
    bind = np.linalg.inv(T_world_joint) @ armature
    parents = [-1 if (hold or {}).get(n) == "" else p for n, p in zip(person.names, person.parents, strict=True)]
    for joint, parent in (hold or {}).items():
        if parent:
            parents[person.names.index(joint)] = person.names.index(parent)

    def local(world: np.ndarray) -> np.ndarray:
        above = [armature if parent < 0 else world[parent] for parent in parents]
        return np.linalg.inv(above) @ world

    nodes = [{"name": "armature", "matrix": armature.T.ravel().tolist(), "children": [1]}]
    nodes += [{"name": "body", "mesh": 0, "skin": 0}]
    for j, matrix in enumerate(local(T_world_joint if moved is None else moved @ T_world_joint)):
        placed = {"matrix": matrix.T.ravel().tolist()} if clips is None else _properties(matrix)
        nodes.append({"name": name(person.names[j]), **placed})
    for j, parent in enumerate(parents):
        nodes[0 if parent < 0 else parent + 2].setdefault("children", []).append(j + 2)
    draft = Draft({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}]})
    draft.gltf |= {"nodes": nodes, "meshes": [], "skins": []}
    placed = np.concatenate([vertices, np.ones((len(remaining), 1))], axis=1) @ np.linalg.inv(armature).T
    order = np.arange(len(remaining)) if order is None else order
    placed, weights = placed[order, :3], _limited(person.weights[remaining])[order]
    triangles = np.argsort(order)[triangles]
    for part, chosen in enumerate(np.array_split(triangles, skins)):
        listed = np.random.default_rng(part).permutation(count) if part else np.arange(count)
        if part:
            nodes[0]["children"].append(len(nodes))
            nodes.append({"name": f"body{part}", "mesh": part, "skin": part})
        _add_skin(draft, placed, weights, chosen, listed, bind)
    for clip, motion in (clips or {}).items():
        world = [turned @ frame @ np.linalg.inv(at_rest) @ np.linalg.inv(turned) @ T_world_joint for frame in motion]
        _add_clip(draft, clip, np.stack([local(frame) for frame in world]))
    if change is not None:
        change(draft)
    draft.save(path)
    return path


def _add_skin(
    draft: Draft, points: np.ndarray, weights: np.ndarray, triangles: np.ndarray, order: np.ndarray, bind: np.ndarray
) -> None:
    """Add a mesh and a skin that lists the joints in an order."""
    attributes = {"POSITION": draft.add_floats(points, bounds=True)}
    place = np.argsort(order)
    strongest = np.argsort(-weights, axis=1)[:, :8]
    values = np.take_along_axis(weights, strongest, axis=1)
    for k in range(2):
        four = slice(4 * k, 4 * k + 4)
        view = draft.add_view(place[strongest[:, four]].astype("<u1"))
        kind = {"componentType": 5121, "count": len(points), "type": "VEC4"}
        attributes[f"JOINTS_{k}"] = draft.add_accessor({"bufferView": view, **kind})
        attributes[f"WEIGHTS_{k}"] = draft.add_floats(values[:, four])
    columns = draft.add_view(bind[order].transpose(0, 2, 1).astype("<f4"))
    inverse = draft.add_accessor({"bufferView": columns, "componentType": 5126, "count": len(order), "type": "MAT4"})
    primitive = {"attributes": attributes, "indices": draft.add_indices(triangles)}
    draft.gltf["meshes"].append({"primitives": [primitive]})
    draft.gltf["skins"].append({"joints": (order + 2).tolist(), "inverseBindMatrices": inverse})


def _add_clip(draft: Draft, name: str, local: np.ndarray) -> None:
    """Add an animation of the joints from their local transforms (T, J, 4, 4); what does not move has no channel."""
    times = draft.add_floats(np.arange(len(local))[:, None] / FPS, bounds=True)
    samplers, channels = [], []
    for j in range(local.shape[1]):
        properties = [_properties(matrix) for matrix in local[:, j]]
        for path in ("translation", "rotation"):
            values = np.array([entry[path] for entry in properties])
            if np.ptp(values, axis=0).max() > 1e-9:
                if path == "rotation":
                    values[1:] *= np.cumprod(np.sign((values[1:] * values[:-1]).sum(axis=1)))[:, None]
                channels.append({"sampler": len(samplers), "target": {"node": j + 2, "path": path}})
                samplers.append({"input": times, "output": draft.add_floats(values)})
    animation = {"name": name, "samplers": samplers, "channels": channels}
    draft.gltf.setdefault("animations", []).append(animation)


def _properties(matrix: np.ndarray) -> dict[str, list[float]]:
    """Decompose a transform with one scale, which may be a mirror image."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    rotation = Rotation.from_matrix(matrix[:3, :3] / scale).as_quat()
    return {"translation": matrix[:3, 3].tolist(), "rotation": rotation.tolist(), "scale": [scale] * 3}


def mirror(draft: Draft) -> None:
    """Put the scene below a node that mirrors it at x = 0."""
    draft.gltf["nodes"].append({"scale": [-1, 1, 1], "children": draft.gltf["scenes"][0]["nodes"]})
    draft.gltf["scenes"][0]["nodes"] = [len(draft.gltf["nodes"]) - 1]
