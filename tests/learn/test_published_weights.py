"""`mimesh import-checkpoint`: weights in the published layouts are recognised and used, everything else is refused."""

import contextlib
import io
import json
import pickle
import re
import warnings
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from networks import infer_onnx
from paper_networks import NPT_PARAMETERS, npt, npt_shapes, random_state

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.io import save_mesh
from mimesh.learn.published_weights import load_published, read_state

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
    """The same as an .onnx file, and beside it what the command printed."""
    out = weights.with_name("authors.onnx")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert run(["import-checkpoint", str(weights), "-o", str(out), "--json"]) == 0
    weights.with_name("printed.json").write_text(printed.getvalue())
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
    facts = {"bytes": imported.stat().st_size, "kind": "npt", "parameters": NPT_PARAMETERS}
    assert json.loads(imported.with_name("printed.json").read_text()) == {"output": str(imported), **facts}


@pytest.mark.slow
def test_imported_network_moves_meshes(imported, tmp_path, capsys):
    for seed, name in enumerate(("hero.obj", "pose.obj")):
        save_mesh(person(seed), tmp_path / name)
    files = [str(tmp_path / name) for name in ("hero.obj", "pose.obj", "out.obj")]
    assert run(["transfer", *files[:2], "-m", str(imported), "-o", files[2], "--no-preview", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == str(imported)


def test_the_same_weights_are_taken_as_those_of_the_max_pool_variant(weights):
    found = load_published(weights, maxpool=True)
    assert (found.kind, found.model.config.pose_code) == ("npt-maxpool", "global_max")
    assert found.shapes() == npt_shapes()


@pytest.mark.parametrize("wrap", ["model_state_dict", "parallel", "half"])
def test_what_training_scripts_put_around_the_weights_is_removed(wrap, state, tmp_path):
    optimizer = torch.optim.Adam([torch.nn.Parameter(torch.zeros(2))]).state_dict()
    saved = {
        "model_state_dict": {"epoch": 7, "model_state_dict": state, "optimizer_state_dict": optimizer},
        "parallel": {f"module.{name}": tensor for name, tensor in state.items()},
        "half": {name: tensor.half() for name, tensor in state.items()},
    }[wrap]
    torch.save(saved, tmp_path / "weights.pt")
    found = load_published(tmp_path / "weights.pt").model.state_dict()["head.weight"]
    torch.testing.assert_close(found, state["decoder.conv4.weight"][:, :, 0], atol=1e-3, rtol=0)
    assert found.dtype == torch.float32


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"decoder.conv2.weight": torch.zeros(512, 1027, 1)}, "decoder.conv2.weight of 513 x 1027 x 1 .* 512 x 1027 x"),
        ({"decoder.conv2.weight": torch.zeros(513, 1027)}, "decoder.conv2.weight of 513 x 1027 x 1 .* 513 x 1027$"),
        ({"encoder.norm1.running_mean": torch.zeros(64)}, "68 tensors of npt, found also encoder.norm1.running_mean"),
        ({"decoder.conv2.bias": None}, "68 tensors of npt, found decoder.conv2.bias missing"),
        ({"decoder.conv2.bias": torch.full((513,), torch.nan)}, "finite .* numbers in decoder.conv2.bias"),
        ({"decoder.conv2.bias": torch.zeros(513, dtype=torch.int64)}, "floating-point numbers in decoder.conv2.bias"),
        ({"decoder.conv2.bias": torch.zeros(1).expand(513)}, "another value under 'decoder.conv2.bias'"),
        ({"decoder.conv2.bias": torch.zeros(513).to_sparse()}, "another value under 'decoder.conv2.bias'"),
        ({"decoder.conv2.bias": "text"}, "another value under 'decoder.conv2.bias'"),
    ],
)
def test_other_tensors_are_refused_by_name(change, message, state, tmp_path):
    changed = {name: tensor for name, tensor in (state | change).items() if tensor is not None}
    torch.save(changed, tmp_path / "weights.pt")
    with pytest.raises(InputError, match=message):
        load_published(tmp_path / "weights.pt")


class Malicious:
    """Writes a file where it is unpickled without care."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("how", ["new", "legacy", "pickle", "beside the weights"])
def test_malicious_pickle_is_refused_and_not_run(how, state, tmp_path, capsys):
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
    assert run(["import-checkpoint", str(path), "-o", str(tmp_path / "out.onnx")]) == 2
    error = capsys.readouterr().err
    assert "expected a PyTorch file of tensors alone" in error
    assert len(error.splitlines()) == 1
    assert not evidence.exists()
    assert not (tmp_path / "out.onnx").exists()


@pytest.mark.parametrize("content", [b"", b"not weights", pickle.dumps({}), bytes(2000), b"PK\x03\x04" + bytes(100)])
def test_other_files_are_refused(content, tmp_path):
    (tmp_path / "weights.model").write_bytes(content)
    with pytest.raises(InputError, match=r"weights\.model: expected"):
        read_state(tmp_path / "weights.model")


def test_damaged_weights_are_refused_or_read(tmp_path):
    """Random bytes of a good file are changed: never another error than one of one line."""
    rng, path, refused = np.random.default_rng(0), tmp_path / "weights.model", 0
    for new in (True, False):
        torch.save({"a.weight": torch.rand(3, 2), "b": torch.rand(4)}, path, _use_new_zipfile_serialization=new)
        whole = np.frombuffer(path.read_bytes(), np.uint8)
        for k in range(60):
            damaged = whole[: rng.integers(len(whole))].copy() if k % 4 == 0 else whole.copy()
            if len(damaged):
                damaged[rng.integers(min(len(damaged), 900), size=3)] = rng.integers(256, size=3)
            path.write_bytes(damaged.tobytes())
            try:
                read_state(path)
            except InputError:
                refused += 1
    assert refused > 60


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["lost.model", "-o", "out.onnx"], "lost.model: expected a PyTorch file of weights .*, found no file"),
        (["lost.model", "-o", "out.pt"], "ends in .onnx, found .pt"),
        (["lost.model", "-o", "out.onnx", "--bits", "4"], "--bits: expected 32, 16 or 8, found 4; leave it out for 32"),
    ],
)
def test_arguments_are_checked_before_anything_is_read(options, message, capsys):
    assert run(["import-checkpoint", *options]) == 2
    assert re.search(message, capsys.readouterr().err)
