"""Write body models, recordings and registrations in the layouts of the field's body data, from numbers of our own."""

from __future__ import annotations

import contextlib
import pickle
import sys
import types
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse
from motion_files import OURS, PARENTS
from people import decimation

from mimesh.bodies import load_body


class Ch:
    """A stand-in for chumpy's variable, with the attributes that its pickles hold."""

    def __init__(self, x):
        self.x, self._dirty_vars, self._itr, self._status = x, {"x"}, None, "new"


class Select(Ch):
    """A stand-in for chumpy's selection of entries of another variable."""

    def __init__(self, a, idxs: np.ndarray, preferred_shape: tuple[int, ...]):
        self.a, self.idxs, self.preferred_shape = a, idxs, preferred_shape


@contextlib.contextmanager
def chumpy_modules() -> Iterator[None]:
    """Let pickle find the stand-ins as chumpy's classes, so that it writes their names."""
    places = {Ch: "chumpy.ch", Select: "chumpy.reordering"}
    own = Ch.__module__
    for kind, name in places.items():
        module = types.ModuleType(name)
        setattr(module, kind.__name__, kind)
        sys.modules[name], kind.__module__ = module, name
    sys.modules["chumpy"] = types.ModuleType("chumpy")
    try:
        yield
    finally:
        for kind, name in places.items():
            kind.__module__ = own
            del sys.modules[name]
        del sys.modules["chumpy"]


def smpl_parents(joints: int) -> list[int]:
    """Parents of a body model's joints: an archive's 22, SMPL's two hands or fingers in chains of three, or a chain."""
    names = list(PARENTS)
    parents = [names.index(parent) if parent else -1 for parent in PARENTS.values()]
    left, right = names.index("left_wrist"), names.index("right_wrist")
    if joints == 24:
        return [*parents, left, right]
    if joints in (52, 55):
        face = [names.index("head")] * (joints - 52)
        first = len(parents) + len(face)
        fingers = [(left if k < 15 else right) if k % 3 == 0 else first + k - 1 for k in range(30)]
        return [*parents, *face, *fingers]
    return [-1, *(max(0, k - 1 - k % 3) for k in range(1, joints))]


def smpl_arrays(joints: int = 24, shapes: int = 10, seed: int = 0, faces: int | None = None) -> dict[str, np.ndarray]:
    """The arrays of a body model, made from the shipped body: its surface, joints and weights, random corrections.

    Joints that the shipped body does not have lie between random vertices and have random small weights. With `faces`
    it has about so many instead of 13,776.
    """
    body, rng = load_body(), np.random.default_rng(seed)
    if faces is not None:
        kept, triangles = decimation(faces)
        body = replace(body.part(kept), faces=triangles)
    count, names = len(body.vertices), list(PARENTS)
    weights, centres = np.zeros((count, joints)), rng.choice(body.vertices, joints)
    for j, joint in enumerate(body.joint_names):
        while joint not in OURS.values():
            joint = body.joint_names[body.parents[body.joint(joint)]]
        theirs = names.index(next(name for name, ours in OURS.items() if ours == joint))
        weights[:, theirs % joints] += body.weights[:, j]
        centres[theirs % joints] = body.joints[body.joint(joint)]
    weights[:, 22:] += 0.01 * rng.random((count, max(joints - 22, 0)))
    regressor = np.zeros((joints, count))
    for j, centre in enumerate(centres):
        nearest = np.argsort(np.linalg.norm(body.vertices - centre, axis=1))[:6]
        regressor[j, nearest] = rng.dirichlet(np.ones(6))
    parents = np.array(smpl_parents(joints))
    return {
        "v_template": body.vertices,
        "shapedirs": 0.01 * rng.standard_normal((count, 3, shapes)),
        "posedirs": 0.002 * rng.standard_normal((count, 3, 9 * (joints - 1))),
        "J_regressor": regressor,
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "kintree_table": np.array([np.where(parents < 0, 2**32 - 1, parents), np.arange(joints)], np.uint32),
        "f": body.faces.astype(np.uint32),
    }


def small_arrays(joints: int = 5, vertices: int = 12, shapes: int = 3, seed: int = 0) -> dict[str, np.ndarray]:
    """The arrays of a tiny body model: random points, joints in a tree of several branches."""
    rng = np.random.default_rng(seed)
    parents = np.array([-1, *(int(rng.integers(k)) for k in range(1, joints))])
    return {
        "v_template": rng.standard_normal((vertices, 3)),
        "shapedirs": 0.1 * rng.standard_normal((vertices, 3, shapes)),
        "posedirs": 0.1 * rng.standard_normal((vertices, 3, 9 * (joints - 1))),
        "J_regressor": rng.dirichlet(np.ones(vertices), joints),
        "weights": rng.dirichlet(np.ones(joints), vertices),
        "kintree_table": np.array([np.where(parents < 0, 2**32 - 1, parents), np.arange(joints)], np.int64),
        "f": rng.integers(vertices, size=(7, 3)),
    }


def write_model(path: Path, arrays: dict[str, np.ndarray], protocol: int = 2, chumpy: bool = False) -> Path:
    """Write a body model as .npz or .pkl; a pickle has a sparse regressor and entries that posing does not need.

    With `chumpy` the shape and pose directions are chumpy's variables, as in old files.
    """
    if path.suffix == ".npz":
        np.savez(path, **arrays)
        return path
    others = {"bs_style": "lbs", "bs_type": "lrotmin", "vert_sym_idxs": np.arange(4), "pose_training_info": {"n": 2}}
    entries = {**arrays, "J_regressor": scipy.sparse.csc_matrix(arrays["J_regressor"]), **others}
    with chumpy_modules():
        if chumpy:
            entries |= {name: Ch(entries[name]) for name in ("shapedirs", "posedirs", "weights")}
        path.write_bytes(pickle.dumps(entries, protocol))
    return path


def loop_vertices(arrays: dict[str, np.ndarray], betas: np.ndarray, pose: np.ndarray, trans: np.ndarray) -> np.ndarray:
    """Pose a body model by plain loops over joints and vertices, with 4 x 4 matrices, as the paper's equations are.

    Args:
        betas: shape coefficients.
        pose: rotation vectors (J, 3).
        trans: translation.
    """
    shapes = arrays["shapedirs"][:, :, : len(betas)]
    shaped = arrays["v_template"] + sum((shapes[:, :, k] * betas[k] for k in range(len(betas))), np.zeros(3))
    joints = arrays["J_regressor"] @ shaped
    rotations = [_rodrigues(vector) for vector in pose]
    corrected, k = shaped.copy(), 0
    for rotation in rotations[1:]:
        for row in range(3):
            for column in range(3):
                corrected += arrays["posedirs"][:, :, k] * (rotation[row, column] - (row == column))
                k += 1
    world: list[np.ndarray] = []
    for j, rotation in enumerate(rotations):
        parent = int(arrays["kintree_table"][0, j]) if j else None
        local = np.eye(4)
        local[:3, :3] = rotation
        local[:3, 3] = joints[j] if parent is None else joints[j] - joints[parent]
        world.append(local if parent is None else world[parent] @ local)
    result = np.zeros_like(corrected)
    for v, point in enumerate(corrected):
        for j, transform in enumerate(world):
            from_joint = np.append(point - joints[j], 1.0)
            result[v] += arrays["weights"][v, j] * (transform @ from_joint)[:3]
    return result + trans


def _rodrigues(vector: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector, by Rodrigues' formula (Eq. 1)."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
