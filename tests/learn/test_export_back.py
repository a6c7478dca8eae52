"""Networks read back from `.onnx` files: the same weights, a start for another training, and what is refused."""

import json
import shutil
from pathlib import Path

import onnx
import pytest
import torch

from mimesh.bodies import load_body
from mimesh.bodies.anatomy import QUADRUPED
from mimesh.core.errors import InputError
from mimesh.learn import checkpoint
from mimesh.learn.export import INT8_STEPS, export_command, load_exported, load_start
from mimesh.learn.start import train_command
from mimesh.methods.find import find_method


@pytest.mark.slow
@pytest.mark.parametrize(("network", "bits"), [("npt", 16), ("npt", 8), ("aniformer", 8), ("mime", 16)])
def test_an_exported_network_is_read_back(exported, network, bits):
    (model, trained), path = exported(network, bits)
    again, start = load_exported(path)
    for name, value in model.state_dict().items():
        largest = value.abs().amax(dim=-1, keepdim=True) if value.ndim == 2 else value.abs()
        error = (again.state_dict()[name] - value).abs()
        assert (error <= largest * (0.51 / INT8_STEPS if bits == 8 and value.ndim == 2 else 1e-3) + 1e-7).all(), name
    assert (start.pairs, start.spent()) == (trained.pairs, trained.spent())


@pytest.mark.slow
def test_an_exported_network_exported_again_is_the_same(exported, tmp_path):
    """Rows of int8 are rounded to themselves."""
    _, path = exported("npt", 8)
    again, start = load_start(path)
    checkpoint.save(tmp_path / "again.safetensors", start)
    export_command(tmp_path / "again.safetensors", tmp_path / "again.onnx", 8)
    second, _ = load_exported(tmp_path / "again.onnx")
    for name, value in again.state_dict().items():
        torch.testing.assert_close(second.state_dict()[name], value, rtol=1e-3, atol=1e-7, msg=name)


@pytest.mark.slow
def test_a_training_begins_with_an_exported_network(exported, tmp_path):
    """And its card has the pairs and the arithmetic of both."""
    (_, trained), path = exported("npt", 16)
    changes = ["model.encoder=[16,32,32]", "model.decoder=[35,16,16]", "data.vertices=64", "batch=2", "pairs=2"]
    changes += ["validation_pairs=1", "precision=fp32"]
    folder = train_command("npt", "table", tmp_path / "next", None, None, [*changes, "minutes=0"], weights=path)
    state = checkpoint.load(folder / "last.safetensors")
    assert state.pairs == 2 + trained.pairs
    assert state.before[0]["operations"] == trained.operations


@pytest.mark.slow
def test_what_is_no_start_is_refused(exported, tmp_path):
    _, whole = exported("npt", 16)
    path, card = (Path(shutil.copy(file, tmp_path)) for file in (whole, whole.with_suffix(".json")))
    network = onnx.load(str(path))
    del network.graph.initializer[0]
    onnx.save(network, str(tmp_path / "less.onnx"))
    (tmp_path / "less.json").write_text(card.read_text())
    with pytest.raises(InputError, match="expected all weights of npt by name, found 1 missing"):
        load_start(tmp_path / "less.onnx")
    for text in ("", "{}", json.dumps({"config": {"network": "npt"}})):
        card.write_text(text)
        with pytest.raises(InputError, match=r"expected its card net\.json beside it"):
            load_start(path)
    (tmp_path / "less.onnx").write_bytes(b"\x00not a network")
    with pytest.raises(InputError, match="expected a file of `mimesh export`"):
        load_start(tmp_path / "less.onnx")


@pytest.mark.slow
def test_an_exported_network_of_animals_says_so(exported):
    _, path = exported("mime", 16)
    card = json.loads({entry.key: entry.value for entry in onnx.load(str(path)).metadata_props}["mimesh"])
    body = load_body("quadruped")
    assert card["body"] == "quadruped"
    assert tuple(card["joints"]) == body.joint_names
    assert [[body.joint_names[j] for j in leg] for leg in card["legs"]] == [list(leg) for leg in QUADRUPED.legs]
    assert find_method(str(path)).body == "quadruped"
