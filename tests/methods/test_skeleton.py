"""The skeleton baseline: exact where it can be, near the truth where it cannot."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from people import person

from mimesh.evaluate.metrics import pmd_of_pair
from mimesh.frame import Frame
from mimesh.mesh import Mesh, permute_vertices
from mimesh.methods import Method
from mimesh.methods.skeleton import Skeleton

EMPTY = np.zeros((0, 3), int)


def normalised(mesh: Mesh) -> Mesh:
    return dataclasses.replace(mesh, vertices=Frame.fit(mesh, "+y", "+z").apply(mesh.vertices))


def moved(identity: Mesh, driving: Mesh, frames=None):
    identity, driving = normalised(identity), normalised(driving)
    drive = Skeleton().prepare(identity, driving)
    return list(drive([driving.vertices] if frames is None else frames))


@cache
def example():
    return moved(person(0, pose=3), person(1, pose=1))[0]


def test_it_is_a_method():
    assert isinstance(Skeleton(), Method)
    assert Skeleton().name == "skeleton"


def test_the_identity_as_driving_gives_the_identity():
    mesh = normalised(person(0, pose=1))
    assert np.allclose(moved(mesh, mesh)[0], mesh.vertices, rtol=0, atol=1e-12)


def test_the_result_is_near_the_truth():
    identity, truth = person(0, pose=3), person(0, pose=1).vertices
    size = Frame.fit(identity, "+y", "+z").radius
    error = pmd_of_pair(size * example(), truth)
    assert error < 6e-4  # the paper's has 27e-4
    assert pmd_of_pair(identity.vertices, truth) > 10 * error


@pytest.mark.parametrize("cloud", [False, True])
def test_permuting_either_input_changes_no_bit(cloud):
    identity, driving = person(0, pose=3), person(1, pose=1)
    if cloud:
        driving = dataclasses.replace(driving, faces=EMPTY)
    rng = np.random.default_rng(0)
    order, other = rng.permutation(len(identity.vertices)), rng.permutation(len(driving.vertices))
    shuffled = permute_vertices(identity, order)
    shuffled = dataclasses.replace(shuffled, faces=rng.permutation(shuffled.faces))
    theirs = permute_vertices(driving, other)
    theirs = dataclasses.replace(theirs, faces=rng.permutation(theirs.faces))
    expected = moved(identity, driving)[0] if cloud else example()
    assert np.array_equal(moved(shuffled, theirs)[0], expected[order])
