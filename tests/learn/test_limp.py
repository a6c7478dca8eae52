"""LIMP: codes that do not depend on order, one template for all results, losses that keep lengths."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch
from trainings import edge_lengths, losses

from mimesh.core.errors import InputError
from mimesh.core.geometry import edges
from mimesh.evaluate.clip_protocols import CLIPS_ANIFORMER
from mimesh.evaluate.measure import measure_clip
from mimesh.evaluate.remesh import template
from mimesh.learn.config import config_from, load_config
from mimesh.learn.export import export_command
from mimesh.learn.limp import LIMP, LIMPConfig, LIMPLossConfig, LIMPTask, limp_loss, relative_change
from mimesh.learn.loop import TrainingRun
from mimesh.learn.task import shipped_body
from mimesh.pipeline import transfer

COUNT = 2100
SMALL = {"encoder": [8, 16, 32], "style": 4, "pose": 8, "decoder": [16, 16], "vertices": COUNT}
CONFIG = {
    "network": "limp",
    "model": SMALL,
    "data": {"kind": "clips80", "vertices": COUNT, "target_scale": "identity"},
    "batch": 2,
    "pairs": 4,
    "validation_pairs": 1,
}


class MeshAsCode(LIMP):
    """Codes are the meshes themselves: style is ignored, pose is all."""

    def __init__(self):
        super().__init__(LIMPConfig(vertices=1))

    def encode(self, mesh):
        return torch.zeros(1, len(mesh)), mesh.flatten(1).T

    def decode(self, style, pose):
        return pose.T.unflatten(1, (-1, 3))


def limp():
    torch.manual_seed(0)
    return LIMP(LIMPConfig(**{k: tuple(v) if isinstance(v, list) else v for k, v in SMALL.items()})).eval()


def body_mesh(count=2):
    mesh = template()
    points = torch.from_numpy(mesh.positions(shipped_body().vertices)).float()
    return points.expand(count, -1, -1), torch.from_numpy(edges(mesh.faces))


def test_the_template_is_a_surface_on_the_bodys_own_vertices():
    mesh = template()
    chosen = mesh.corners[:, 0]
    assert len(np.unique(chosen)) == COUNT == len(np.unique(mesh.faces))
    assert (mesh.positions(shipped_body().vertices) == shipped_body().vertices[chosen]).all()
    corners = np.concatenate([mesh.faces[:, k] for k in ([0, 1], [1, 2], [2, 0])])
    neighbours = np.unique(np.sort(corners, axis=1), axis=0, return_counts=True)[1]
    assert (neighbours <= 2).mean() > 0.99
    assert len(np.unique(corners, axis=0)) > 0.99 * len(corners)  # turned alike


@torch.no_grad()
def test_a_pose_is_transferred_by_swapping_the_extrinsic_code():
    model, identity, driving = limp(), torch.rand(2, 50, 3), torch.rand(2, 70, 3)
    (style, own), (_, pose) = model.encode(identity), model.encode(driving)
    assert torch.equal(model(identity, driving), model.decode(style, pose))
    assert torch.equal(model(identity, identity), model.decode(style, own))
    assert model(identity, driving).shape == (2, COUNT, 3)


def test_the_loss_is_least_where_lengths_are_kept():
    """Zero for a network that reproduces meshes that do not move; then each term by itself."""
    mesh, pairs = body_mesh()
    rng = torch.Generator().manual_seed(0)
    weights = LIMPLossConfig()
    assert limp_loss(MeshAsCode(), mesh, mesh, mesh, pairs, weights, rng) == 0
    turn = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    # A rigid turn keeps the edges of a swapped pose; what lies straight between two headings is thinner.
    thinner = limp_loss(MeshAsCode(), mesh, mesh, mesh @ turn.T, pairs, weights, rng)
    assert 0 < thinner < weights.lengths
    # Somebody else's larger body, taken for a pose, stretches the edges by a tenth; between the two all is even.
    larger = limp_loss(MeshAsCode(), mesh, mesh, 1.1 * mesh, pairs, weights, rng)
    assert float(larger) == pytest.approx(0.1 * weights.lengths, rel=1e-4)
    assert limp_loss(MeshAsCode(), mesh, mesh, 1.1 * mesh, pairs, LIMPLossConfig(lengths=0.0), rng) == 0


@pytest.mark.slow
def test_batches_hold_one_person_twice_on_the_templates_vertices():
    source = LIMPTask(config_from(CONFIG, "here"), torch.device("cpu")).source(0)
    batch = source.batch(3, 0)
    assert batch.identity.shape == batch.driving.shape == batch.truth.shape == (3, COUNT, 3)
    lengths = [edge_lengths(mesh, batch.edges) for mesh in (batch.identity, batch.truth, batch.driving)]
    ratios = [(a / b) for a, b in itertools.pairwise(lengths)]
    same, other = ((ratio / ratio.median(1, keepdim=True).values - 1).abs().median() for ratio in ratios)
    assert same < 0.5 * other
    # The right answer costs no more than what skinning does to edges: both poses of a person are in one unit.
    assert relative_change(lengths[1], lengths[0]) < 0.08


@pytest.mark.slow
def test_a_training_becomes_a_method_for_the_template(tmp_path):
    run = TrainingRun.start(config_from(CONFIG, "here"), tmp_path)
    losses(run, 1)
    run.save(tmp_path / "last.safetensors")
    export_command(tmp_path / "last.safetensors", tmp_path / "limp.onnx", bits=8)
    trial = CLIPS_ANIFORMER.pair("val", "seen", 0)
    clip = dataclasses.replace(
        trial,
        clip=dataclasses.replace(trial.clip, vertices=trial.clip.vertices[:2]),
        truth_frames=trial.truth_frames[:2],
        aligned_frames=trial.aligned_frames[:2],
    )
    figures = measure_clip(clip, str(tmp_path / "limp.onnx"))
    assert figures["pmd_e4"] > 0
    assert figures["still_mm"] < 1e-3
    with pytest.raises(InputError, match=r"template of 2100 vertices"):
        transfer(trial.identity, trial.driving, str(tmp_path / "limp.onnx"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("data.vertices=128", r"data\.vertices as model\.vertices"),
        ("data.target_scale=truth", "target_scale: expected identity"),
    ],
)
def test_the_data_must_be_those_of_its_paper(change, message):
    with pytest.raises(InputError, match=message):
        load_config("table", "limp", [change])
