"""Metadata of networks may be anything: those that are not a model's are refused with one line."""

from __future__ import annotations

import json

import pytest
from networks import write_mime_network, write_network, write_sequence_network

from mimesh.core.errors import InputError
from mimesh.methods.find import find_model

onnx = pytest.importorskip("onnx")

TEXTS = ["", "{", "null", "3", '"mime"', "[]", '["model"]', "[" * 100_000, '{"model": NaN}', "{}"]
CARDS = [
    {"model": None},
    {"model": ["mime"]},
    {"model": {"mime": 1}},
    {"model": "npt"},
    {"points": "512"},
    {"points": 0},
    {"points": True},
    {"points": 10**9},
    {"joints": "Hips"},
    {"joints": {"Hips": 0}},
    {"joints": []},
    {"joints": [1, 2, 3]},
    {"joints": ["Hips", "Hips"]},
    {"parents": None},
    {"parents": [-1, 0]},
    {"parents": "cycle"},
    {"parents": "two roots"},
    {"parents": "text"},
    {"legs": 3},
    {"legs": [3]},
    {"legs": [[0]]},
    {"legs": [[0, 1, 10**6]]},
    {"legs": [[0, 1, "2"]]},
    {"body": 7},
]


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    return onnx.load(str(write_mime_network(tmp_path_factory.mktemp("networks") / "mime.onnx")))


def refusal(network, text: str, path) -> str:
    changed = onnx.ModelProto.FromString(network.SerializeToString())
    changed.metadata_props[0].value = text
    onnx.save(changed, str(path))
    with pytest.raises(InputError) as caught:
        find_model(str(path))
    message = str(caught.value)
    assert message.startswith(f"{path}: expected ")
    assert len(message) < 400 + len(str(path))
    return message


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_text_that_is_no_metadata_is_refused(network, text, tmp_path):
    refusal(network, text, tmp_path / "odd.onnx")


@pytest.mark.parametrize("change", CARDS, ids=str)
def test_metadata_of_other_shapes_are_refused(network, change, tmp_path):
    card = json.loads(network.metadata_props[0].value)
    parents = card["parents"]
    odd = {
        "cycle": [-1, 2, 1, *parents[3:]],
        "two roots": [-1, -1, *parents[2:]],
        "text": [-1, "0", *parents[2:]],
    }
    ((key, value),) = change.items()
    value = odd.get(value, value) if isinstance(value, str) else value
    message = refusal(network, json.dumps(card | {key: value}), tmp_path / "odd.onnx")
    assert {"model": "model", "legs": "leg"}.get(key, key.rstrip("s")) in message or value == "npt"


@pytest.mark.parametrize(
    ("write", "fact"),
    [
        (write_network, {"pose_code": "other"}),
        (write_network, {"target_scale": "other"}),
        (write_network, {"pairing": "index"}),
        (write_sequence_network, {"model": "other"}),
        (write_sequence_network, {"head": "two"}),
        (write_sequence_network, {"target_scale": "x"}),
        (write_sequence_network, {"frames": 0}),
        (write_sequence_network, {"frames": "3"}),
    ],
)
def test_metadata_that_other_networks_cannot_have_are_refused(write, fact, tmp_path):
    other = onnx.load(str(write(tmp_path / "tiny.onnx")))
    other.metadata_props[0].value = json.dumps(json.loads(other.metadata_props[0].value) | fact)
    onnx.save(other, str(tmp_path / "odd.onnx"))
    with pytest.raises(InputError, match=next(iter(fact))):
        find_model(str(tmp_path / "odd.onnx"))


def test_joints_are_those_of_the_network(network, tmp_path):
    """A joint more than the network's outputs have would fail in the middle of a transfer."""
    card = json.loads(network.metadata_props[0].value)
    longer = card | {"joints": [*card["joints"], "Tail"], "parents": [*card["parents"], 0]}
    assert f"{len(longer['joints'])} joints" in refusal(network, json.dumps(longer), tmp_path / "odd.onnx")
    onnx.save(network, str(tmp_path / "good.onnx"))
    assert find_model(str(tmp_path / "good.onnx")).name


def test_name_that_is_no_text_is_refused(network, tmp_path, capsys):
    """The library's message quotes the name, and Python's exception is then that of the text."""
    content = network.SerializeToString()
    assert content.count(b"distance") > 1
    (tmp_path / "a.onnx").write_bytes(content.replace(b"distance", b"dist\x88nce", 1))
    with pytest.raises(InputError, match="expected a network in ONNX format"):
        find_model(str(tmp_path / "a.onnx"))
    assert capsys.readouterr() == ("", "")
