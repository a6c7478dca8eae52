"""Folders of registered meshes: who is in which pose, by the names of files."""

import pytest

from mimesh.core.errors import InputError
from mimesh.learn.data.registered import find_layout


def found(folder, names, pattern=""):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    layout = find_layout(folder, pattern)
    return layout, {who: path.relative_to(folder).as_posix() for who, path in layout.entries.items()}


def test_public_data_of_npt(tmp_path):
    layout, entries = found(tmp_path, ["id0_10.obj", "id0_9.obj", "id12_9.obj", "id2_9.obj", "identity_1.obj", "x.txt"])
    assert list(entries) == [("0", "9"), ("0", "10"), ("2", "9"), ("12", "9")]
    assert layout.ignored == 1


def test_faust_has_ten_poses_of_each_person(tmp_path):
    _, entries = found(tmp_path, [f"tr_reg_{n:03d}.ply" for n in (0, 7, 23, 99)])
    assert list(entries) == [("00", "0"), ("00", "7"), ("02", "3"), ("09", "9")]


def test_a_folder_a_person_with_files_or_folders_of_frames(tmp_path):
    names = ["anna/walk/0001.obj", "anna/walk/0002.obj", "anna/run.npz", "bob/walk.pc2", "bob/walk.obj", ".x/a.obj"]
    layout, entries = found(tmp_path, names)
    assert entries == {("anna", "run"): "anna/run.npz", ("anna", "walk"): "anna/walk", ("bob", "walk"): "bob/walk.pc2"}
    assert layout.ignored == 0


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("{person}-{pose}.ply", "a b-7.ply"),
        ("{person}-{pose}", "a b-7.ply"),
        ("{person}-{motion}", "a b-7.ply"),
        ("scans/{pose}/{person:3}_x", "scans/7/a b_x.obj"),
    ],
)
def test_a_pattern_gives_other_names(tmp_path, pattern, name):
    layout, entries = found(tmp_path, [name, "other.obj"], pattern)
    assert entries == {("a b", "7"): name}
    assert (layout.pattern, layout.ignored) == (pattern, 1)


@pytest.mark.parametrize("pattern", ["{person}.ply", "{pose}{pose}", "{person}-{pose}-{what}", "mesh.ply"])
def test_a_pattern_needs_a_person_and_a_pose(tmp_path, pattern):
    with pytest.raises(InputError, match=r"one \{person\} and one \{pose\}"):
        find_layout(tmp_path, pattern)


def test_names_that_say_nothing_are_refused_with_what_is_expected(tmp_path):
    with pytest.raises(InputError, match=r"id\{person\}_\{pose\}, .*found 1 files, none named so; .*--pattern"):
        found(tmp_path, ["mesh.obj"])
    with pytest.raises(InputError, match="expected a folder of registered meshes, found none"):
        find_layout(tmp_path / "lost")


def test_two_files_of_one_person_in_one_pose_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"id0_1\.ply: expected one file of person 0 in pose 1, found id0_1\.obj too"):
        found(tmp_path, ["id0_1.obj", "id0_1.ply"])
