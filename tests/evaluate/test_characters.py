"""Pairs of a pool: within one skeleton the truth has the bone rotations of the driving; across, limbs agree."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from matrix import matrix
from pools import BLOCKS, blocks, write_character

from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import Limb
from mimesh.bodies.character_pool import PoolCharacter, read_pool, transferred_transforms
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose
from mimesh.core.errors import InputError
from mimesh.evaluate.characters import (
    Characters,
    body_pose,
    characters,
    cross_body,
    find_character_landmarks,
    pose_character,
)
from mimesh.evaluate.generate import generate_command
from mimesh.evaluate.markdown import kind_table, markdown, summary
from mimesh.evaluate.measure import Output, measure
from mimesh.evaluate.run import evaluate_command, find_protocol

WITHIN = ("table6", "limits", "clips")
ACROSS = tuple(f"across-{kind}" for kind in WITHIN)
HANDS = [name for name in load_body().joint_names if "Hand" in name or "Finger" in name or "Thumb" in name]
WITHOUT_BLOCKS = [name for name in load_body().joint_names if name not in BLOCKS]
FEET = ("LeftFoot", "RightFoot")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Three packs: people, one of them without clips; figures without hands and with loose feet; one of blocks."""
    folder = tmp_path_factory.mktemp("pool")
    for i in range(3):
        write_character(folder, f"man{i}", i, size=1 + i / 2, pack="people", clip=i < 2)
    for i in range(2):
        options = {"without": HANDS, "on_root": FEET, "spell": renamed("mixamo"), "frames": 4}
        write_character(folder, f"elf{i}", 3 + i, pack="elves", maker="others", **options)
    write_character(folder, "block", 6, pack="blocks", without=WITHOUT_BLOCKS, spell=blocks)
    write_character(folder, "broken", 7, spell=lambda name: f"bone{len(name)}")
    write_character(folder, "alone", 8, split="test")
    return folder


@pytest.fixture(scope="module")
def protocol(folder) -> Characters:
    # The version seeds the draw: bounds on bent limbs were set on that of the first.
    return dataclasses.replace(characters(folder), version=1)


def direction(limb: Limb, transforms: np.ndarray) -> np.ndarray:
    vector = transforms[limb.joint, :3, :3] @ (limb.end - limb.start)
    return vector / np.linalg.norm(vector)


def limb_degrees(
    one: PoolCharacter, pose: np.ndarray, other: PoolCharacter, other_pose: np.ndarray
) -> dict[str, float]:
    """Angle between the directions of each limb that two characters have."""
    return {
        name: np.degrees(np.arccos(np.clip(direction(limb, pose) @ direction(other.limbs[name], other_pose), -1, 1)))
        for name, limb in one.limbs.items()
        if name in other.limbs and name not in ("Trunk", "Head")
    }


def drawn(protocol: Characters, kind: str, i: int) -> tuple[PoolCharacter, PoolCharacter]:
    return protocol.draw_characters("val", kind, i, protocol.rng("val", kind, i))


def limits(i: int) -> np.ndarray:
    return rotvec_to_rotmat(sample_pose(load_body(), 5, i, JOINT_LIMITS))


def test_limbs_have_the_directions_of_the_body(folder):
    body = load_body()
    for i, character in enumerate(read_pool(folder, "val").characters):
        rotation, translation = body.skinning_transforms(body.joints, limits(i))
        posed = np.einsum("jkl,jl->jk", rotation, body.joints) + translation
        transforms = pose_character(character, limits(i))
        tails = {"Arm": "ForeArm", "ForeArm": "Hand", "UpLeg": "Leg", "Leg": "Foot"}
        if "LeftForeArm" not in character.limbs:
            tails = {"Arm": "Hand", "UpLeg": "Foot"}
        for part, tail in tails.items():
            bone = posed[body.joint(f"Right{tail}")] - posed[body.joint(f"Right{part}")]
            found = direction(character.limbs[f"Right{part}"], transforms)
            np.testing.assert_allclose(found, bone / np.linalg.norm(bone), atol=1e-6)


def test_body_takes_back_the_pose_of_a_character(folder):
    for i, character in enumerate(read_pool(folder, "val").characters):
        transforms = pose_character(character, limits(i))
        again = pose_character(character, body_pose(character, transforms))
        assert max(limb_degrees(character, transforms, character, again).values()) < 1e-3


@matrix("kind", WITHIN, quick=["clips"])
def test_truth_is_the_identity_under_the_bone_rotations_of_the_driving(kind, protocol):
    """Checked against another pose, which must be far from the truth."""
    for i in range(4):
        pair = protocol.pair("val", kind, i)
        assert pair.truth_known
        one, other = pair.identity_character, pair.driving_character
        assert skeleton_of(one) == skeleton_of(other)
        size = one.limbs["Trunk"].start[1] - one.rig.mesh.vertices[:, 1].min()
        size /= other.limbs["Trunk"].start[1] - other.rig.mesh.vertices[:, 1].min()
        expected = one.rig.skinned(transferred_transforms(other.rig, one.rig, other.transforms, size))
        np.testing.assert_allclose(pair.truth, expected, atol=1e-9)
        posed = transferred_transforms(other.rig, one.rig, other.transforms, size) @ rest_frames(one)
        np.testing.assert_allclose(bone_rotations(posed, one), bone_rotations_of(other), atol=1e-6)
        foreign = protocol.pair("val", "limits" if kind == "table6" else "table6", i).driving_character
        if skeleton_of(foreign) == skeleton_of(one):
            wrong = transferred_transforms(foreign.rig, one.rig, foreign.transforms, 1.0) @ rest_frames(one)
            assert np.abs(bone_rotations(wrong, one) - bone_rotations_of(other)).max() > 0.1


def skeleton_of(posed) -> tuple:
    return posed.rig.joint_names, posed.rig.parents


def rest_frames(posed) -> np.ndarray:
    return np.concatenate([posed.rig.T_world_joint, np.eye(4)[None]])


def bone_rotations(frames: np.ndarray, posed) -> np.ndarray:
    parents = np.array(posed.rig.parents)[1:]
    return np.swapaxes(frames[parents, :3, :3], 1, 2) @ frames[1:-1, :3, :3]


def bone_rotations_of(posed) -> np.ndarray:
    return bone_rotations(posed.transforms @ rest_frames(posed), posed)


@matrix("kind", ACROSS, quick=["across-limits"])
def test_limbs_of_another_skeleton_stand_as_in_the_driving_mesh(kind, protocol):
    """The estimate is measured like a result: by the rotation of a limb's vertices."""
    for i in range(6):
        identity, driving = drawn(protocol, kind, i)
        pair = protocol.unshuffled_pair("val", kind, i, protocol.rng("val", kind, i))
        assert not pair.truth_known
        assert identity.meta.pack != driving.meta.pack
        assert identity.rig.skeleton != driving.rig.skeleton
        pose = pose_character(identity, body_pose(driving, pair.driving_character.transforms))
        np.testing.assert_allclose(pair.truth, identity.rig.skinned(pose), atol=1e-9)
        if len(identity.limbs) == len(driving.limbs):
            angles = limb_degrees(identity, pose, driving, pair.driving_character.transforms)
            assert max(angles.values()) < 1e-3
        for part in ("LeftArm", "RightUpLeg"):
            one, other = whole_limb(identity, pose, part), whole_limb(driving, pair.driving_character.transforms, part)
            # In a bent limb the direction depends on the lengths of both halves, which differ between characters.
            assert np.degrees(np.arccos(one @ other)) < 20


def whole_limb(character: PoolCharacter, transforms: np.ndarray, upper: str) -> np.ndarray:
    """Direction from a shoulder to the hand, or from a hip to the foot, in a pose."""
    lower = character.limbs.get(upper.replace("Arm", "ForeArm").replace("UpLeg", "Leg"), character.limbs[upper])
    points = ((character.limbs[upper].joint, character.limbs[upper].start), (lower.joint, lower.end))
    start, end = ((transforms[joint] @ [*point, 1.0])[:3] for joint, point in points)
    return (end - start) / np.linalg.norm(end - start)


def test_weights_are_shuffled_with_the_vertices(protocol):
    plain = protocol.unshuffled_pair("val", "table6", 1, protocol.rng("val", "table6", 1))
    pair = protocol.pair("val", "table6", 1)
    for name in ("identity", "driving"):
        mesh, posed = getattr(pair, name), getattr(pair, f"{name}_character")
        assert np.abs(mesh.vertices - getattr(plain, name).vertices).max() > 0.01
        np.testing.assert_allclose(posed.vertices, mesh.vertices, atol=1e-12)
        np.testing.assert_array_equal(posed.rig.mesh.faces, mesh.faces)


def test_landmarks_of_characters_are_those_of_the_body(folder):
    """The head's top and the soles' fronts are the extremes of the mesh."""
    for character in read_pool(folder, "val").characters:
        vertices = character.rig.mesh.vertices
        found = find_character_landmarks(character)
        assert len(found) == 13
        assert vertices[found[0], 1] > vertices[:, 1].max() - 0.12 * np.ptp(vertices[:, 1])
        assert vertices[found[5], 0] > 0 > vertices[found[6], 0]


def test_pools_without_pairs_are_refused(protocol, tmp_path):
    with pytest.raises(InputError, match=r"two characters of one skeleton.*1 of ours"):
        protocol.check("test")
    with pytest.raises(InputError, match=r"index\.json"):
        characters(tmp_path).check("val")
    with pytest.raises(InputError, match="--data"):
        find_protocol("characters")


def test_files_of_a_folder_that_share_a_skeleton_are_pairs(tmp_path):
    for name, kind in (("man0", "cmu"), ("man1", "cmu"), ("zed", "vroid")):
        rigs.character(tmp_path / f"{name}.glb", shape=len(name), name=renamed(kind))
    protocol = cross_body(tmp_path)
    protocol.check("test")
    pair = protocol.pair("test", "limits", 0)
    assert {label.rpartition(": ")[2] for label in pair.groups} == {"man0", "man1"}
    right, wrong = (measure(pair, method) for method in ("truth", "identity"))
    assert right["pmd_e4"] == 0 < 100 < wrong["pmd_e4"]
    assert right["limb_deg"] < 5 < wrong["limb_deg"]
    (tmp_path / "alone").mkdir()
    rigs.character(tmp_path / "alone" / "zed.glb", name=renamed("vroid"))
    with pytest.raises(InputError, match="two characters of one skeleton in the split test, found 1 of alone"):
        cross_body(tmp_path / "alone").check("test")


@pytest.mark.slow
def test_characters_are_evaluated(folder, tmp_path):
    """Within one skeleton by vertices and limbs, across skeletons by limbs alone; by maker; the worst are drawn."""
    options = {"split": "val", "pairs": 1, "data": folder}
    report = evaluate_command("characters", ["identity", "copy"], dump=tmp_path, **options)
    rows = {(row["method"], row["split"]): row for row in report["results"]}
    assert list(dict.fromkeys(kind for _, kind in rows)) == [*WITHIN, *ACROSS]
    for kind in (*WITHIN, *ACROSS):
        row = rows["identity", kind]
        assert row["limb_deg"] > 5
        assert ("pmd_e4" in row) == (kind in WITHIN)
        assert {name.split(": ")[0] for name in row["each"]["identity"]} <= {"we", "others"}
        assert (tmp_path / f"identity-{kind}-1.png").exists()
    assert sum(report["left_out"].values()) == 1
    text = markdown(report)
    assert "**`identity` by maker**" in text
    assert "| others, elves |" in text
    assert "Left out: 1 file " in text
    assert rows["copy", "across-limits"]["pairs"] == 0
    assert "Not applicable: `copy`" in text


@pytest.mark.slow
def test_characters_of_the_test_split_are_not_drawn(folder, tmp_path):
    for i in range(2):
        write_character(tmp_path, f"man{i}", i, split="test", pack="people")
    write_character(tmp_path, "elf", 3, split="test", pack="elves", without=HANDS, spell=renamed("mixamo"))
    with pytest.raises(InputError, match="--split val"):
        evaluate_command("characters", ["identity"], pairs=1, data=tmp_path, dump=tmp_path / "pictures")
    assert evaluate_command("characters", ["identity"], pairs=1, data=tmp_path)["sets"]["table6"]["frozen"] == "other"


def test_result_that_is_not_finite_is_counted_as_a_failure(protocol, monkeypatch):
    """A method must not improve its mean by failing."""
    pair = protocol.pair("val", "limits", 0)
    monkeypatch.setattr("mimesh.evaluate.measure.run_on", lambda pair, method: Output(pair.truth * np.nan))
    figures = measure(pair, "identity")
    assert set(figures) == {"failed"}
    good = {"pmd_e4": 1.0, "pmd_public_e4": 1.0, "mm": 1.0, "seconds": 1.0}
    row = summary("identity", "limits", [figures, good])
    assert (row["pairs"], row["failures"], "not_applicable" in row) == (1, 1, False)
    assert "| 1 of 2, 1 failed |" in kind_table([row])


def test_truth_has_no_error_and_the_unmoved_identity_has_one(protocol, monkeypatch):
    pair = protocol.pair("val", "limits", 0)
    monkeypatch.setattr("mimesh.evaluate.measure.run_on", lambda pair, method: Output(pair.truth))
    metrics = measure(pair, "any")
    assert metrics["pmd_e4"] == pytest.approx(0, abs=1e-9)
    assert metrics["limb_deg"] < 3
    assert metrics["end_effector"] < 0.1


@pytest.mark.slow
def test_estimates_are_not_written_as_true_results(folder, tmp_path):
    written = generate_command("characters", tmp_path, "val", pairs=2, data=folder)
    assert {path.name for path in tmp_path.iterdir()} == {
        *(f"val-{kind}" for kind in WITHIN),
        *(f"val-{kind}.txt" for kind in WITHIN),
        *(f"val-{kind}.heights.json" for kind in WITHIN),
    }
    assert written["files"] == 3 * (2 * 3 + 2)


def test_packs_take_turns(protocol):
    within = Counter(drawn(protocol, "table6", i)[0].meta.pack for i in range(12))
    assert within == {"people": 6, "elves": 6}
    across = Counter(tuple(c.meta.pack for c in drawn(protocol, "across-limits", i)) for i in range(12))
    assert len(across) == 6
    assert set(across.values()) == {2}
