"""Meshes of people with few faces, for tests of whole pipelines: the shipped body after decimation."""

from __future__ import annotations

from functools import cache

import numpy as np

from mimesh.bodies import load_body
from mimesh.bodies.sampling import JOINT_LIMITS, TABLE_6, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import homogeneous


@cache
def decimation(faces_left: int, name: str = "human") -> tuple[np.ndarray, np.ndarray]:
    """Decimate a shipped body: indices of the vertices that remain, and faces over them.

    Decimated points are replaced by the nearest vertices of the body, so that the result can be skinned.
    """
    import fast_simplification
    from scipy.spatial import cKDTree

    body = load_body(name)
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


def rigged(
    mesh: Mesh, names: tuple[str, ...], parents: tuple[int, ...], joints: np.ndarray, weights: np.ndarray
) -> SkinnedCharacter:
    """Make the rig that a file has, of joints with the axes of the world and weights of all of them (V, J)."""
    count = len(names)
    columns = np.tile(np.arange(count), (len(weights), 1))
    points = np.repeat(mesh.vertices[:, None], count, axis=1)
    frames = homogeneous(np.tile(np.eye(3), (count, 1, 1)), joints)
    return SkinnedCharacter(mesh, names, parents, frames, columns, weights, points)


def split_everywhere(mesh: Mesh) -> Mesh:
    """Give every face its own vertices, as in flat-shaded GLB files."""
    return Mesh(mesh.vertices[mesh.faces.ravel()], np.arange(mesh.faces.size).reshape(-1, 3))


def boxes_person(head: float) -> Mesh:
    """Make a person of boxes who stands y up and faces +z, with a cube of half size `head` for a head.

    The detector used to stand figures with heads of 0.5 and more, the size of the body below, on their heads.
    """
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([[a, *pair] for a, b, c, d in sides for pair in ((b, c), (c, d))])
    parts = [((0, 1 + head, 0), (head, head, head)), ((0, 0.75, 0), (0.15, 0.25, 0.1))]
    for x in (-1, 1):
        parts += [((0.1 * x, 0.25, 0.02), (0.06, 0.25, 0.07)), ((0.3 * x, 0.9, 0), (0.2, 0.05, 0.05))]
    vertices = [np.array(centre) + corners * half for centre, half in parts]
    faces = [triangles + 8 * k for k in range(len(parts))]
    return Mesh(np.concatenate(vertices), np.concatenate(faces), name="boxes")


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
