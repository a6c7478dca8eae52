"""Inputs that go wrong, or might, for the page of troubleshooting: each really happens, with the shipped body."""

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
OWN, THEIRS = np.array(IDENTITY_SHAPE), np.array(DRIVING_SHAPE)
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
CORNERS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
"""Sides of a box whose corners are counted as `product` does."""


class Case(NamedTuple):
    """A pair of meshes, how it is given, and what helps."""

    identity: Mesh
    driving: Mesh
    given: Mapping[str, Any] = MappingProxyType({})
    helped: dict[str, Any] | None = None
    """Other options; None where there is nothing to show."""
    label: str = ""
    """What the picture says of them."""
    inputs: tuple[Mesh, Mesh] | None = None
    """Other meshes for the remedy."""


def person(**degrees: tuple[float, float, float]) -> Mesh:
    """The driving person with some joints turned."""
    rotvec = np.zeros((len(BODY.joint_names), 3))
    for joint, turn in degrees.items():
        rotvec[BODY.joint(joint)] = np.radians(turn)
    return standing(THEIRS, rotvec, "pose")


def standing(shape: Float[np.ndarray, " K"], rotvec: Float[np.ndarray, "J 3"], name: str) -> Mesh:
    """A person of a shape in a pose."""
    return dataclasses.replace(BODY.mesh(BODY.posed(shape, rotvec_to_rotmat(rotvec))), name=name)


def hero() -> Mesh:
    """The identity: a person at rest."""
    return dataclasses.replace(BODY.mesh(BODY.shaped(OWN)[0]), name="hero")


def step() -> Mesh:
    """The driving person takes a step."""
    turns = {"LeftArm": (0, 0, -60), "RightArm": (0, 0, 50), "LeftForeArm": (0, -70, 0)}
    return person(**turns, RightUpLeg=(-40, 0, 0), RightLeg=(50, 0, 0))


def handstand() -> Case:
    turns = {"LeftArm": (0, 0, 70), "RightArm": (0, 0, -70), "LeftUpLeg": (0, 0, 35), "RightUpLeg": (0, 0, -35)}
    driving = dataclasses.replace(person(Hips=(0, 0, 180), **turns), name="handstand")
    helped = {"driving_up": "+y", "driving_front": "+z"}
    return Case(hero(), driving, {}, helped, "--driving-up y --driving-front z")


def z_up() -> Case:
    driving = step()
    turned = dataclasses.replace(driving, vertices=driving.vertices @ Z_UP.T)
    return Case(hero(), turned, {"driving_up": "+y", "driving_front": "+z"}, {}, "axes left to mimesh")


def backwards() -> Case:
    return Case(hero(), step(), {"driving_front": "-z"}, {}, "front left to mimesh")


def chair() -> Case:
    legs = [((x, 0.22, z), (0.06, 0.44, 0.06)) for x, z in product((-0.21, 0.21), repeat=2)]
    boxes = [((0, 0.45, 0), (0.5, 0.06, 0.5)), ((0, 0.8, -0.22), (0.5, 0.7, 0.06)), *legs]
    return Case(joined("chair", *(box(*one) for one in boxes)), step())


def shield() -> Case:
    own = hero()
    carried = joined("hero", (own.vertices, own.faces), box((0.6, 1.3, 0.12), (0.5, 0.7, 0.04)))
    return Case(carried, step(), {}, {}, "the shield left out", (own, step()))


def cropped() -> Case:
    part = remesh.cropped(BODY, np.random.default_rng(1))
    return Case(hero(), Mesh(part.positions(step().vertices), part.faces, name="scan"))


def one_side() -> Case:
    part = remesh.half(BODY, step().vertices, np.random.default_rng(0))
    return Case(hero(), Mesh(part.positions(step().vertices), part.faces, name="scan"))


def noisy() -> Case:
    driving = step()
    moved = driving.vertices + np.random.default_rng(0).normal(scale=0.034, size=driving.vertices.shape)
    return Case(hero(), dataclasses.replace(driving, vertices=moved, name="noisy"))


def dressed() -> Case:
    body = dressed_body(BODY, ("skirt", "hair"))
    return Case(dataclasses.replace(body.mesh(body.shaped(OWN)[0]), name="dressed"), step())


def extreme() -> Case:
    driving = standing(THEIRS, sample_pose(BODY, 11, 8, JOINT_LIMITS), "contortion")
    return Case(hero(), driving, {"driving_up": "+y", "driving_front": "+z"}, {"model": "skeleton"}, "-m skeleton")


def touch() -> Case:
    folded = touching(BODY, OWN, 0.8 * lowered_arms(BODY), "arms", np.random.default_rng(4))
    return Case(standing(OWN, folded, "hero"), person(LeftArm=(0, 0, 30), RightArm=(0, 0, -30)))


def wrists() -> Case:
    return Case(hero(), person(LeftForeArm=(150, 0, 0), RightForeArm=(-150, 0, 0)))


def rough() -> Case:
    return Case(hero(), step(), {"model": "npt", "refine": False}, {"model": "npt"}, "-m npt, refined")


def box(middle: tuple[float, float, float], size: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of a box."""
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * size + middle
    return corners, np.concatenate([CORNERS[:, [0, 1, 2]], CORNERS[:, [0, 2, 3]]])


def joined(name: str, *pieces: tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]) -> Mesh:
    """Pieces as one mesh."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [triangles + start for (_, triangles), start in zip(pieces, first, strict=False)]
    return Mesh(np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces), name=name)


CASES: tuple[Callable[[], Case], ...] = (
    *(handstand, z_up, backwards, chair, shield, cropped, one_side),
    *(noisy, dressed, extreme, touch, wrists, rough),
)
