"""Difficult or unusable inputs for the page of troubleshooting, made of the shipped body."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from itertools import product
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mimesh import Mesh
from mimesh.bodies import load_body
from mimesh.bodies.contacts import touching
from mimesh.bodies.dress import dressed_body
from mimesh.bodies.sampling import JOINT_LIMITS, lowered_arms, rotvec_to_rotmat, sample_pose
from mimesh.evaluate import remesh
from mimesh.tools.demo import DRIVING_SHAPE, IDENTITY_SHAPE

BODY = load_body()
IDENTITY_PERSON, DRIVING_PERSON = np.array(IDENTITY_SHAPE), np.array(DRIVING_SHAPE)
"""Shape coefficients."""
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Rotation from y up to z up."""
BOX_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
"""Corners of the six sides of a box, numbered in the order of `itertools.product`."""


class Case(NamedTuple):
    """A pair of meshes, the options of the transfer, and a remedy."""

    identity: Mesh
    driving: Mesh
    options: Mapping[str, Any] = MappingProxyType({})
    """Options of `mimesh.transfer`."""
    remedy: dict[str, Any] | None = None
    """Options that improve the result; None if there is no remedy to show."""
    remedy_label: str = ""
    """Caption of the result with the remedy."""
    remedy_inputs: tuple[Mesh, Mesh] | None = None
    """Other identity and driving mesh for the remedy."""


def person(**degrees: tuple[float, float, float]) -> Mesh:
    """Return the driving person with some joints rotated: rotation vectors in degrees by joint name."""
    rotvec = np.zeros((len(BODY.joint_names), 3))
    for joint, rotation in degrees.items():
        rotvec[BODY.joint(joint)] = np.radians(rotation)
    return posed_mesh(DRIVING_PERSON, rotvec, "pose")


def posed_mesh(shape: Float[np.ndarray, " K"], rotvec: Float[np.ndarray, "J 3"], name: str) -> Mesh:
    """Return a person of a shape in a pose (rotation vectors, radians)."""
    return dataclasses.replace(BODY.mesh(BODY.posed(shape, rotvec_to_rotmat(rotvec))), name=name)


def hero() -> Mesh:
    """Return the identity: a person at rest."""
    return dataclasses.replace(BODY.mesh(BODY.shaped(IDENTITY_PERSON)[0]), name="hero")


def step() -> Mesh:
    """Return the driving mesh: a person taking a step."""
    turns = {"LeftArm": (0, 0, -60), "RightArm": (0, 0, 50), "LeftForeArm": (0, -70, 0)}
    return person(**turns, RightUpLeg=(-40, 0, 0), RightLeg=(50, 0, 0))


def handstand() -> Case:
    turns = {"LeftArm": (0, 0, 70), "RightArm": (0, 0, -70), "LeftUpLeg": (0, 0, 35), "RightUpLeg": (0, 0, -35)}
    driving = dataclasses.replace(person(Hips=(0, 0, 180), **turns), name="handstand")
    remedy = {"driving_up": "+y", "driving_front": "+z"}
    return Case(hero(), driving, {}, remedy, "--driving-up y --driving-front z")


def lying() -> Case:
    driving = dataclasses.replace(person(Hips=(-90, 0, 0), LeftArm=(0, 0, -60), RightArm=(0, 0, 60)), name="lying")
    axes = {"driving_up": "+y", "driving_front": "+z"}
    return Case(hero(), driving, {}, axes, "--driving-up y --driving-front z")


def z_up() -> Case:
    driving = step()
    turned = dataclasses.replace(driving, vertices=driving.vertices @ Z_UP.T)
    return Case(hero(), turned, {"driving_up": "+y", "driving_front": "+z"}, {}, "axes left to mimesh")


def backwards() -> Case:
    return Case(hero(), step(), {"driving_front": "-z"}, {}, "front left to mimesh")


def chair() -> Case:
    legs = [((x, 0.22, z), (0.06, 0.44, 0.06)) for x, z in product((-0.21, 0.21), repeat=2)]
    boxes = [((0, 0.45, 0), (0.5, 0.06, 0.5)), ((0, 0.8, -0.22), (0.5, 0.7, 0.06)), *legs]
    return Case(joined("chair", *(box(*centre_and_size) for centre_and_size in boxes)), step())


def shield() -> Case:
    person_mesh = hero()
    with_shield = joined("hero", (person_mesh.vertices, person_mesh.faces), box((0.6, 1.3, 0.12), (0.5, 0.7, 0.04)))
    return Case(with_shield, step(), {}, {}, "the shield left out", (person_mesh, step()))


def cropped() -> Case:
    part = remesh.cropped(BODY, np.random.default_rng(1))
    return Case(hero(), Mesh(part.positions(step().vertices), part.faces, name="scan"))


def one_side() -> Case:
    part = remesh.half(BODY, step().vertices, np.random.default_rng(0))
    return Case(hero(), Mesh(part.positions(step().vertices), part.faces, name="scan"))


def noisy() -> Case:
    driving = step()
    noisy_vertices = driving.vertices + np.random.default_rng(0).normal(scale=0.034, size=driving.vertices.shape)
    return Case(hero(), dataclasses.replace(driving, vertices=noisy_vertices, name="noisy"))


def dressed() -> Case:
    body = dressed_body(BODY, ("skirt", "hair"))
    return Case(dataclasses.replace(body.mesh(body.shaped(IDENTITY_PERSON)[0]), name="dressed"), step())


def extreme() -> Case:
    driving = posed_mesh(DRIVING_PERSON, sample_pose(BODY, 11, 8, JOINT_LIMITS), "contortion")
    return Case(hero(), driving, {"driving_up": "+y", "driving_front": "+z"}, {"model": "skeleton"}, "-m skeleton")


def touch() -> Case:
    folded = touching(BODY, IDENTITY_PERSON, 0.8 * lowered_arms(BODY), "arms", np.random.default_rng(4))
    return Case(posed_mesh(IDENTITY_PERSON, folded, "hero"), person(LeftArm=(0, 0, 30), RightArm=(0, 0, -30)))


def wrists() -> Case:
    return Case(hero(), person(LeftForeArm=(150, 0, 0), RightForeArm=(-150, 0, 0)))


def rough() -> Case:
    return Case(hero(), step(), {"model": "npt", "refine": False}, {"model": "npt"}, "-m npt, refined")


def box(centre: tuple[float, float, float], size: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners and triangles of a box."""
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * size + centre
    return corners, np.concatenate([BOX_SIDES[:, [0, 1, 2]], BOX_SIDES[:, [0, 2, 3]]])


def joined(name: str, *pieces: tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]) -> Mesh:
    """Join pieces (vertices, triangles) into one mesh."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [triangles + start for (_, triangles), start in zip(pieces, first, strict=False)]
    return Mesh(np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces), name=name)


CASES: tuple[Callable[[], Case], ...] = (
    *(handstand, lying, z_up, backwards, chair, shield, cropped, one_side),
    *(noisy, dressed, extreme, touch, wrists, rough),
)
"""All cases; the name of a function is the name of its picture and notes."""
