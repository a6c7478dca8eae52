"""Messages of errors are one line of bounded length, whatever a file has in its names."""

import pickle

from mimesh.core.errors import LONGEST_MESSAGE, InputError


def test_message_is_one_line_and_a_short_one_stays():
    assert str(InputError("a: expected b,\nfound c\r\n\u2028d; do e")) == "a: expected b, found c  d; do e"
    assert str(InputError("x" * LONGEST_MESSAGE)) == "x" * LONGEST_MESSAGE


def test_long_message_keeps_its_start_and_its_end():
    message = str(InputError("a.ply: expected b, found '" + "c" * 10**6 + "'; export it again"))
    assert message.startswith("a.ply: expected b, found 'ccc")
    assert message.endswith("ccc'; export it again")
    assert len(message) <= LONGEST_MESSAGE


def test_error_can_be_handed_to_another_process():
    assert str(pickle.loads(pickle.dumps(InputError("a b")))) == "a b"
