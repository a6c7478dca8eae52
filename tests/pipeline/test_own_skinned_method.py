"""A method with joints that this package does not know gets --skinned, --root, --ground and --smooth all the same."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from people import person, walk

from mimesh.core.canonical_order import canonical_order
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import Rig
from mimesh.core.skinning import SkinnedMesh
from mimesh.methods.base import SkinnedDrive
from mimesh.pipeline import animate, transfer

PARENTS = (-1, 0)


@dataclass(frozen=True)
class TwoJoints:
    """The lower half of the identity follows the driving's centre; the upper half also leans with its first vertex."""

    rough: ClassVar[bool] = False
    skinned: ClassVar[bool] = True
    name: str = "two-joints"

    def prepare(self, identity: Mesh, driving: Clip) -> SkinnedDrive:
        ranked = canonical_order(identity.vertices)
        upper = (identity.vertices[:, 1] > 0).astype(float)
        joints = np.array([[0.0, -0.5, 0.0], [0.0, 0.0, 0.0]])
        rig = Rig(np.tile(np.eye(3), (2, 1, 1)), joints, np.stack([1 - upper, upper], axis=1))
        points = ranked.merge(identity.vertices)
        above = (points[:, 1] > 0).astype(float)
        merged = Rig(rig.rotation, joints, np.stack([1 - above, above], axis=1))
        return SkinnedDrive(
            ("root", "top"), rig, SkinnedMesh.of(points, merged, PARENTS), lean, 1.0, None, ranked.group, "walk"
        )


def lean(vertices):
    angle = vertices[0, 0]
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    centre = vertices.mean(axis=0)
    return np.stack([np.eye(3), turn]), np.stack([centre, centre])


@dataclass(frozen=True)
class SixJoints(TwoJoints):
    """Six joints in a row, all of which move every vertex."""

    def prepare(self, identity: Mesh, driving: Clip) -> SkinnedDrive:
        ranked = canonical_order(identity.vertices)
        points = ranked.merge(identity.vertices)
        joints = np.linspace([0.0, -0.9, 0.0], [0.0, 0.9, 0.0], 6)
        weights = 1 / (0.1 + np.linalg.norm(points[:, None] - joints, axis=2))
        rig = Rig(np.tile(np.eye(3), (6, 1, 1)), joints, weights / weights.sum(axis=1, keepdims=True))
        parents = tuple(range(-1, 5))

        def follow(vertices):
            turns, centres = lean(vertices)
            return turns[[0, 1, 0, 1, 0, 1]], centres[[0, 1, 0, 1, 0, 1]]

        names = tuple(f"j{j}" for j in range(6))
        whole = replace(rig, weights=rig.weights[ranked.group])
        return SkinnedDrive(names, whole, SkinnedMesh.of(points, rig, parents), follow, 1.0, None, ranked.group, "walk")


@pytest.mark.parametrize("skinned", [True, None])
def test_skinned_frames_are_those_of_the_file(skinned, tmp_path):
    limited, whole = (animate(person(0), walk(frames=3), SixJoints(), skinned=value) for value in (skinned, False))
    assert ((limited.skeleton.rig.weights > 0).sum(axis=1) == 4).all()
    limited.save_skinned(tmp_path / "limited.glb")
    whole.save_skinned(tmp_path / "whole.glb")
    assert limited.report["skinned_deviation"] < 1e-5
    assert limited.report["influence_deviation"] == pytest.approx(whole.report["skinned_deviation"], rel=1e-3)
    assert whole.report["skinned_deviation"] > 1e-4
    assert "influence_deviation" not in whole.report


def test_a_pose_keeps_all_weights_unless_it_becomes_skinned():
    pose = Clip.still(person(1, pose=0))
    assert "influence_deviation" not in animate(person(0), pose, SixJoints(), skinned=None).report
    assert "influence_deviation" in animate(person(0), pose, SixJoints(), skinned=True).report


def test_its_result_has_joints_and_is_saved_skinned(tmp_path):
    result = animate(person(0), walk(frames=3), TwoJoints(), skinned=True, smooth=0.1)
    assert result.skeleton is not None
    assert result.skeleton.names == ("root", "top")
    assert result.save_skinned(tmp_path / "leaning.glb").stat().st_size > 0
    assert result.report["skinned_deviation"] < 1e-5


@pytest.mark.parametrize(("root", "moves"), [("scale", True), ("keep", True), ("drop", False)])
def test_its_root_goes_as_asked(root, moves):
    path = animate(person(0), walk(frames=3), TwoJoints(), root=root, ground=True).skeleton.root
    assert (np.ptp(path[:, [0, 2]], axis=0).max() > 0.01) == moves


def test_its_report_has_no_confidence():
    report = transfer(person(0), person(1), TwoJoints()).report
    assert "weight_entropy" not in report["identity"]
