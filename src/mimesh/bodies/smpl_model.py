"""SmplModel: a body model that a user has as a file in SMPL's layout (SMPL, SMPL+H, SMPL-X, SMAL), not shipped.

Loper, Mahmood, Romero, Pons-Moll and Black, SMPL: A Skinned Multi-Person Linear Model (SIGGRAPH Asia 2015). Frame: that
of the file; in the published models metres, y up, facing +z. Files may be .npz archives, or pickles of Python 2 or 3,
which are read without running anything in them (`core.pickled_arrays`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError, option
from ..core.npz_archive import open_archive, read_array, read_array_header
from ..core.pickled_arrays import array_of, read_pickle
from ..core.skinning import skin_poses
from .body_model import RiggedBody

ARRAYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")
"""Names of the arrays of a file."""
MARK = "v_template"
"""Name of the array that tells a body model from other archives."""
CHUNK = 32
"""Frames posed at once by `frames`, which bounds the memory for a long clip."""


@dataclass(frozen=True, eq=False)
class SmplModel(RiggedBody):
    """A body model whose poses correct the shape; its joints are named by their numbers."""

    pose_directions: Float[np.ndarray, "V 3 P"]
    """Displacement of the vertices for each of the P = 9 (J - 1) numbers of the joints' rotations."""

    def posed(
        self,
        shape: Float[np.ndarray, "*#B K"],
        rotmat: Float[np.ndarray, "*#B J 3 3"],
        root: Float[np.ndarray, "*#B 3"] | None = None,
    ) -> Float[np.ndarray, "*C V 3"]:
        """As `RiggedBody.posed`, with the corrections (Eq. 2 to 10)."""
        # Eq. 9: the displacements are linear in the rotations of all joints but the root, less those at rest.
        features = (rotmat[..., 1:, :, :] - np.eye(3)).reshape(*rotmat.shape[:-3], -1)
        vertices, joints = self.shaped(shape)
        corrected = vertices + np.tensordot(features, self.pose_directions, axes=(-1, 2))
        return skin_poses(corrected, self.weights, *self.skinning_transforms(joints, rotmat, root))

    def frames(
        self, shape: Float[np.ndarray, " K"], rotmat: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"]
    ) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the vertices of `posed` frame by frame."""
        for t in range(0, len(rotmat), CHUNK):
            yield from self.posed(shape, rotmat[t : t + CHUNK], root[t : t + CHUNK])


def load_smpl_model(path: str | Path) -> SmplModel:
    """Load a body model from a .pkl or .npz with the arrays of ARRAYS.

    Raises:
        InputError: no such file, a damaged or malicious one, or arrays that are missing, not finite or do not fit
            together.
    """
    path = Path(path)
    if path.suffix.lower() not in (".pkl", ".npz") or not path.is_file():
        found = f"'{path.suffix}'" if path.is_file() else "nothing of that name"
        raise InputError(f"{path}: expected a body model as .pkl or .npz, found {found}; check the path")
    arrays = _read_npz(path) if path.suffix.lower() == ".npz" else _read_pickle(path)
    template = _numbers(arrays, "v_template", (None, 3), path)
    count = len(template)
    regressor = _numbers(arrays, "J_regressor", (None, count), path)
    joints = len(regressor)
    faces = _faces(arrays["f"], count, path)
    components = np.moveaxis(_numbers(arrays, "shapedirs", (count, 3, None), path), 2, 0)
    return SmplModel(
        name=path.stem,
        vertices=template,
        faces=faces,
        components=components,
        joints=regressor @ template,
        joint_components=regressor @ components,  # Eq. 10 is linear in the shape
        weights=_numbers(arrays, "weights", (count, joints), path),
        joint_names=tuple(map(str, range(joints))),
        parents=_parents(arrays["kintree_table"], joints, path),
        pose_directions=_numbers(arrays, "posedirs", (count, 3, 9 * (joints - 1)), path),
    )


def _read_pickle(path: Path) -> dict[str, np.ndarray]:
    entries = read_pickle(path.read_bytes(), path)
    _check_names(entries if isinstance(entries, dict) else (), path)
    return {name: array_of(entries[name], name, path) for name in ARRAYS}


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of an archive; one of a single object, as SciPy's sparse matrices are saved, is a pickle."""
    with path.open("rb") as file, open_archive(file, path) as (archive, names):
        _check_names(names, path)
        arrays = {}
        for name in ARRAYS:
            with archive.open(f"{name}.npy") as member:
                is_object = read_array_header(member, objects=True).dtype.hasobject
                arrays[name] = (
                    array_of(read_pickle(member.read(), path), name, path) if is_object else read_array(archive, name)
                )
        return arrays


def _check_names(names: Collection[str], path: Path) -> None:
    missing = [name for name in ARRAYS if name not in names]
    if missing:
        found = ", ".join(repr(name)[1:-1] for name in list(names)[:12]) or "none"  # names may be anything
        remedy = "check that the file is a body model"
        if {"pose", "trans"} & set(names):
            remedy = f"a file of poses needs a model: mimesh convert IN OUT {option('body_model')} SMPL.pkl"
        raise InputError(f"{path}: expected the arrays {', '.join(missing)}, found {found[:200]}; {remedy}")


def _numbers(arrays: dict[str, np.ndarray], name: str, shape: tuple[int | None, ...], path: Path) -> np.ndarray:
    """Check that an array has finite numbers in a shape, in which None is any size but zero; return it as float64."""
    values = arrays[name]
    fits = len(values.shape) == len(shape) and all(
        size > 0 and (wanted is None or size == wanted) for size, wanted in zip(values.shape, shape, strict=True)
    )
    if not fits or values.dtype.kind not in "fiu":
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(
            f"{path}: expected '{name}' to be numbers of shape ({wanted}), found {values.dtype} {values.shape}; "
            "check that the file is a body model in SMPL's layout"
        )
    if not np.isfinite(values).all():
        raise InputError(
            f"{path}: expected finite numbers, found NaN or infinity in '{name}'; copy or download the file again"
        )
    return values.astype(np.float64)


def _faces(faces: np.ndarray, vertices: int, path: Path) -> Int[np.ndarray, "F 3"]:
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or len(faces) == 0:
        raise InputError(
            f"{path}: expected 'f' to be whole numbers of shape (F, 3), found {faces.dtype} {faces.shape}; "
            "check that the file is a body model in SMPL's layout"
        )
    if faces.min() < 0 or faces.max() >= vertices:
        raise InputError(
            f"{path}: expected 'f' in 0..{vertices - 1}, found {faces.min()} to {faces.max()}; "
            "copy or download the file again"
        )
    return faces.astype(np.int64)


def _parents(table: np.ndarray, joints: int, path: Path) -> tuple[int, ...]:
    """Read the parents: column k of the table has the number of joint k in its second row, its parent's in the first.

    The root's parent is -1, which unsigned types store as 2^32 - 1 or 2^64 - 1.
    """
    if table.shape != (2, joints) or table.dtype.kind not in "iu":
        raise InputError(
            f"{path}: expected 'kintree_table' to be whole numbers of shape (2, {joints}), found {table.dtype} "
            f"{table.shape}; check that the file is a body model in SMPL's layout"
        )
    above, numbers = ([int(number) for number in row] for row in table)
    column = {number: k for k, number in enumerate(numbers)}
    parents = tuple(column.get(number, -1) for number in above)
    # Parents before children: there is one root then, and no joint is above itself.
    bad = [k for k, parent in enumerate(parents) if (k == 0) != (parent < 0) or parent >= k]
    if bad or len(column) != joints or above[0] not in (-1, 2**32 - 1, 2**64 - 1):
        where = bad[0] if bad else 0
        raise InputError(
            f"{path}: expected a tree of joints, parents before their children, found {above[where]} as the parent of "
            f"joint {numbers[where]} in 'kintree_table'; copy or download the file again"
        )
    return parents
