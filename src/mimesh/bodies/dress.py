"""Garments of the shipped human, with its shape coefficients and joints: their exact result of a transfer is known.

GARMENTS are shipped, and networks are trained with them; `research/recipes/build_dress.py` builds them from MakeHuman's
helper meshes, and each is one open surface. TEST_GARMENTS are worn by tests only and read from a folder;
`research/recipes/build_test_dress.py` builds them from MakeHuman's clothes. Cloth is not simulated, so a skirt
stretches between spread legs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.npz_archive import check_unpacked_size, open_archive, read_array
from .body_model import RiggedBody, unpacked_weights

GARMENTS = ("skirt", "tights", "hair")
"""A long skirt; a suit from neck to wrists and toes; long hair. Skirt and hair fit over tights."""
TEST_GARMENTS = ("casual_suit", "elegant_suit", "skirt_suit", "shoes", "bob")
"""Shirt and trousers; jacket and trousers; jacket and short skirt; shoes; short hair. No training may use them."""
TEST_FILE = "test_dress.npz"
"""Name of the file of the test garments."""
MAX_BYTES = 64 << 20
"""Largest unpacked size of the file of test garments (bytes). The one that the script builds has 0.7 MB."""
REBUILD = "build it with research/recipes/build_test_dress.py"
"""Advice for a file of test garments that cannot be used."""
ARRAYS = {
    "vertices": ("f", 2),
    "faces": ("iu", 2),
    "components": ("f", 3),
    "weight_joints": ("iu", 2),
    "weights": ("f", 2),
}
"""Arrays of a garment: kinds of number as in `numpy.dtype.kind`, and number of dimensions."""


@dataclasses.dataclass(frozen=True, eq=False)
class Garment:
    """A garment at rest on the mean shape, in the body's frame (metres)."""

    name: str
    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    components: Float[np.ndarray, "K V 3"]
    """Displacement for one standard deviation of each of the body's shape coefficients."""
    weights: Float[np.ndarray, "V J"]
    """Skinning weights of the body's joints, rows sum to 1."""


def dressed_body(body: RiggedBody, garments: tuple[str, ...], folder: Path | None = None) -> RiggedBody:
    """Combine a body and the named garments to one rigged body: vertices of the body, then of each garment in order.

    Skin under a garment is kept, and garments may intersect it in extreme poses.

    Args:
        folder: where TEST_FILE is, for test garments.

    Raises:
        InputError: an unknown or repeated garment, a body that is not the shipped human, a body with more components
            than the garments (with fewer, the first ones are used), or test garments without a readable file.
    """
    worn = [load_garment(name, folder) for name in garments]
    if len(set(garments)) < len(garments):
        raise InputError(f"garments: expected each at most once, found {', '.join(garments)}; name each once")
    _check_fits(body)
    count = len(body.components)
    # Faces of each garment are shifted by the number of vertices before it.
    first = np.cumsum([len(part.vertices) for part in (body, *worn)])
    return dataclasses.replace(
        body,
        name="+".join((body.name, *garments)),
        vertices=np.concatenate([body.vertices, *(g.vertices for g in worn)]),
        faces=np.concatenate([body.faces, *(g.faces + start for g, start in zip(worn, first, strict=False))]),
        components=np.concatenate([body.components, *(g.components[:count] for g in worn)], axis=1),
        weights=np.concatenate([body.weights, *(g.weights for g in worn)]),
    )


def load_garment(name: str, folder: Path | None = None) -> Garment:
    """Load a garment by name: a shipped one, or a test garment from TEST_FILE in `folder`.

    Raises:
        InputError: no such garment, or no file of test garments that fits the shipped human.
    """
    if name not in (*GARMENTS, *TEST_GARMENTS):
        known = ", ".join((*GARMENTS, *TEST_GARMENTS))
        raise InputError(f"{name}: expected a garment ({known}), found another name; name one of them")
    if name in GARMENTS:
        with _open() as data:
            return _read_garment(name, data)
    path = garment_file(name, folder)
    with path.open("rb") as file, open_archive(file, path) as (archive, _):
        check_unpacked_size(archive, path, MAX_BYTES)
        needed = ["joints", *(f"{name}_{key}" for key in ARRAYS)]
        missing = [array for array in needed if f"{array}.npy" not in archive.namelist()]
        if missing:
            raise InputError(
                f"{path}: expected the arrays of the garment {name}, found no {', '.join(missing)}; {REBUILD}"
            )
        arrays = {array: read_array(archive, array) for array in needed}
    with _open() as data:
        if not np.array_equal(arrays["joints"], data["joints"]):
            raise InputError(f"{path}: expected garments of the shipped human, found another body's; {REBUILD}")
        count = len(data[f"{GARMENTS[0]}_components"])
    _check_garment(name, arrays, count, path)
    return _read_garment(name, arrays)


def garment_file(what: str, folder: Path | None) -> Path:
    """Return the path of TEST_FILE in a folder; `what` needs it.

    Raises:
        InputError: no folder, or no such file in it.
    """
    if folder is None:
        raise InputError(f"{what}: expected the folder of {TEST_FILE}, found none; give it with --data")
    path = folder / TEST_FILE
    if not path.is_file():
        raise InputError(f"{folder}: expected {TEST_FILE} in it, found no such file; {REBUILD}")
    return path


def _check_garment(name: str, arrays: Mapping[str, np.ndarray], components: int, path: Path) -> None:
    """Check that arrays describe a garment with a number of shape components.

    Raises:
        InputError: an array of another type or shape, or values that are not finite or out of range.
    """
    given = {key: arrays[f"{name}_{key}"] for key in ARRAYS}
    for key, (kinds, dimensions) in ARRAYS.items():
        if given[key].dtype.kind not in kinds or given[key].ndim != dimensions:
            found = f"{given[key].dtype} {given[key].shape}"
            raise InputError(f"{path}: expected {name}_{key} of the garment's format, found {found}; {REBUILD}")
    vertices, joints = len(given["vertices"]), len(arrays["joints"])
    influences = given["weights"].shape[1]
    shapes = {
        "vertices": (vertices, 3),
        "faces": (len(given["faces"]), 3),
        "components": (components, vertices, 3),
        "weight_joints": (vertices, influences),
        "weights": (vertices, influences),
    }
    for key, array in given.items():
        if array.shape != shapes[key]:
            raise InputError(f"{path}: expected {name}_{key} of shape {shapes[key]}, found {array.shape}; {REBUILD}")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: expected finite {name}_{key}, found other values; {REBUILD}")
    for key, end in (("faces", vertices), ("weight_joints", joints)):
        if given[key].size and not (given[key].min() >= 0 and given[key].max() < end):
            raise InputError(f"{path}: expected {name}_{key} from 0 to {end - 1}, found others; {REBUILD}")
    if not (given["weights"] >= 0).all() or not (given["weights"].max(axis=1, initial=0) > 0).all():
        raise InputError(f"{path}: expected {name}_weights that sum to 1, found vertices without; {REBUILD}")


def _read_garment(name: str, data: Mapping[str, np.ndarray]) -> Garment:
    """Make a garment of the arrays of a file."""
    return Garment(
        name=name,
        vertices=data[f"{name}_vertices"].astype(np.float64),
        faces=data[f"{name}_faces"].astype(np.int64),
        components=data[f"{name}_components"].astype(np.float64),
        weights=unpacked_weights(data[f"{name}_weight_joints"], data[f"{name}_weights"], len(data["joints"])),
    )


def _check_fits(body: RiggedBody) -> None:
    """Raise InputError for a body with joints over 1 mm from the shipped human's, or with more components."""
    with _open() as data:
        joints, count = data["joints"], len(data[f"{GARMENTS[0]}_components"])
    same = body.joints.shape == joints.shape and np.abs(body.joints - joints).max() < 1e-3
    if not same:
        raise InputError(f"{body.name}: expected the shipped human, found another body; dress load_body('human')")
    if len(body.components) > count:
        raise InputError(
            f"{body.name}: expected at most the {count} shape components that garments follow, "
            f"found {len(body.components)}; leave the others out"
        )


def _open() -> np.lib.npyio.NpzFile:
    return np.load(str(resources.files("mimesh.bodies") / "dress.npz"))
