"""Lists of files: lines, names, encodings and heights, as people write them."""

import json
import os

import pytest

from mimesh.core.errors import InputError
from mimesh.evaluate.listed_pairs import find_lists, read_heights, read_list, write_list


@pytest.fixture
def folder(tmp_path):
    """A folder with three meshes; nothing here reads them."""
    for name in ("id0_0.obj", "id1_3.obj", "id0_3.obj"):
        (tmp_path / name).touch()
    return tmp_path


def listed(folder, content):
    """Write a list and return its triples."""
    path = folder / "seen.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_list(path)


def names(triples):
    return [tuple(path.name for path in triple.paths) for triple in triples]


PUBLIC = ("id0_0.obj", "id1_3.obj", "id0_3.obj")


@pytest.mark.parametrize(
    "content",
    [
        "id0_0.obj id1_3.obj id0_3.obj\n",
        "id0_0 id1_3 id0_3",
        "  id0_0.obj\tid1_3\t id0_3.obj  \r\n",
        "# people\n\n   \nid0_0.obj id1_3.obj id0_3.obj # the first\n\n",
        "# people\r\n\r\nid0_0.obj id1_3.obj id0_3.obj\r\n",
        "# people\rid0_0.obj id1_3.obj id0_3.obj\r",
        b"\xef\xbb\xbfid0_0.obj id1_3.obj id0_3.obj\n",
        '"id0_0.obj" id1_3.obj "id0_3"\n',
        ".\\id0_0.obj ./id1_3 .\\id0_3\n",
        b"# M\xfcller, in Latin-1\nid0_0.obj id1_3.obj id0_3.obj\n",
    ],
    ids=["plain", "no-suffix", "tabs", "comments", "windows", "old-mac", "mark", "quotes", "backslashes", "latin-1"],
)
def test_a_line_names_three_files(folder, content):
    triples = listed(folder, content)
    assert names(triples) == [PUBLIC]
    assert all(path.is_file() for path in triples[0].paths)


def test_names_may_have_blanks_quotes_folders_and_other_letters(folder):
    (folder / "set one").mkdir()
    for name in ("set one/a person.obj", "bob's.obj", "Jürgen#2.obj"):
        (folder / name).touch()
    line = '"set one/a person" bob\'s.obj Jürgen#2.obj\n'
    for encoding in ("utf-8", "latin-1"):
        assert names(listed(folder, line.encode(encoding))) == [("a person.obj", "bob's.obj", "Jürgen#2.obj")]


def test_names_are_absolute_or_relative_to_the_folder_that_is_given(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("lists")
    absolute = " ".join(str(folder / name) for name in PUBLIC)
    assert names(listed(elsewhere, absolute)) == [PUBLIC]
    (elsewhere / "seen.txt").write_text(" ".join(PUBLIC))
    assert names(read_list(elsewhere / "seen.txt", folder)) == [PUBLIC]
    with pytest.raises(InputError, match=r"seen\.txt, line 1: expected the file 'id0_0\.obj' in .*--data"):
        read_list(elsewhere / "seen.txt")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected lines of identity, driving and truth, found none"),
        ("# nothing\n\n", "expected lines of identity, driving and truth, found none"),
        ("\nid0_0.obj id1_3.obj\n", "line 2: expected three names .*, found 2 in 'id0_0.obj id1_3.obj'"),
        ("id0_0 id1_3 id0_3\r\na person.obj id1_3 id0_3\r\n", "line 2: expected three names .* double quotes"),
        ("id0_0 id1_3 id0_3\nid0_0 id1_3 id0_4\n", "line 2: expected the file 'id0_4'"),
        ('id0_0 "" id0_3', "line 1: expected the file ''"),
        (f"id0_0 {'x' * 5000} id0_3", "line 1: expected the file 'xxx"),
        ("id0_0 id1_3 id0_3".encode("utf-16"), "found binary data or UTF-16; save it as UTF-8"),
    ],
    ids=["empty", "comments", "two", "blanks", "missing", "no-name", "long", "utf-16"],
)
def test_damaged_lists_are_refused_with_the_line(folder, content, message):
    with pytest.raises(InputError, match=rf"seen\.txt.*{message}"):
        listed(folder, content)


def test_a_name_without_suffix_must_fit_one_file(folder):
    (folder / "id0_0.ply").touch()
    with pytest.raises(InputError, match=r"line 1: expected one file called 'id0_0', found .*write the suffix"):
        listed(folder, "id0_0 id1_3 id0_3")
    assert names(listed(folder, "id0_0.ply id1_3 id0_3")) == [("id0_0.ply", *PUBLIC[1:])]


def test_lists_of_a_folder_are_found(tmp_path):
    with pytest.raises(InputError, match="found nothing"):
        find_lists(tmp_path / "gone.txt")
    with pytest.raises(InputError, match="found none in the folder"):
        find_lists(tmp_path)
    for name in ("unseen.txt", "seen.txt", ".hidden.txt", "seen.heights.json"):
        (tmp_path / name).touch()
    assert [path.name for path in find_lists(tmp_path)] == ["seen.txt", "unseen.txt"]
    assert find_lists(tmp_path / "seen.txt") == [tmp_path / "seen.txt"]


def test_written_lists_are_read_again(folder):
    (folder / "a b.obj").touch()
    (folder / "#3.obj").touch()
    triples = [PUBLIC, ("a b.obj", "#3.obj", "id0_3.obj")]
    heights = {"id0_0.obj": 1.71234567890123, "a b.obj": 1.5}
    write_list(folder / "seen.txt", triples, heights)
    assert [triple.names for triple in read_list(folder / "seen.txt")] == triples
    assert read_heights(folder / "seen.txt") == heights
    assert read_heights(folder / "unseen.txt") is None
    assert sorted(os.listdir(folder))[-2:] == ["seen.heights.json", "seen.txt"]


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[1.7]",
        "1.7",
        '{"id0_0.obj": "tall"}',
        '{"id0_0.obj": -1}',
        '{"id0_0.obj": true}',
        '{"id0_0.obj": 1' + "0" * 400 + "}",
        "\0",
    ],
)
def test_damaged_heights_are_refused(tmp_path, content):
    (tmp_path / "seen.heights.json").write_text(content)
    with pytest.raises(InputError, match=r"seen\.heights\.json: expected"):
        read_heights(tmp_path / "seen.txt")


def test_heights_are_numbers_by_name(tmp_path):
    (tmp_path / "seen.heights.json").write_text(json.dumps({"id0_0": 2}))
    assert read_heights(tmp_path / "seen.txt") == {"id0_0": 2.0}
