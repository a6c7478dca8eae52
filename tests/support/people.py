"""Meshes of people with few faces, for tests of whole pipelines: the shipped body after decimation."""

from __future__ import annotations

from functools import cache

import numpy as np

from mimesh.bodies import load_body
from mimesh.bodies.sampling import JOINT_LIMITS, TABLE_6, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.mesh import Clip, Mesh


@cache
def decimation(faces_left: int) -> tuple[np.ndarray, np.ndarray]:
    """Decimate the body: indices of the vertices that remain, and faces over them.

    Decimated points are replaced by the nearest vertices of the body, so that the result can be skinned.
    """
    import fast_simplification
    from scipy.spatial import cKDTree

    body = load_body()
    points, faces = fast_simplification.simplify(
        body.vertices.astype(np.float32), body.faces.astype(np.int32), target_count=faces_left
    )
    remaining, index = np.unique(cKDTree(body.vertices).query(points)[1], return_inverse=True)
    faces = index[faces.astype(int)]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return remaining, faces[proper]


def person(shape: int = 0, pose: int | None = None, faces: int = 1000, wide: bool = False) -> Mesh:
    """Make person `shape` in pose `pose` of Table 6 (`wide`: of the joint limits); at rest without a pose."""
    body = load_body()
    remaining, triangles = decimation(faces)
    rotvec = np.zeros((len(body.parents), 3))
    if pose is not None:
        rotvec = sample_pose(body, 7, pose, JOINT_LIMITS if wide else TABLE_6)
    vertices = body.posed(sample_shape(body, 7, shape), rotvec_to_rotmat(rotvec))
    return Mesh(vertices[remaining], triangles, name=f"person{shape}")


def walk(shape: int = 1, frames: int = 4, faces: int = 1000) -> Clip:
    """Make a clip of a person who swings one leg, turns by 8 degrees and moves forward by 0.2 m per frame."""
    body = load_body()
    remaining, triangles = decimation(faces)
    vertices = []
    for t in range(frames):
        rotvec = np.zeros((len(body.parents), 3))
        rotvec[body.joint("Hips"), 1] = np.radians(8 * t)
        rotvec[body.joint("LeftUpLeg"), 0] = np.radians(-20 * t)
        root = np.array([0, 0, 0.2 * t])
        vertices.append(body.posed(sample_shape(body, 7, shape), rotvec_to_rotmat(rotvec), root)[remaining])
    return Clip(Mesh(vertices[0], triangles, name="walk"), np.stack(vertices), fps=10.0)
