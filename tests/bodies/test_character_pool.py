"""Characters of a pool are posed as their files say, and limbs are found whatever the skeleton looks like."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from foreign_names import renamed
from pools import BLOCKS, blocks, write_character

from mimesh.bodies import load_body
from mimesh.bodies.character_pool import PoolCharacter, read_character, read_pool, transferred_transforms
from mimesh.core.errors import InputError

SIDED = ("Arm", "ForeArm", "UpLeg", "Leg")
WITHOUT_BLOCKS = [name for name in load_body().joint_names if name not in BLOCKS]
HANDS = [name for name in load_body().joint_names if "Hand" in name or "Finger" in name or "Thumb" in name]
FEET = ("LeftFoot", "RightFoot")


def unmoved(character: PoolCharacter) -> np.ndarray:
    return np.tile(np.eye(4), (len(character.rig.parents) + 1, 1, 1))


@pytest.mark.parametrize("options", [{}, {"on_root": FEET}, {"without": WITHOUT_BLOCKS, "spell": blocks}])
def test_characters_are_posed_as_their_files_say(options, tmp_path):
    made = write_character(tmp_path, "a", **options)
    character = read_character(tmp_path / "a.npz")
    np.testing.assert_allclose(character.rig.skinned(unmoved(character)), made.vertices, atol=1e-6)
    for t, posed in enumerate(made.posed):
        np.testing.assert_allclose(character.rig.skinned(character.clip_transforms("dance", t)), posed, atol=1e-5)


@pytest.mark.parametrize("scheme", ["mixamo", "quaternius", "unreal"])
def test_limbs_reach_from_joint_to_joint(scheme, tmp_path):
    made = write_character(tmp_path, "a", spell=renamed(scheme), clip=False)
    limbs = read_character(tmp_path / "a.npz").limbs
    assert set(limbs) == {f"{side}{part}" for side in ("Left", "Right") for part in SIDED} | {"Trunk", "Head"}
    for part, tail in zip(SIDED, ("ForeArm", "Hand", "Leg", "Foot"), strict=True):
        np.testing.assert_allclose(limbs[f"Left{part}"].start, made.joints[f"Left{part}"], atol=1e-6)
        np.testing.assert_allclose(limbs[f"Left{part}"].end, made.joints[f"Left{tail}"], atol=1e-6)
    np.testing.assert_allclose(limbs["Trunk"].end, made.joints["Neck"], atol=1e-6)
    np.testing.assert_allclose(
        limbs["Trunk"].start, (made.joints["LeftUpLeg"] + made.joints["RightUpLeg"]) / 2, atol=1e-6
    )
    assert limbs["Head"].end[1] == pytest.approx(made.vertices[:, 1].max(), abs=1e-6)


def test_feet_on_the_root_become_children_of_the_shin_that_they_move_with(tmp_path):
    """The names of the feet are swapped, so only the clip tells."""
    swapped = {"LeftFoot": "RightFoot", "RightFoot": "LeftFoot"}
    write_character(tmp_path, "a", on_root=FEET)
    write_character(tmp_path, "b", on_root=FEET, spell=lambda name: swapped.get(name, name))
    write_character(tmp_path, "c", on_root=FEET, clip=False)
    for file, shin in (("a", "LeftLeg"), ("b", "RightLeg"), ("c", "LeftLeg")):
        character = read_character(tmp_path / f"{file}.npz")
        foot = character.rig.joint_names.index("LeftFoot")
        assert character.rig.joint_names[character.rig.parents[foot]] == shin
        assert all(parent < j for j, parent in enumerate(character.rig.parents))


def test_feet_that_move_with_no_shin_or_hold_one_are_refused(tmp_path):
    write_character(tmp_path, "a", on_root=FEET)
    arrays = dict(np.load(tmp_path / "_clips_a.npz"))
    arrays["clip0_translations"][:, -1] += np.linspace(0, 1, len(arrays["clip0_translations"]))[:, None]
    np.savez(tmp_path / "_clips_a.npz", **arrays)
    swapped = {"LeftFoot": "LeftLeg", "LeftLeg": "LeftFoot"}
    write_character(tmp_path, "b", spell=lambda name: swapped.get(name, name), clip=False)
    for name, message in (("a", "foot that moves with neither"), ("b", "foot that holds its shin")):
        with pytest.raises(InputError, match=message):
            read_character(tmp_path / f"{name}.npz")


def test_joints_in_any_order_keep_their_clips(tmp_path):
    """A foot that precedes its shin in the file comes after it in the rig."""
    made = write_character(tmp_path, "a", on_root=FEET)
    for path in (tmp_path / "a.npz", tmp_path / "_clips_a.npz"):
        move_last_to_front(path, made, "RightFoot")
    character = read_character(tmp_path / "a.npz")
    assert all(parent < j for j, parent in enumerate(character.rig.parents))
    np.testing.assert_allclose(character.rig.skinned(character.clip_transforms("dance", 2)), made.posed[2], atol=1e-5)
    assert character.rig.joint_names[character.joints["RightLeg"]] == "RightLeg"


def move_last_to_front(path: Path, made, name: str) -> None:
    """Reorder the joints of a file so that one comes right after the root."""
    arrays = dict(np.load(path))
    old = arrays["joint_names"].tolist().index(name)
    order = np.array([0, old, *(j for j in range(1, len(arrays["joint_names"])) if j != old)])
    rank = np.argsort(order)
    parents = arrays["parents"][order]
    arrays["parents"] = np.where(parents < 0, -1, rank[parents]).astype("i2")
    arrays["joint_names"] = arrays["joint_names"][order]
    if "rest_matrices" in arrays:
        arrays["rest_matrices"] = arrays["rest_matrices"][order]
        arrays["weight_joints"] = rank[arrays["weight_joints"]].astype("i2")
    else:
        arrays["clip0_rotations"] = arrays["clip0_rotations"][:, order]
        arrays["clip_translated"] = rank[arrays["clip_translated"]].astype("i2")
    np.savez(path, **arrays)


def test_without_hands_the_forearm_ends_where_its_weights_end_or_fingers_begin(tmp_path):
    made = write_character(tmp_path, "a", without=HANDS, clip=False)
    character = read_character(tmp_path / "a.npz")
    assert "LeftHand" not in character.joints
    end = character.limbs["LeftForeArm"].end
    assert made.vertices[:, 0].max() - 0.12 < end[0] < made.vertices[:, 0].max()
    assert np.abs(end - made.joints["LeftForeArm"])[1:].max() < 0.08
    made = write_character(tmp_path, "b", without=("LeftHand", "RightHand"), clip=False)
    fingers = [made.joints[name] for name in ("LeftFingerBase", "LThumb")]
    end = read_character(tmp_path / "b.npz").limbs["LeftForeArm"].end
    np.testing.assert_allclose(end, np.mean(fingers, axis=0), atol=1e-6)


def test_figures_of_blocks_have_whole_limbs(tmp_path):
    made = write_character(tmp_path, "a", without=WITHOUT_BLOCKS, spell=blocks)
    character = read_character(tmp_path / "a.npz")
    assert set(character.limbs) == {"LeftArm", "RightArm", "LeftUpLeg", "RightUpLeg", "Trunk", "Head"}
    arm, leg = character.limbs["LeftArm"], character.limbs["LeftUpLeg"]
    assert arm.end[0] > made.joints["LeftArm"][0] + 0.4
    assert arm.start[0] < arm.end[0]
    assert leg.end[1] < made.vertices[:, 1].min() + 0.25
    direction = (leg.end - leg.start) / np.linalg.norm(leg.end - leg.start)
    assert direction[1] < -0.95


def test_trunks_of_blocks_are_carried_by_a_joint_with_weights(tmp_path):
    """The root of such a figure moves it, and may stay where it is when the trunk turns."""
    write_character(tmp_path, "a", without=WITHOUT_BLOCKS, spell=blocks, clip=False)
    arrays = dict(np.load(tmp_path / "a.npz"))
    arrays["weight_joints"][arrays["weight_joints"] == 0] = arrays["joint_names"].tolist().index("torso")
    np.savez(tmp_path / "a.npz", **arrays)
    character = read_character(tmp_path / "a.npz")
    assert character.rig.joint_names[character.limbs["Trunk"].joint] == "torso"


@pytest.mark.parametrize(("facing", "angle"), [("-z", 180), ("+x", 90), ("-x", -90)])
def test_characters_are_turned_to_the_front(facing, angle, tmp_path):
    angle = np.radians(angle)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    made = write_character(tmp_path, "a", turn=turn, facing=facing)
    character = read_character(tmp_path / "a.npz")
    np.testing.assert_allclose(character.rig.mesh.vertices, made.vertices, atol=1e-6)
    np.testing.assert_allclose(character.limbs["LeftArm"].start, made.joints["LeftArm"], atol=1e-6)
    np.testing.assert_allclose(character.rig.skinned(character.clip_transforms("dance", 1)), made.posed[1], atol=1e-5)


def test_sides_are_those_of_the_figure(tmp_path):
    """Some makers name sides as seen by the viewer."""
    made = write_character(
        tmp_path, "a", spell=lambda n: n.replace("Left", "R@").replace("Right", "Left").replace("R@", "Right")
    )
    limbs = read_character(tmp_path / "a.npz").limbs
    np.testing.assert_allclose(limbs["LeftLeg"].start, made.joints["LeftLeg"], atol=1e-6)


def test_bone_rotations_of_a_larger_twin_give_the_same_pose_and_of_another_shape_are_the_same(tmp_path):
    for name, options in (("a", {}), ("b", {"size": 2.0}), ("c", {"shape": 3})):
        write_character(tmp_path, name, on_root=FEET, **options)
    small, large, other = (read_character(tmp_path / f"{file}.npz") for file in "abc")
    transforms = large.clip_transforms("dance", 3)
    moved = transferred_transforms(large.rig, small.rig, transforms, small.leg / large.leg)
    np.testing.assert_allclose(2 * small.rig.skinned(moved), large.rig.skinned(transforms), atol=1e-5)
    transforms = small.clip_transforms("dance", 3)
    moved = transferred_transforms(small.rig, other.rig, transforms, 1.0)
    np.testing.assert_allclose(moved[:, :3, :3], transforms[:, :3, :3], atol=1e-5)
    assert np.abs(moved - transforms).max() > 1e-3


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """A folder with a sound character, whose feet are on the root."""
    folder = tmp_path_factory.mktemp("sound")
    write_character(folder, "a", on_root=FEET)
    return folder


def changed(sound: Path, folder: Path, file: str, **arrays) -> None:
    """Copy the sound character with some arrays of a file changed."""
    shutil.copytree(sound, folder, dirs_exist_ok=True)
    given = dict(np.load(sound / file))
    with np.errstate(invalid="ignore"):
        np.savez(folder / file, **given | {name: value(given[name]) for name, value in arrays.items()})


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("weights", lambda a: np.full_like(a, np.nan), "vertices without"),
        ("weights", lambda a: a * 0, "vertices without"),
        ("weights", lambda a: a[:, 0], "found float32"),
        ("weight_joints", lambda a: a + 1000, "found others"),
        ("weight_joints", lambda a: a - 1000, "found others"),
        ("parents", lambda a: a[::-1], "found another order"),
        ("parents", lambda a: a[1:], "found other counts"),
        ("rest_matrices", lambda a: 2 * a, "found others"),
        ("rest_matrices", lambda a: np.full_like(a, np.inf), "found others"),
        ("faces", lambda a: a + 10**6, "face"),
        ("vertices", lambda a: a * np.nan, "finite"),
        ("joint_names", lambda a: np.array(["x"] * len(a)), "found none for LeftUpLeg"),
        ("meta", lambda a: "{", "meta in JSON"),
        ("meta", lambda a: "[" * 100_000, "meta in JSON"),
        ("meta", lambda a: json.dumps({"class": "quadruped"}), "found quadruped"),
        ("meta", lambda a: json.dumps({"class": "humanoid", "facing": "up"}), "found up"),
        ("meta", lambda a: json.dumps({"class": "humanoid", "clips_from": "../a.npz"}), "same folder"),
        ("meta", lambda a: json.dumps({"class": "humanoid", "clips_from": "none.npz"}), "found none"),
    ],
)
def test_damaged_files_are_refused(name, value, found, sound, tmp_path):
    changed(sound, tmp_path, "a.npz", **{name: value})
    if name == "joint_names":
        changed(sound, tmp_path / "clips", "_clips_a.npz", **{name: value})
        shutil.copy(tmp_path / "clips" / "_clips_a.npz", tmp_path)
    with pytest.raises(InputError, match=found):
        read_character(tmp_path / "a.npz")


def test_other_members_of_a_file_are_not_read(tmp_path):
    write_character(tmp_path, "a")
    for file in ("a.npz", "_clips_a.npz"):
        with zipfile.ZipFile(tmp_path / file, "a") as archive:
            for member in ("README.txt", "vertices", "thumbnail.npy", "part.npy"):
                archive.writestr(member, "no array")
    assert list(read_character(tmp_path / "a.npz").clips) == ["dance"]


def test_pickles_are_not_read(sound, tmp_path):
    changed(sound, tmp_path, "a.npz", joint_names=lambda _: np.array([Path("x"), None], dtype=object))
    with pytest.raises(InputError, match="plain arrays"):
        read_character(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, lambda a: a[:, None]) for name in ("clip0_rotations", "clip_translated", "joint_names")),
        ("clip0_translations", lambda a: a[:1]),
        ("clip0_translations", lambda a: a[0, 0]),
        ("clip0_translations", lambda a: a[:, :1]),
        ("clip_translated", lambda a: a - 1),
        ("clip_translated", lambda a: a + 1000),
        ("clip0_rotations", lambda a: a[:, :1]),
        ("clip0_rotations", lambda a: a[0]),
        ("clip0_rotations", lambda a: a[..., :3]),
    ],
)
def test_clips_of_other_shapes_are_refused(name, value, sound, tmp_path):
    """NumPy would repeat a single row, and count negative joints from the end."""
    assert len(np.load(sound / "_clips_a.npz")["clip_translated"]) > 1
    changed(sound, tmp_path, "_clips_a.npz", **{name: value})
    with pytest.raises(InputError, match=r"a\.npz: expected clips of the"):
        read_character(tmp_path / "a.npz")


def test_files_of_another_split_than_the_index_says_are_refused(tmp_path):
    write_character(tmp_path, "a")
    write_character(tmp_path, "b", split="test")
    index = tmp_path / "index.json"
    index.write_text(index.read_text().replace('"test"', '"val"'))
    pool = read_pool(tmp_path, "val")
    assert [character.meta.file for character in pool.characters] == ["a"]
    assert list(pool.refused) == ["b"]
    assert "expected the split val of the index in its meta, found test" in pool.refused["b"]


@pytest.mark.parametrize("changes", [{}, {"split": "test"}, {"class": "other"}])
def test_files_that_an_index_names_twice_are_refused(changes, tmp_path):
    write_character(tmp_path, "a")
    write_character(tmp_path, "b")
    index = tmp_path / "index.json"
    rows = json.loads(index.read_text())
    index.write_text(json.dumps([*rows, rows[0] | changes]))
    pool = read_pool(tmp_path, "val")
    assert [character.meta.file for character in pool.characters] == ["b"]
    assert list(pool.refusals().values()) == [1]
    assert "found it 2 times" in pool.refused["a"]


def test_pools_count_what_they_refuse(tmp_path):
    write_character(tmp_path, "a")
    write_character(tmp_path, "b", split="test")
    write_character(tmp_path, "cow", **{"class": "quadruped"})
    for file in ("c", "d"):
        write_character(tmp_path, file, spell=lambda name: f"bone_{len(name)}")
    pool = read_pool(tmp_path, "val")
    assert [character.meta.file for character in pool.characters] == ["a"]
    assert list(pool.refused) == ["c", "d"]
    assert pool.refusals() == {f"c, d: {pool.refused['c']}": 2}
    assert [character.meta.maker for character in read_pool(tmp_path, "test").characters] == ["we"]


@pytest.mark.parametrize(
    "content", [None, "{", "[1]", "[" * 100_000, '[{"file": [], "class": "", "split": ""}]', '[{"file": "a"}]']
)
def test_folders_without_an_index_are_refused(content, tmp_path):
    if content is not None:
        (tmp_path / "index.json").write_text(content)
    with pytest.raises(InputError, match=str(tmp_path)):
        read_pool(tmp_path, "val")


def test_names_that_lead_out_of_the_folder_are_refused(tmp_path):
    (tmp_path / "index.json").write_text(json.dumps([{"file": "../a", "class": "humanoid", "split": "val"}]))
    with pytest.raises(InputError, match="same folder"):
        read_pool(tmp_path, "val")
