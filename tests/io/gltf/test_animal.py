"""Animals of glTF files: the same rig as was written, whatever it faces, and clips that pose it."""

import numpy as np
import pytest
from animals import FEET, animal, bones, random_turns
from rigs import character
from scipy.spatial.transform import Rotation

from mimesh.core.errors import InputError
from mimesh.io import load_mesh
from mimesh.io.gltf.character import read_rigged_animal
from mimesh.io.gltf.own_rig import read_own_rig


def frames(made, count: int = 3):
    return [(random_turns(t, made.order, 15), np.array([0.0, 0.05 * t, 0.1 * t])) for t in range(count)]


@pytest.mark.parametrize("detached", [(), FEET])
def test_an_animal_is_read_with_its_joints_and_clips(detached, tmp_path):
    made = animal(0, bones(4), detached)
    motion = frames(made)
    found = read_rigged_animal(made.write(tmp_path / "cow.glb", {"go": motion}), "pack")
    assert (found.meta.body_class, found.meta.facing, found.meta.pack) == ("quadruped", "+z", "pack")
    assert list(found.clips) == ["go"]
    for name in ("LeftForearm", "RightShin", "LeftToes", "Neck1", "Head", "Tail3"):
        np.testing.assert_allclose(found.rig.joints[found.joints[name]], made.joints[made.order.index(name)], atol=1e-5)
    for t, frame in enumerate(motion):
        posed = found.rig.skinned(found.clip_transforms("go", t))
        np.testing.assert_allclose(posed, made.posed(*frame), atol=2e-3)


@pytest.mark.parametrize(("degrees", "facing"), [(180, "-z"), (90, "+x"), (-90, "-x")])
def test_an_animal_is_turned_to_face_z(degrees, facing, tmp_path):
    made = animal(0)
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    straight = read_rigged_animal(made.write(tmp_path / "a.glb", {"go": frames(made)}))
    turned = read_rigged_animal(made.write(tmp_path / "b.glb", {"go": frames(made)}, turn=turn))
    assert turned.meta.facing == facing
    assert turned.joints == straight.joints
    np.testing.assert_allclose(turned.rig.joints, straight.rig.joints, atol=1e-5)
    np.testing.assert_allclose(turned.rig.mesh.vertices, straight.rig.mesh.vertices, atol=1e-5)
    for t in range(3):
        one, other = (read.rig.skinned(read.clip_transforms("go", t)) for read in (straight, turned))
        np.testing.assert_allclose(other, one, atol=2e-3)
    own = read_own_rig(load_mesh(tmp_path / "b.glb"), body="quadruped").humanoid
    np.testing.assert_allclose(own.turn @ turn, np.eye(3), atol=1e-6)


def test_clips_can_be_left_out(tmp_path):
    made = animal(0)
    path = made.write(tmp_path / "a.glb", {"go": frames(made), "stay": frames(made)})
    assert list(read_rigged_animal(path, left_out=lambda name: name == "go").clips) == ["stay"]


def test_people_and_meshes_without_joints_are_refused(tmp_path):
    with pytest.raises(InputError, match="expected"):
        read_rigged_animal(character(tmp_path / "man.glb"))
    with pytest.raises(InputError, match="expected a skin, found none"):
        read_own_rig(animal(0).mesh, body="quadruped")


def test_a_person_and_an_animal_are_no_rigs_of_the_other_body(tmp_path):
    with pytest.raises(InputError, match=r"cow\.glb: expected a thigh and an upper arm"):
        read_own_rig(load_mesh(animal(0).write(tmp_path / "cow.glb")))
    with pytest.raises(InputError, match=r"man\.glb: expected"):
        read_own_rig(load_mesh(character(tmp_path / "man.glb")), body="quadruped")
