"""ONNX gives what torch gives, at any vertex count; cards say how a network was trained."""

import copy
import dataclasses
import json
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from networks import infer_onnx

import mimesh
from mimesh.core.errors import InputError
from mimesh.learn.config import load_config, recorded_config
from mimesh.learn.export import SMALLEST, export_command
from mimesh.learn.mime import POINTS
from mimesh.learn.models import operations_of
from mimesh.methods.onnx_runtime import import_onnxruntime

ZOO = Path(mimesh.__file__).parent / "methods" / "zoo"
CARDS = [path for folder in (ZOO, ZOO.parents[2] / "ablations") for path in sorted(folder.glob("*.json"))]


@pytest.mark.slow
@torch.no_grad()
def test_exported_npt_gives_what_torch_gives_and_its_card_says_how_it_was_trained(exported, read_back):
    path, (model, _) = exported("npt")[2], read_back("npt")
    network = onnx.load(str(path))
    for batch, v, u in ((1, 500, 500), (3, 57, 57), (2, 40, 90)):
        identity, driving = torch.rand(batch, v, 3) * 2 - 1, torch.rand(batch, u, 3) * 2 - 1
        found = infer_onnx(network, identity.numpy(), driving.numpy())
        assert np.abs(found - model(identity, driving).numpy()).max() < 1e-4
    facts = json.loads(next(p.value for p in network.metadata_props if p.key == "mimesh"))
    card = json.loads(path.with_suffix(".json").read_text())
    assert (facts["model"], facts["pose_code"], facts["target_scale"]) == ("npt", "global_max", "truth")
    assert {"data", "config", "seconds_trained", "hardware", "commit", "seed", "license"} <= set(card)
    assert card["metrics"]["val"]["unseen_pmd_e4"] == 2.0


@pytest.mark.slow
@torch.no_grad()
def test_mime_exports_joints_and_weights(exported):
    model, _, path = exported("mime")
    model = copy.deepcopy(model)
    for weight in model.parameters():
        weight.data = weight.half().float() if weight.numel() >= SMALLEST else weight
    session = import_onnxruntime().InferenceSession(path)
    for count in (1, 40, 700):
        points, normals = torch.nn.functional.normalize(torch.randn(2, 1, POINTS, 3), dim=-1)
        vertices, vertex_normals = torch.randn(2, 1, count, 3)
        prediction = model.predict_joints(points, normals)
        scores = model.predict_weights(prediction, vertices, vertex_normals)
        given = {"points": points, "normals": normals, "vertices": vertices, "vertex_normals": vertex_normals}
        found = session.run(["rotation", "joints", "scores"], {name: array.numpy() for name, array in given.items()})
        for ours, theirs in zip(found, (prediction.rotation, prediction.joints, scores), strict=True):
            assert np.abs(ours - theirs.numpy()).max() < 1e-4 * (1 + np.abs(theirs.numpy()).max())


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


@pytest.mark.parametrize("path", [path for path in CARDS if path.stem != "hands"], ids=lambda path: path.stem)
def test_cards_have_the_arithmetic_of_their_training(path):
    card = json.loads(path.read_text())
    config, total = recorded_config(card["config"], path.name), 0.0
    # Backwards: the last stretch has the vertices of the configuration, those before have what the changes say.
    last, vertices = card["pairs"], config.data.vertices
    for change in reversed([change for change in card.get("changes", []) if "data.vertices" in change]):
        total += operations_with(config, vertices, last - change["after_pairs"])
        last, vertices = change["after_pairs"], change["was"]["data.vertices"]
    pairs = last + sum(stage["pairs"] for stage in card.get("before", []))
    assert card["pflop"] == pytest.approx((total + operations_with(config, vertices, pairs)) / 1e15, rel=0.01)


def operations_with(config, vertices, pairs):
    return operations_of(dataclasses.replace(config, data=dataclasses.replace(config.data, vertices=vertices)), pairs)


def test_arithmetic_of_the_papers_is_that_of_their_schedules():
    """200 epochs of 4,000 pairs at 6,890 vertices; AniFormer: of 400 windows."""
    for network, pflop in (("npt", 200), ("aniformer", 187)):
        config = load_config("paper", network)
        assert operations_of(config, config.pairs) / 1e15 == pytest.approx(pflop, rel=0.01)
