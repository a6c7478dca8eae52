"""ONNX gives what torch gives, at any vertex count; half-precision storage is small and close."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import mimesh
from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.learn.config import load_config, recorded_config
from mimesh.learn.cost import operations_of
from mimesh.learn.export import compress, export_command, infer_onnx, to_onnx
from mimesh.learn.mime import POINTS, MimeConfig, MimeNetwork, MimeTask
from mimesh.learn.npt import NPT, NPTConfig, NPTTask
from mimesh.methods.onnx_runtime import import_onnxruntime

ZOO = Path(mimesh.__file__).parent / "zoo"
CARDS = [path for folder in (ZOO, ZOO.parents[2] / "ablations") for path in sorted(folder.glob("*.json"))]


@pytest.mark.slow
def test_pooled_npt_in_onnx_gives_what_torch_gives():
    torch.manual_seed(0)
    model = NPT(NPTConfig((16, 32, 64), (67, 32, 16), pose_code="global_max")).eval()
    network = to_onnx(NPTTask.onnx_interface(model))
    half, eighth = compress(network), compress(network, bits=8)
    for batch, v, u in ((1, 500, 500), (3, 57, 57), (2, 40, 90)):
        identity, driving = torch.rand(batch, v, 3) * 2 - 1, torch.rand(batch, u, 3) * 2 - 1
        with torch.no_grad():
            expected = model(identity, driving).numpy()
        assert np.abs(infer_onnx(network, identity.numpy(), driving.numpy()) - expected).max() < 1e-4
        assert np.abs(infer_onnx(half, identity.numpy(), driving.numpy()) - expected).max() < 2e-2
        assert np.abs(infer_onnx(eighth, identity.numpy(), driving.numpy()) - expected).max() < 0.2
    sizes = [sum(len(t.raw_data) for t in n.graph.initializer) for n in (eighth, half, network)]
    assert sizes[0] < 0.65 * sizes[1] < 0.65**2 * sizes[2]


@pytest.mark.slow
def test_mime_exports_joints_and_weights():
    torch.manual_seed(0)
    model = MimeNetwork(
        MimeConfig(width=16, heads=2, latents=4, blocks=2, near=8, local=8, skinning=8), load_body()
    ).eval()
    for parameter in model.parameters():  # some layers begin with zeros
        parameter.data += 0.02 * torch.randn_like(parameter)
    network = to_onnx(MimeTask.onnx_interface(model))
    session = import_onnxruntime().InferenceSession(network.SerializeToString())
    for count in (1, 40, 700):
        points, normals = torch.nn.functional.normalize(torch.randn(2, 1, POINTS, 3), dim=-1)
        vertices, vertex_normals = torch.randn(2, 1, count, 3)
        with torch.no_grad():
            prediction = model.predict_joints(points, normals)
            expected = (
                prediction.rotation,
                prediction.joints,
                model.predict_weights(prediction, vertices, vertex_normals),
            )
        given = {"points": points, "normals": normals, "vertices": vertices, "vertex_normals": vertex_normals}
        found = session.run(["rotation", "joints", "scores"], {name: array.numpy() for name, array in given.items()})
        for ours, theirs in zip(found, expected, strict=True):
            assert np.abs(ours - theirs.numpy()).max() < 1e-4 * (1 + np.abs(theirs.numpy()).max())


@pytest.mark.slow
def test_export_writes_network_and_card(exported):
    (model, _), path = exported("npt", 16)
    network = onnx.load(str(path))
    facts = json.loads(next(p.value for p in network.metadata_props if p.key == "mimesh"))
    card = json.loads(path.with_suffix(".json").read_text())
    assert (facts["model"], facts["pose_code"], facts["target_scale"]) == ("npt", "per_vertex", "truth")
    assert {"data", "config", "seconds_trained", "hardware", "commit", "seed", "license"} <= set(card)
    assert card["metrics"]["val"]["unseen_pmd_e4"] == 2.0
    points = torch.rand(2, 1, 30, 3)
    with torch.no_grad():
        expected = model(*points).numpy()
    assert np.abs(infer_onnx(network, *points.numpy()) - expected).max() < 2e-2


def test_bits_and_the_name_of_the_output_are_checked(tmp_path):
    for name, bits, message in (
        ("mine.onnx", 4, "--bits: expected 16 or 8, found 4"),
        ("mine.pt", 16, r"ends in \.onnx"),
    ):
        with pytest.raises(InputError, match=message):
            export_command(tmp_path / "best.safetensors", tmp_path / name, bits=bits)


def test_shipped_files_hold_no_paths_of_sources():
    for path in ZOO.glob("*.onnx"):
        assert b".py" not in path.read_bytes(), path.name


@pytest.mark.parametrize("path", CARDS, ids=lambda path: path.stem)
def test_cards_have_the_arithmetic_of_their_training(path):
    card = json.loads(path.read_text())
    config, total = recorded_config(card["config"], path.name), 0.0
    # Backwards: the last stretch has the vertices of the configuration, those before have what the changes say.
    last, vertices = card["pairs"], config.data.vertices
    for change in reversed([change for change in card.get("changes", []) if "data.vertices" in change]):
        total += operations_with(config, vertices, last - change["after_pairs"])
        last, vertices = change["after_pairs"], change["was"]["data.vertices"]
    pairs = last + sum(stage["pairs"] for stage in card.get("before", []))
    if config.minutes and config.doublings:  # how many pairs there were after each depends on the machine
        most = operations_with(config, vertices << len(config.doublings), pairs)
        assert operations_with(config, vertices, pairs) < 1e15 * card["pflop"] < most
        return
    assert card["pflop"] == pytest.approx((total + operations_with(config, vertices, pairs)) / 1e15, rel=0.01)


def operations_with(config, vertices, pairs):
    return operations_of(dataclasses.replace(config, data=dataclasses.replace(config.data, vertices=vertices)), pairs)


def test_arithmetic_of_the_papers_is_that_of_their_schedules():
    """200 epochs of 4,000 pairs at 6,890 vertices; AniFormer: of 400 windows."""
    for network, pflop in (("npt", 200), ("aniformer", 187)):
        config = load_config("paper", network)
        assert operations_of(config, config.pairs) / 1e15 == pytest.approx(pflop, rel=0.01)
