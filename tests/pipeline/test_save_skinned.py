"""Several results in one skinned file: names, rates, fingers that only some of them have."""

import copy
import dataclasses

import numpy as np
import pytest
from networks import write_mime_network
from people import person, walk
from scipy.spatial.transform import Rotation

import mimesh
from mimesh.bodies.joint_names import finger_joints
from mimesh.core.animated_rig import AnimatedRig
from mimesh.core.errors import InputError
from mimesh.core.rig import Rig
from mimesh.core.skinning import SkinnedMesh
from mimesh.io import load_clip
from mimesh.pipeline.skinned import distinct_names, on_common_rig

pytest.importorskip("onnx")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    network = str(write_mime_network(tmp_path_factory.mktemp("networks") / "mime.onnx"))
    clips = (walk(faces=600), dataclasses.replace(walk(2, frames=6, faces=600), fps=12.0))
    return [mimesh.animate(person(0), clip, network, motion=mimesh.MotionOptions(skinned=True)) for clip in clips]


def test_each_result_becomes_an_animation(results, tmp_path):
    before = copy.deepcopy([result.report for result in results])
    saved = mimesh.save_skinned(results, tmp_path / "hero.glb", animations=["walk", "run"])
    assert saved == tmp_path / "hero.glb"
    assert [result.report for result in results] == before, "frozen"
    for name, result, deviations in zip(("walk", "run"), results, saved.deviations, strict=True):
        clip = load_clip(saved, animation=name)
        assert (len(clip), clip.fps) == (len(result.clip), result.fps)
        assert np.allclose(clip.vertices, result.clip.vertices, atol=1e-4)
        assert deviations["skinned_deviation"] < 1e-4


def test_animations_have_the_names_of_their_driving_clips(results, tmp_path):
    saved = mimesh.save_skinned([results[0], results[0]], tmp_path / "hero.glb")
    name = results[0].driving.mesh.name
    assert mimesh.load_mesh(saved).source.animations == (name, f"{name}-2")
    assert distinct_names(["a", "b", "a", "a-2", "a"]) == ["a", "b", "a-2", "a-2-2", "a-3"]


def test_results_of_other_identities_and_wrong_names_are_refused(results, tmp_path):
    other = dataclasses.replace(results[1], skeleton=dataclasses.replace(results[1].skeleton, mesh=person(3)))
    for given, names, reason in (
        ([results[0], other], None, "expected results of one identity"),
        (results, ["walk"], "expected a name for each of 2 results, found 1"),
        ([], None, "expected results of animate to save, found none"),
    ):
        with pytest.raises(InputError, match=reason):
            mimesh.save_skinned(given, tmp_path / "hero.glb", animations=names)


def hands(fingered, seed):
    """A motion of a rig with two hands, of which some have their fifteen finger joints."""
    rng = np.random.default_rng(0)
    mesh = person(0)
    names, parents = ["Hips", "LeftHand", "LeftStub", "RightHand", "RightStub"], [-1, 0, 1, 0, 3]
    joints = [rng.normal(size=(5, 3))]
    side_of = np.sign(mesh.vertices[:, 0]) * (np.abs(mesh.vertices[:, 0]) > 0.5)
    weights = np.zeros((len(mesh.vertices), 5))
    weights[:, 0] = 1.0
    for side, sign, hand in (("Left", 1, 1), ("Right", -1, 3)):
        of_fingers, at = rng.dirichlet(np.ones(16), len(mesh.vertices)), rng.normal(size=(15, 3))
        weights = np.pad(weights, ((0, 0), (0, 15 if side in fingered else 0)))
        rows = side_of == sign
        weights[rows] = 0.0
        if side in fingered:
            weights[rows, hand], weights[rows, -15:] = of_fingers[rows, 0], of_fingers[rows, 1:]
            parents += [hand if k % 3 == 0 else len(names) + k - 1 for k in range(15)]
            names += finger_joints(side)
            joints.append(at)
        else:
            weights[np.ix_(rows, [hand, hand + 1])] = 0.5
    count, motion = len(names), np.random.default_rng(seed)
    rig = Rig(Rotation.random(count, motion).as_matrix(), np.concatenate(joints), weights)
    rotation = Rotation.random(3 * count, motion).as_matrix().reshape(3, count, 3, 3)
    return AnimatedRig(mesh, tuple(names), tuple(parents), rig, rotation, motion.normal(size=(3, 3)))


def frames_of(skeleton):
    skinned = SkinnedMesh.of(skeleton.mesh.vertices, skeleton.rig, skeleton.parents)
    return np.stack([skinned.posed(*pose) for pose in zip(skeleton.rotation, skeleton.root, strict=True)])


@pytest.mark.parametrize("fingered", [["Left", ""], ["", "Left"], ["Left", "Right"], ["LeftRight", "Right", ""]])
def test_fingers_of_all_motions_are_on_the_common_rig(fingered):
    motions = [
        hands([side for side in ("Left", "Right") if side in sides], seed) for seed, sides in enumerate(fingered)
    ]
    common = on_common_rig(motions)
    sides = {side for side in ("Left", "Right") if side in "".join(fingered)}
    for moved, before, own in zip(common, motions, fingered, strict=True):
        assert moved.names == common[0].names
        assert moved.rig is common[0].rig
        assert np.allclose(moved.rig.weights.sum(axis=1), 1)
        # Vertices move as before, but for hands that have fingers in another motion only.
        x = before.mesh.vertices[:, 0]
        same = np.ones(len(x), bool)
        for side, sign in (("Left", 1), ("Right", -1)):
            if side in sides and side not in own:
                same &= sign * x <= 0.5
        assert same.sum() > 100
        assert np.abs(frames_of(moved) - frames_of(before))[:, same].max() < 1e-5
        if "Left" in sides and "Left" not in own:
            hand, finger = (moved.names.index(name) for name in ("LeftHand", "LeftHandPinky3"))
            since_rest = moved.rotation @ moved.rig.rotation.swapaxes(-1, -2)
            assert np.allclose(since_rest[:, hand], since_rest[:, finger])
