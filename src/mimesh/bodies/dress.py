"""Garments of the shipped human, with its shape coefficients and joints: their exact result of a transfer is known.

Networks are trained with them; `research/recipes/build_dress.py` builds them from MakeHuman's helper meshes, each as
one open surface. Cloth is not simulated, so a skirt stretches between spread legs.
"""

from __future__ import annotations

import dataclasses
from importlib import resources

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from .body_model import RiggedBody, unpacked_weights

GARMENTS = ("skirt", "tights", "hair")
"""A long skirt; a suit from neck to wrists and toes; long hair. Skirt and hair fit over tights."""


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


def dressed_body(body: RiggedBody, garments: tuple[str, ...]) -> RiggedBody:
    """Combine a body and the named garments to one rigged body: vertices of the body, then of each garment in order.

    Skin under a garment is kept, and garments may intersect it in extreme poses.

    Raises:
        InputError: an unknown or repeated garment, a body that is not the shipped human, or a body with more components
            than the garments (with fewer, the first ones are used).
    """
    worn = [load_garment(name) for name in garments]
    if len(set(garments)) < len(garments):
        raise InputError(f"garments: expected each at most once, found {', '.join(garments)}; name each once")
    with _open() as data:
        joints, count = data["joints"], len(data[f"{GARMENTS[0]}_components"])
    if body.joints.shape != joints.shape or np.abs(body.joints - joints).max() >= 1e-3:
        raise InputError(f"{body.name}: expected the shipped human, found another body; dress load_body('human')")
    if len(body.components) > count:
        raise InputError(
            f"{body.name}: expected at most the {count} shape components that garments follow, "
            f"found {len(body.components)}; leave the others out"
        )
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


def load_garment(name: str) -> Garment:
    """Load a garment by name; raise InputError if there is none of that name."""
    if name not in GARMENTS:
        raise InputError(f"{name}: expected a garment ({', '.join(GARMENTS)}), found another name; name one of them")
    with _open() as data:
        return Garment(
            name=name,
            vertices=data[f"{name}_vertices"].astype(np.float64),
            faces=data[f"{name}_faces"].astype(np.int64),
            components=data[f"{name}_components"].astype(np.float64),
            weights=unpacked_weights(data[f"{name}_weight_joints"], data[f"{name}_weights"], len(data["joints"])),
        )


def _open() -> np.lib.npyio.NpzFile:
    return np.load(str(resources.files("mimesh.bodies") / "dress.npz"))
