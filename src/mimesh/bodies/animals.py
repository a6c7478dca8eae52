"""Animals for demos and figures: the shipped quadruped with the shapes of five species."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.mesh import Material, Mesh, Part
from .body_model import RiggedBody, load_body
from .characters import Colour
from .quadruped import POSTURES, postures
from .sampling import rotvec_to_rotmat


@dataclass(frozen=True)
class Animal:
    """Definition of an animal."""

    shape: tuple[float, ...]
    """Shape coefficients of the quadruped: the least-squares fit to a species of `scripts/quadruped_species.py`."""
    size: float
    """Factor on all lengths of the quadruped, which has one size for all species."""
    skin: Colour


ANIMALS: dict[str, Animal] = {
    "dog": Animal(
        shape=(
            0.95,
            1.12,
            -0.33,
            0.35,
            -0.12,
            -0.04,
            0.27,
            -0.68,
            0.0,
            0.38,
            -0.21,
            -0.52,
            0.5,
            -0.27,
            0.05,
            0.54,
            0.14,
            -0.1,
            -0.1,
            -0.13,
            -0.01,
            -0.25,
            -0.05,
            0.25,
            0.88,
            0.0,
            -0.52,
            -0.32,
            0.13,
            -0.33,
            0.44,
            0.2,
        ),
        size=1.1,
        skin=(0.342, 0.188, 0.081),
    ),
    "cat": Animal(
        shape=(
            2.28,
            1.14,
            0.08,
            -1.21,
            -0.42,
            -0.71,
            -0.38,
            -0.2,
            0.57,
            -0.12,
            -0.17,
            0.63,
            -0.1,
            -0.43,
            -0.09,
            -0.61,
            0.23,
            -1.03,
            -0.99,
            0.39,
            -0.34,
            0.26,
            0.35,
            0.26,
            -0.49,
            -0.08,
            -0.86,
            0.38,
            -0.86,
            -0.37,
            0.44,
            0.03,
        ),
        size=0.49,
        skin=(0.479, 0.22, 0.068),
    ),
    "horse": Animal(
        shape=(
            -0.69,
            0.62,
            -0.36,
            1.65,
            -0.03,
            -0.26,
            0.06,
            1.02,
            -0.38,
            0.26,
            0.69,
            0.67,
            -1.53,
            -0.09,
            0.89,
            0.1,
            0.87,
            0.5,
            -0.57,
            0.68,
            -0.69,
            0.11,
            -0.07,
            -0.8,
            -1.47,
            -0.03,
            0.57,
            0.57,
            -0.31,
            0.73,
            -0.82,
            -0.49,
        ),
        size=3.08,
        skin=(0.165, 0.058, 0.022),
    ),
    "cow": Animal(
        shape=(
            0.72,
            -0.56,
            1.02,
            1.18,
            -0.26,
            0.02,
            0.34,
            1.62,
            0.8,
            -0.16,
            0.32,
            -0.48,
            -0.17,
            0.42,
            0.13,
            -0.25,
            0.54,
            -1.54,
            0.94,
            -1.43,
            0.17,
            0.43,
            -1.16,
            1.45,
            0.21,
            -0.17,
            -0.18,
            -0.77,
            0.08,
            0.4,
            -0.44,
            -0.51,
        ),
        size=2.97,
        skin=(0.716, 0.631, 0.539),
    ),
    "rhino": Animal(
        shape=(
            0.1,
            -2.18,
            0.54,
            1.36,
            -1.76,
            0.38,
            0.94,
            -1.5,
            0.05,
            -0.17,
            -1.14,
            0.32,
            -0.86,
            0.58,
            -1.22,
            1.37,
            0.37,
            -0.56,
            -1.2,
            -0.52,
            0.43,
            0.25,
            0.95,
            -0.76,
            0.56,
            -0.01,
            0.84,
            0.34,
            -0.71,
            -0.3,
            0.68,
            -0.06,
        ),
        size=3.69,
        skin=(0.223, 0.216, 0.202),
    ),
}
"""Name -> animal."""


def animal(name: str) -> Mesh:
    """Build the mesh of an animal that stands as its species does: coloured, in metres, on y = 0, facing +z.

    Raises:
        InputError: no animal has this name.
    """
    body = animal_body(name)
    vertices = ANIMALS[name].size * body.posed(np.zeros(0), standing(body, name))
    mesh = body.mesh(vertices - [0, vertices[:, 1].min(), 0])
    part = Part("skin", 0, len(mesh.faces), Material("skin", (*ANIMALS[name].skin, 1.0)))
    return dataclasses.replace(mesh, name=name, parts=(part,))


def animal_body(name: str) -> RiggedBody:
    """Return the shipped quadruped with an animal's shape as its only one, in the size and the rest pose of all.

    Raises:
        InputError: no animal has this name.
    """
    if name not in ANIMALS:
        raise InputError(f"{name}: expected an animal ({', '.join(ANIMALS)}), found another name; use one of them")
    body = load_body("quadruped")
    vertices, joints = body.shaped(np.array(ANIMALS[name].shape))
    nothing = body.components[:0], body.joint_components[:0]
    return dataclasses.replace(
        body, vertices=vertices, joints=joints, components=nothing[0], joint_components=nothing[1]
    )


def standing(body: RiggedBody, name: str) -> Float[np.ndarray, "J 3 3"]:
    """Return the joint rotations of the quadruped with which an animal stands as its species does."""
    return rotvec_to_rotmat(postures(body)[list(POSTURES).index(name)])
