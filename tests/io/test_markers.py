"""Marker files: pairs of whole numbers, comments, and mistakes reported with their line."""

import numpy as np
import pytest

from mimesh.core.errors import InputError
from mimesh.io.text import load_markers


def test_pairs_are_read_and_comments_skipped(tmp_path):
    path = tmp_path / "five.txt"
    path.write_text("# identity driving\n3 5  # nose\n\n 10\t0\r\n")
    assert np.array_equal(load_markers(path), [[3, 5], [10, 0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n3\n", "line 2: .* found '3'"),
        ("1 2 3\n", "line 1"),
        ("-1 2\n", "line 1: .* found '-1 2'"),
        ("0 99999999999999999999\n", "line 1: .* found '0 99999999999999999999'"),
        ("1" * 5000 + " 0\n", "line 1"),
        ("a b\n", "line 1"),
        ("# nothing\n", "found no line"),
        ("", "found no line"),
    ],
)
def test_mistakes_name_their_line(tmp_path, text, message):
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_markers(path)


def test_missing_marker_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="found none"):
        load_markers(tmp_path / "none.txt")
