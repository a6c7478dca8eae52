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
from mimesh.learn.export import INT8_STEPS, STORED_BITS, compress, load_start, stored_weights
from mimesh.learn.start import train_command
from mimesh.methods.find import find_model


@pytest.mark.slow
@pytest.mark.parametrize("network", ["npt", "aniformer"])
def test_an_exported_network_is_read_back(exported, read_back, network):
    model, trained, _ = exported(network)
    again, start = read_back(network)
    for name, value in model.state_dict().items():
        largest = value.abs().amax(dim=-1, keepdim=True) if value.ndim == 2 else value.abs()
        error = (again.state_dict()[name] - value).abs()
        rounding = 0.51 / INT8_STEPS if value.ndim == 2 else 1e-3
        assert (error <= largest * rounding + 1e-7).all(), name
    assert (start.pairs, start.spent()) == (trained.pairs, trained.spent())


@pytest.mark.slow
@pytest.mark.parametrize("bits", STORED_BITS)
def test_stored_weights_are_near_and_stored_again_they_are_the_same(tmp_path, bits):
    """Rows of int8 are rounded to themselves; small tensors are left as they are."""
    torch.manual_seed(0)
    weights = {"matrix": torch.randn(40, 30), "column": torch.randn(300), "few": torch.randn(5)}
    sizes = []
    for error in (1e-3 if bits == 16 else 0.05, 1e-6):
        arrays = [onnx.numpy_helper.from_array(value.numpy(), name) for name, value in weights.items()]
        graph = onnx.helper.make_graph([], "weights", [], [], arrays)
        stored = compress(onnx.helper.make_model(graph), bits)
        onnx.save(stored, tmp_path / "net.onnx")
        found = stored_weights(tmp_path / "net.onnx")
        for name, value in weights.items():
            torch.testing.assert_close(found[name], value, rtol=1e-3, atol=error, msg=name)
        assert torch.equal(found["few"], weights["few"])
        weights = {name: found[name] for name in weights}
        sizes.append(sum(len(tensor.raw_data) for tensor in stored.graph.initializer))
    assert sizes[0] == sizes[1] == {16: 2 * 1500 + 20, 8: 1200 + 4 * 40 + 2 * 300 + 20}[bits]


@pytest.mark.slow
def test_a_training_begins_with_an_exported_network(exported, tmp_path):
    """And its card has the pairs and the arithmetic of both."""
    _, trained, path = exported("npt")
    changes = ["model.encoder=[16,32,32]", "model.decoder=[35,16,16]", "model.pose_code=global_max", "pairs=2"]
    changes += ["data.vertices=64", "batch=2", "validation_pairs=1", "precision=fp32"]
    folder = train_command("npt", "table", tmp_path / "next", None, None, [*changes, "minutes=0"], weights=path)
    state = checkpoint.load(folder / "last.safetensors")
    assert state.pairs == 2 + trained.pairs
    assert state.before[0]["operations"] == trained.operations


@pytest.mark.slow
def test_what_is_no_start_is_refused(exported, tmp_path):
    whole = exported("npt")[2]
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
    path = exported("mime")[2]
    card = json.loads({entry.key: entry.value for entry in onnx.load(str(path)).metadata_props}["mimesh"])
    body = load_body("quadruped")
    assert card["body"] == "quadruped"
    assert tuple(card["joints"]) == body.joint_names
    assert [[body.joint_names[j] for j in leg] for leg in card["legs"]] == [list(leg) for leg in QUADRUPED.legs]
    assert find_model(str(path)).body == "quadruped"
