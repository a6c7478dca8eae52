"""`scripts/import_npt_weights.py`: weights in the published layouts are taken, everything else is refused."""

import json
import pickle
import sys
import warnings
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from import_npt_weights import load_published, main
from networks import infer_onnx
from paper_networks import NPT_PARAMETERS, npt, npt_shapes, random_state

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.io import save_mesh

VERTICES = 60


@pytest.fixture(scope="module")
def state():
    return random_state(npt_shapes())


@pytest.fixture(scope="module")
def weights(state, tmp_path_factory) -> Path:
    """Weights of NPT as its train.py saves them: a state dict, in the format of PyTorch 1.1."""
    path = tmp_path_factory.mktemp("npt") / "original_169.model"
    torch.save(state, path, _use_new_zipfile_serialization=False)
    return path


@pytest.fixture(scope="module")
def imported(weights) -> Path:
    """The same as an .onnx file."""
    out = weights.with_name("authors.onnx")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["import_npt_weights.py", str(weights), "-o", str(out)])
        main()
    return out


def person(seed: int, vertices: int = 40) -> Mesh:
    """Random vertices with faces, as tall as a person and centred."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (vertices, 3)) * [0.5, 1.0, 0.2]
    return Mesh(points - (points.min(axis=0) + points.max(axis=0)) / 2, rng.integers(vertices, size=(60, 3)))


@pytest.mark.slow
def test_imported_network_gives_what_the_reference_gives_and_says_what_it_is(imported, state):
    network = onnx.load(str(imported))
    identity, driving = torch.rand(2, 1, VERTICES, 3) * 2 - 1
    expected = npt(state, identity, driving, public=True)
    assert np.abs(infer_onnx(network, identity.numpy(), driving.numpy()) - expected.numpy()).max() < 1e-5
    facts = json.loads(next(p.value for p in network.metadata_props if p.key == "mimesh"))
    assert (facts["model"], facts["pose_code"], facts["target_scale"]) == ("npt", "per_vertex", "metres")
    card = json.loads(imported.with_suffix(".json").read_text())
    assert (card["imported"]["kind"], card["imported"]["file"]) == ("npt", "original_169.model")
    assert (card["parameters"], card["config"]["model"]["output"]) == (NPT_PARAMETERS, "2tanh")
    assert len(card["imported"]["sha256"]) == 64


@pytest.mark.slow
def test_imported_network_moves_meshes(imported, tmp_path, capsys):
    for seed, name in enumerate(("hero.obj", "pose.obj")):
        save_mesh(person(seed), tmp_path / name)
    files = [str(tmp_path / name) for name in ("hero.obj", "pose.obj", "out.obj")]
    assert run(["transfer", *files[:2], "-m", str(imported), "-o", files[2], "--no-preview", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == str(imported)


def test_the_same_weights_are_taken_as_those_of_the_max_pool_variant(weights):
    assert load_published(weights, maxpool=True).config.pose_code == "global_max"


@pytest.mark.parametrize("wrap", ["model_state_dict", "parallel", "half"])
def test_what_training_scripts_put_around_the_weights_is_removed(wrap, state, tmp_path):
    optimizer = torch.optim.Adam([torch.nn.Parameter(torch.zeros(2))]).state_dict()
    saved = {
        "model_state_dict": {"epoch": 7, "model_state_dict": state, "optimizer_state_dict": optimizer},
        "parallel": {f"module.{name}": tensor for name, tensor in state.items()},
        "half": {name: tensor.half() for name, tensor in state.items()},
    }[wrap]
    torch.save(saved, tmp_path / "weights.pt")
    found = load_published(tmp_path / "weights.pt").state_dict()["head.weight"]
    torch.testing.assert_close(found, state["decoder.conv4.weight"][:, :, 0], atol=1e-3, rtol=0)
    assert found.dtype == torch.float32


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"decoder.conv2.weight": torch.zeros(512, 1027, 1)}, "found another shape of decoder.conv2.weight; give"),
        ({"encoder.norm1.running_mean": torch.zeros(64)}, "found others encoder.norm1.running_mean; give"),
        ({"decoder.conv2.bias": None}, "found none of the name decoder.conv2.bias; give"),
        ({"decoder.conv2.bias": [1.0]}, "expected a tensor of floats as decoder.conv2.bias, found list; give"),
        (
            {"decoder.conv2.bias": torch.zeros(512, dtype=int)},
            "of floats as decoder.conv2.bias, found torch.int64; give",
        ),
    ],
)
def test_other_tensors_are_refused_by_name(change, message, state, tmp_path):
    changed = {name: tensor for name, tensor in (state | change).items() if tensor is not None}
    torch.save(changed, tmp_path / "weights.pt")
    with pytest.raises(InputError, match=message):
        load_published(tmp_path / "weights.pt")


def test_what_is_no_weights_is_refused(tmp_path):
    path = tmp_path / "weights.model"
    with pytest.raises(InputError, match="found 'No such file or directory'; check the path"):
        load_published(path)
    for content, found in (
        (torch.nn.Linear(2, 2), "a file of something else; give what torch.save"),
        (torch.zeros(3), "found Tensor; give"),
        ({}, "found dict; give"),
        ({"state_dict": 3}, "found int; give"),
    ):
        torch.save(content, path)
        with pytest.raises(InputError, match=found):
            load_published(path)
    for content in (b"", b"PK no archive", b"text"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="expected tensors by name, found a file of something else"):
            load_published(path)


class Malicious:
    """Writes a file where it is unpickled without care."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("how", ["new", "legacy", "pickle", "beside the weights"])
def test_malicious_pickle_is_refused_and_not_run(how, state, tmp_path):
    path, evidence = tmp_path / "weights.model", tmp_path / "evidence"
    trap = Malicious(evidence)
    if how == "pickle":
        path.write_bytes(pickle.dumps(trap))
    else:
        saved = state | {"decoder.extra": trap} if how == "beside the weights" else trap
        torch.save(saved, path, _use_new_zipfile_serialization=how != "legacy")
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.load(file, weights_only=False) if how != "pickle" else pickle.load(file)
    assert evidence.exists(), "the file is one that does harm"
    evidence.unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(InputError, match="expected tensors by name, found a file of something else"):
            load_published(path)
    assert not evidence.exists()
