"""Animals for demos and figures: the shipped quadruped with the shapes of seven species."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.mesh import Material, Mesh, Part
from .body_model import RiggedBody, load_body
from .characters import Colour
from .quadruped import posture
from .sampling import rotvec_to_rotmat


@dataclass(frozen=True)
class Animal:
    """Definition of an animal."""

    shape: tuple[float, ...]
    """First shape coefficients of the quadruped, as `research/recipes/build_quadruped.py --shapes` prints them: the
    surface is within 4 mm of that species' on average, 33 mm at most."""
    size: float
    """Factor on all lengths of the quadruped, which has one size for all species."""
    skin: Colour


ANIMALS: dict[str, Animal] = {
    "dog": Animal(
        shape=(1.0, 1.1, -0.3, 0.4, -0.1, 0.0, 0.3, -0.7, 0.0, 0.4, -0.2, -0.5),
        size=1.1,
        skin=(0.342, 0.188, 0.081),
    ),
    "cat": Animal(
        shape=(2.3, 1.1, 0.1, -1.2, -0.4, -0.7, -0.4, -0.2, 0.6, -0.1, -0.2, 0.6),
        size=0.49,
        skin=(0.479, 0.22, 0.068),
    ),
    "horse": Animal(
        shape=(-0.7, 0.6, -0.4, 1.7, 0.0, -0.3, 0.1, 1.0, -0.4, 0.3, 0.7, 0.7),
        size=3.08,
        skin=(0.165, 0.058, 0.022),
    ),
    "cow": Animal(
        shape=(0.7, -0.6, 1.0, 1.2, -0.3, 0.0, 0.3, 1.6, 0.8, -0.2, 0.3, -0.5),
        size=2.97,
        skin=(0.716, 0.631, 0.539),
    ),
    "rhino": Animal(
        shape=(0.1, -2.2, 0.5, 1.4, -1.8, 0.4, 0.9, -1.5, 0.1, -0.2, -1.1, 0.3),
        size=3.69,
        skin=(0.223, 0.216, 0.202),
    ),
    "lion": Animal(
        shape=(1.5, 0.4, 0.5, -0.5, 0.1, 1.3, -0.1, 0.3, 0.1, -0.7, -0.2, 1.3),
        size=1.6,
        skin=(0.485, 0.281, 0.095),
    ),
    "camel": Animal(
        shape=(-1.5, 0.9, 0.7, -0.3, -0.1, 0.7, 0.9, 0.0, 1.0, -2.3, 0.6, 0.6),
        size=3.2,
        skin=(0.44, 0.25, 0.11),
    ),
}
"""Name -> animal."""


def animal(name: str) -> Mesh:
    """Build the mesh of an animal that stands as its species does: coloured, in metres, on y = 0, facing +z."""
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
    return rotvec_to_rotmat(posture(body, name))
