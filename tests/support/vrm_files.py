"""VRM characters and VRM animations: a generated rig with VRM's extensions, and .vrma files built byte by byte."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from engine_rigs import expected_parents, moving_rig
from gltf_samples import Sample
from scipy.spatial.transform import Rotation

from mimesh.bodies.engine_names import SCHEMES
from mimesh.bodies.engine_rig import engine_rig
from mimesh.core.animated_rig import AnimatedRig, RigAnimation
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import Draft
from mimesh.io.gltf.skinned import write_gltf_skinned

OLD_NAMES = {
    f"{side}Thumb{new}": f"{side}Thumb{old}"
    for side in ("left", "right")
    for new, old in (("Metacarpal", "Proximal"), ("Proximal", "Intermediate"))
}
"""Bones that VRM 0.x calls otherwise than VRM 1.0."""
PARENTS = expected_parents("vrm", fingers=True)
BONES = tuple(SCHEMES["vrm"].bones.values())


def vrm(
    path: Path,
    version: int = 1,
    targets: tuple[str, ...] = (),
    expressions: dict[str, dict] | None = None,
    named: bool = False,
    weights: np.ndarray | None = None,
    still: bool = True,
) -> tuple[Path, AnimatedRig, dict[str, int]]:
    """Write a VRM without animations; returns its path, its rig and the node of each bone by its name in VRM 1.0.

    Args:
        version: 0 (facing -z) or 1 (facing +z).
        targets: names of morph targets, each of which moves random vertices of the head.
        expressions: those of VRMC_vrm by name; with version 0 rows of blendShapeGroups.
        named: leave the bones their names; else these say nothing.
        weights: of the targets in every frame, 30 a second: an animation.
        still: leave the bones out of the animation; else the left upper arm turns in it.
    """
    rig, content = plain_vrm("+z" if version else "-z")
    path.with_suffix(".glb").write_bytes(content)
    document = open_document(path.with_suffix(".glb"))
    gltf = {key: value for key, value in document.gltf.items() if key != "animations"}
    nodes = {node["name"]: number for number, node in enumerate(gltf["nodes"]) if node["name"] in BONES}
    for number, node in enumerate([] if named else gltf["nodes"]):
        node["name"] = f"node{number}"
    draft = Draft(gltf)
    draft.gltf |= {key: gltf[key] for key in ("accessors", "bufferViews")}
    draft.chunks, draft.size = [memoryview(document.binary)], len(document.binary)
    for mesh in gltf["meshes"] if targets else []:
        add_targets(draft, mesh, targets)
    if weights is not None:
        meshes = [number for number, node in enumerate(gltf["nodes"]) if "mesh" in node]
        draft.gltf["animations"] = [animation(draft, meshes, weights, None if still else nodes["leftUpperArm"])]
    draft.gltf |= extensions(version, nodes, expressions or {})
    draft.gltf["materials"] = [{"extensions": {"VRMC_materials_mtoon": {"specVersion": "1.0"}}}]
    draft.save(path)
    return path, rig, nodes


@cache
def plain_vrm(front: str) -> tuple[AnimatedRig, bytes]:
    """Make a rig with the bones of VRM, and the .glb of it."""
    rig = engine_rig(moving_rig(7, fingers=True, front=front, arms=10.0), "vrm", rest="T", front=front)
    with TemporaryDirectory() as folder:
        write_gltf_skinned([RigAnimation("a", rig, 30.0)], Path(folder) / "a.glb")
        return rig, (Path(folder) / "a.glb").read_bytes()


def add_targets(draft: Draft, mesh: dict, targets: tuple[str, ...]) -> None:
    """Give a mesh morph targets that move a part of its vertices by centimetres."""
    rng = np.random.default_rng(len(targets))
    for primitive in mesh["primitives"]:
        count = draft.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
        moves = [rng.normal(scale=0.01, size=(count, 3)) * (rng.random((count, 1)) < 0.2) for _ in targets]
        primitive["targets"] = [{"POSITION": draft.add_floats(move, bounds=True)} for move in moves]
    mesh["extras"] = {"targetNames": list(targets)}
    mesh["weights"] = [0.0] * len(targets)


def animation(draft: Draft, meshes: list[int], weights: np.ndarray, turning: int | None) -> dict:
    """An animation of morph weights, and of one node by up to a quarter turn about z."""
    times = draft.add_floats(np.arange(len(weights))[:, None] / 30.0, bounds=True)
    samplers = [{"input": times, "output": draft.add_floats(weights.reshape(-1, 1))}]
    channels = [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in meshes]
    if turning is not None:
        turns = Rotation.from_rotvec(np.linspace([0, 0, 0], [0, 0, np.pi / 2], len(weights)))
        samplers.append({"input": times, "output": draft.add_floats(turns.as_quat())})
        channels.append({"sampler": 1, "target": {"node": turning, "path": "rotation"}})
    return {"name": "face", "samplers": samplers, "channels": channels}


def extensions(version: int, nodes: dict[str, int], expressions: dict[str, dict]) -> dict:
    """The JSON of VRM's extensions, with some that nothing here reads."""
    if version:
        bones = {bone: {"node": node} for bone, node in nodes.items()}
        meta = {"name": "mover", "version": "1", "authors": ["nobody"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
        presets = {name: row for name, row in expressions.items() if not name.startswith("my")}
        custom = {name: row for name, row in expressions.items() if name.startswith("my")}
        humanoid = {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": bones}}
        found = {
            "VRMC_vrm": {**humanoid, "expressions": {"preset": presets, "custom": custom}},
            "VRMC_springBone": {"specVersion": "1.0", "springs": [{"name": "hair", "joints": []}]},
        }
    else:
        rows = [{"bone": OLD_NAMES.get(bone, bone), "node": node} for bone, node in nodes.items()]
        groups = [{"name": name, **row} for name, row in expressions.items()]
        found = {
            "VRM": {
                "specVersion": "0.0",
                "meta": {"title": "mover", "author": "nobody", "version": "1"},
                "humanoid": {"humanBones": rows},
                "blendShapeMaster": {"blendShapeGroups": groups},
                "secondaryAnimation": {"boneGroups": [], "colliderGroups": []},
                "materialProperties": [],
            }
        }
    return {"extensions": found, "extensionsUsed": [*found, "VRMC_materials_mtoon"]}


def bone_positions(rig: AnimatedRig, front: str = "+z") -> dict[str, np.ndarray]:
    """The joints of a VRM rig by bone, y up and facing +z."""
    turn = np.diag([-1.0, 1.0, -1.0]) if front == "-z" else np.eye(3)
    return {name: turn @ joint for name, joint in zip(rig.names, rig.rig.joints, strict=True) if name in BONES}


def vrma(
    path: Path,
    rest: dict[str, np.ndarray],
    seed: int = 0,
    frames: int = 6,
    fps: float = 30.0,
    expressions: dict[str, np.ndarray] | None = None,
    spread: float = 0.4,
) -> tuple[Path, dict[str, np.ndarray], np.ndarray]:
    """Write a VRM animation whose nodes have random axes and names that say nothing.

    Returns its path, the world rotation of each bone since the T-pose in every frame, and the path of the hips.
    """
    rng, sample = np.random.default_rng(seed), Sample()
    bones = [bone for bone in BONES if bone in rest]
    axes = {bone: Rotation.random(random_state=rng) for bone in bones}
    turns = {bone: Rotation.from_rotvec(rng.normal(scale=spread, size=(frames, 3))) for bone in bones}
    times = sample.accessor(np.arange(frames) / fps)
    nodes, channels, samplers, world = [], [], [], {}
    for number, bone in enumerate(bones):
        parent = nearest(bone, rest)
        above = axes[parent] if parent else Rotation.identity()
        world[bone] = (world[parent] * turns[bone]) if parent else turns[bone]
        step = rest[bone] - (rest[parent] if parent else 0)
        node = {"name": f"n{number}", "rotation": (above.inv() * axes[bone]).as_quat().tolist()}
        node["translation"] = above.inv().apply(step).tolist()
        node["children"] = [k for k, child in enumerate(bones) if nearest(child, rest) == bone]
        nodes.append({key: value for key, value in node.items() if value != []})
        moved_above = (world[parent] * above) if parent else Rotation.identity()
        local = moved_above.inv() * world[bone] * axes[bone]
        samplers.append({"input": times, "output": sample.accessor(local.as_quat())})
        channels.append({"sampler": number, "target": {"node": number, "path": "rotation"}})
    path_of_hips = rest["hips"] + np.cumsum(rng.normal(scale=0.02, size=(frames, 3)), axis=0)
    samplers.append({"input": times, "output": sample.accessor(path_of_hips)})
    channels.append({"sampler": len(samplers) - 1, "target": {"node": 0, "path": "translation"}})
    extension = {
        "specVersion": "1.0",
        "humanoid": {"humanBones": {bone: {"node": number} for number, bone in enumerate(bones)}},
        "expressions": {"preset": {}, "custom": {}},
    }
    for name, weights in (expressions or {}).items():
        extension["expressions"]["custom" if name.startswith("my") else "preset"][name] = {"node": len(nodes)}
        along = np.stack([weights, np.zeros(frames), np.zeros(frames)], axis=1)
        samplers.append({"input": times, "output": sample.accessor(along)})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": len(nodes), "path": "translation"}})
        nodes.append({"name": f"n{len(nodes)}"})
    sample.gltf |= {
        "scene": 0,
        "scenes": [{"nodes": [0, *range(len(bones), len(nodes))]}],
        "nodes": nodes,
        "animations": [{"samplers": samplers, "channels": channels}],
        "extensionsUsed": ["VRMC_vrm_animation"],
        "extensions": {"VRMC_vrm_animation": extension},
    }
    return sample.glb(path), {bone: turn.as_matrix() for bone, turn in world.items()}, path_of_hips


def nearest(bone: str, rest: dict[str, np.ndarray]) -> str | None:
    """The nearest bone above one among those of a pose."""
    parent = PARENTS.get(bone)
    while parent is not None and parent not in rest:
        parent = PARENTS.get(parent)
    return parent
