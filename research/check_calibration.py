"""Check the axes of limbs by which characters are measured: python research/check_calibration.py POOL

Prints, for each pack of the splits train and val of a pool, the median and the 90th percentile of the angles of
`calibration_report` over its characters, and how far two shapes of the shipped body in one pose differ: the resolution
of `limb_deg`. The figures of docs/conventions.md, section "Characters of other makers", are from here. Takes 15 s.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.character_limbs import SIDES, Limb, find_limbs, name_limb_joints
from mimesh.bodies.character_pool import PoolCharacter, read_pool
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.mesh import Mesh
from mimesh.evaluate.limb_metrics import UP, LimbedCharacter, angle_deg, limb_metrics

SPLITS = ("train", "val")
"""The split test is not looked at."""
PAIRS = 20
"""Number of pairs of two shapes in one pose."""
SHAPE_SEED, POSE_SEED = 3, 5
"""Seeds of these shapes and poses."""


def main() -> None:
    """Print the angles of each pack, those of all, and the resolution."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path, help="folder of the pool of characters")
    args = parser.parse_args()
    packs: dict[str, list[dict[str, list[float]]]] = {}
    for split in SPLITS:
        for character in read_pool(args.pool, split).characters:
            packs.setdefault(character.meta.pack, []).append(angles_of(character))
    for pack, angles in packs.items():
        print_angles(f"{pack}, {len(angles)} characters", angles)
    every = [angles for pack in packs.values() for angles in pack]
    print_angles(f"all, {len(every)} characters", every)
    print_angles(f"two shapes of the shipped body in one pose, {PAIRS} pairs", resolution())


def angles_of(character: PoolCharacter) -> dict[str, list[float]]:
    """Measure the axes of a character at rest, in degrees; left and right limbs stand under one name."""
    return merge_sides(calibration_report(character.rig, character.limbs))


def calibration_report(character: SkinnedCharacter, limbs: dict[str, Limb]) -> dict[str, float]:
    """Report how plausible the axes of limbs at rest are, all in degrees; limbs that cannot be measured are left out.

    Keys: `joint <limb>` is the angle between the surface axis and the line of joints; `mirror <limb>` the angle between
    the left axis and the mirrored right one (`LeftArm` without its side); `down <leg>` and `up <Trunk, Head>` the angle
    to the vertical; `below <arm>` the angle below the horizontal (0 in a T-pose, about 45 in an A-pose, 90 hanging
    down); `front <arm>` that to the front of the frontal plane. A maker's T- or A-pose must show in the last rows.
    """
    measured = LimbedCharacter(character, limbs).cuts
    axes = {name: sections.axis for name, sections in measured.items()}
    report = {
        f"joint {name}": float(angle_deg(axis, limbs[name].end - limbs[name].start)) for name, axis in axes.items()
    }
    for name, axis in axes.items():
        right = axes.get(name.replace("Left", "Right"))
        if name.startswith("Left") and right is not None:
            report[f"mirror {name.removeprefix('Left')}"] = float(angle_deg(axis, right * [-1, 1, 1]))
        if name.endswith("Leg"):
            report[f"down {name}"] = float(angle_deg(axis, -UP))
        elif name.endswith("Arm"):
            report[f"below {name}"], report[f"front {name}"] = np.degrees(np.arcsin([-axis[1], axis[2]])).tolist()
        else:
            report[f"up {name}"] = float(angle_deg(axis, UP))
    return report


def resolution() -> list[dict[str, list[float]]]:
    """Compute `limb_deg` and its limbs for pairs of random shapes of the shipped body in one random pose."""
    body, pairs = load_body(), []
    for i in range(PAIRS):
        identity, driving = (shaped_body(body, 2 * i + k) for k in range(2))
        rotmat = rotvec_to_rotmat(sample_pose(body, POSE_SEED, i, JOINT_LIMITS))
        result, driving_vertices = (figure.character.posed(rotmat) for figure in (identity, driving))
        metrics = limb_metrics(identity, driving, result, driving_vertices)
        pairs.append(merge_sides({n: v for n, v in metrics.items() if n.startswith("limb_deg") and v is not None}))
    return pairs


def shaped_body(body: RiggedBody, i: int) -> LimbedCharacter:
    """Make a character of the shipped body with the random shape `i`, and find its limbs."""
    vertices, joints = body.shaped(sample_shape(body, SHAPE_SEED, i))
    frames = np.tile(np.eye(4), (len(joints), 1, 1))
    frames[:, :3, 3] = joints
    joint_of = np.broadcast_to(np.arange(len(joints)), body.weights.shape)
    points = np.broadcast_to(vertices[:, None], (*body.weights.shape, 3))
    rig = SkinnedCharacter(
        Mesh(vertices, body.faces), body.joint_names, body.parents, frames, joint_of, body.weights, points
    )
    return LimbedCharacter(rig, find_limbs(rig, name_limb_joints(rig, body.name), body.name))


def merge_sides(figures: dict[str, float]) -> dict[str, list[float]]:
    """Group figures by name, without the sides of limbs."""
    merged: dict[str, list[float]] = {}
    for name, value in figures.items():
        for side in SIDES:
            name = name.replace(side, "")
        merged.setdefault(name, []).append(value)
    return merged


def print_angles(title: str, characters: list[dict[str, list[float]]]) -> None:
    """Print median and 90th percentile of each angle over characters or pairs, both sides together."""
    print(title)
    for name in dict.fromkeys(name for angles in characters for name in angles):
        values = [value for angles in characters for value in angles.get(name, [])]
        median, high = np.percentile(values, [50, 90]).round(1) + 0.0  # no minus zero
        print(f"  {name:20} median {median:6.1f}  90 % {high:6.1f}  ({len(values)} values)")


if __name__ == "__main__":
    main()
