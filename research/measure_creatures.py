"""Measure which creatures of a pool move each other, and whether each gets its own clips back from a renamed copy.

    python research/measure_creatures.py POOL [-o benchmarks/creatures.json] [--files FOLDER]

All ordered pairs of rigs of the class `other` are matched: how sure the match is; below `SURE` a pair is refused. Then
the clips of each creature are given to it from a copy whose joints have no names and another order; the error is the
largest distance of a vertex from where its own clip takes it, in percent of the diagonal of the bounding box.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from mimesh.bodies.character_pool import PoolCharacter, read_pool
from mimesh.bodies.rig_matching import Creature, match_rigs
from mimesh.core.animated_rig import AnimatedRig, RigAnimation
from mimesh.core.mesh import Mesh
from mimesh.core.options import Hints
from mimesh.core.rig import Rig
from mimesh.evaluate.run import provenance
from mimesh.io import load_clip, load_mesh
from mimesh.io.atomic import whole_file
from mimesh.io.gltf.skinned import write_gltf_skinned
from mimesh.pipeline import animate
from mimesh.pipeline.node_route import SURE

FRAMES = 60
"""Most frames of a clip that are written."""


def main() -> None:
    """Print and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("--split", default="train")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/creatures.json"))
    parser.add_argument("--files", type=Path, help="also keep the creatures as .glb files here")
    args = parser.parse_args()
    creatures = read_pool(args.pool, args.split, body="other").characters
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.files or Path(temporary)
        folder.mkdir(exist_ok=True)
        own = {creature.meta.file: own_error(creature, folder) for creature in creatures if creature.clips}
    sure = {identity.meta.file: confidences(identity, creatures) for identity in creatures}
    pairs = [value for row in sure.values() for value in row if value is not None]
    print(f"{sum(value >= SURE for value in pairs)} of {len(pairs)} pairs are matched")
    print(f"own clips from a renamed copy: largest error {max(own.values()):.1g} % of the size")
    report = {"provenance": provenance({"split": args.split, "sure": SURE}), "confidence": sure, "own_clips": own}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report) + "\n")


def confidences(identity: PoolCharacter, creatures: tuple[PoolCharacter, ...]) -> list[float | None]:
    """Match a creature with each of them: how sure the match is, from 0 to 1; None for itself."""
    mine = Creature(identity.rig)
    return [
        None if other is identity else round(match_rigs(mine, Creature(other.rig)).confidence, 3) for other in creatures
    ]


def own_error(creature: PoolCharacter, folder: Path) -> float:
    """Give a creature its own clips from a copy without names; return the largest error in percent of its size."""
    name = creature.meta.file
    order = np.random.default_rng(0).permutation(len(creature.rig.parents))
    mine = write_creature(creature, folder / f"{name}.glb", np.arange(len(order)), str)
    copy = write_creature(creature, folder / f"{name}-renamed.glb", order, lambda joint: "bone")
    worst = 0.0
    for clip in creature.clips:
        truth = load_clip(mine, animation=clip).vertices
        moved = animate(load_mesh(mine), load_clip(copy, animation=clip), hints=Hints(body="other")).clip.vertices
        worst = max(worst, float(np.linalg.norm(moved - truth, axis=-1).max()))
    return 100 * worst / float(np.linalg.norm(np.ptp(creature.rig.mesh.vertices, axis=0)))


def write_creature(creature: PoolCharacter, path: Path, order: np.ndarray, spell) -> Path:
    """Write a creature with its clips as .glb, all joints below one that moves nothing.

    Args:
        order: of the joints, as far as parents come first.
        spell: changes the names of the joints.
    """
    rig = creature.rig
    sorted_order: list[int] = []
    while len(sorted_order) < len(order):
        known = {-1, *sorted_order}
        sorted_order += [int(j) for j in order if j not in known and rig.parents[j] in known]
    place = {joint: k + 1 for k, joint in enumerate(sorted_order)} | {-1: 0}
    parents = (-1, *(place[rig.parents[j]] for j in sorted_order))
    names = ("Armature", *(spell(rig.joint_names[j]) for j in sorted_order))
    weights = rig.joint_weights()[:, sorted_order]
    weights = np.pad(weights / weights.sum(axis=1, keepdims=True), ((0, 0), (1, 0)))
    rest = np.concatenate([np.eye(4)[None], rig.T_world_joint[sorted_order]])
    animations = []
    for clip, data in creature.clips.items():
        moved = creature.transforms_of_frames(clip, np.arange(min(len(data), FRAMES)))[:, sorted_order]
        moved = np.concatenate([np.tile(np.eye(4), (len(moved), 1, 1, 1)), moved], axis=1)
        world = moved @ rest
        skeleton = AnimatedRig(
            Mesh(rig.mesh.vertices, rig.mesh.faces, name=path.stem),
            names,
            parents,
            Rig(rest[:, :3, :3], rest[:, :3, 3], weights),
            world[..., :3, :3],
            world[:, 0, :3, 3],
            {},
            world[..., :3, 3],
        )
        animations.append(RigAnimation(clip, skeleton, 30.0))
    write_gltf_skinned(animations, path)
    return path


if __name__ == "__main__":
    main()
