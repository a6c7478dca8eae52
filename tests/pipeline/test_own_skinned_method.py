"""A method with joints that this package does not know gets --skinned, --root, --ground and --smooth all the same."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from people import person, walk

from mimesh.core.canonical_order import canonical_order
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import Rig
from mimesh.core.skinning import SkinnedMesh
from mimesh.methods.base import Method, SkinnedDrive, SkinnedMethod
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


def test_it_is_a_skinned_method():
    assert isinstance(TwoJoints(), Method)
    assert isinstance(TwoJoints(), SkinnedMethod)


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
    assert "undecided" not in report["identity"]
