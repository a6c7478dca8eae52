"""Which optimizer moves which parameter, and by how much."""

import dataclasses

import torch

from mimesh.learn.config import TrainConfig
from mimesh.learn.npt import NPT, NPTConfig
from mimesh.learn.optimizers import make_optimizers

CONFIG = TrainConfig(model=NPTConfig(encoder=(8, 16, 16), decoder=(19, 8, 8)), optimizer="muon", learning_rate=1e-2)


def test_every_parameter_has_one_optimizer():
    model = NPT(CONFIG.model)
    for name in ("adam", "muon"):
        optimizers = make_optimizers(model, dataclasses.replace(CONFIG, optimizer=name), torch.device("cpu"))
        held = [id(p) for o in optimizers for group in o.param_groups for p in group["params"]]
        assert sorted(held) == sorted(id(p) for p in model.parameters())


def test_muon_steps_are_orthogonal():
    """All singular values of an update are alike, whatever the gradient's are."""
    model = NPT(CONFIG.model)
    muon, adam = make_optimizers(model, CONFIG, torch.device("cpu"))
    weight = model.encoder[2].weight
    assert any(weight is p for p in muon.param_groups[0]["params"])
    assert any(model.encoder[0].weight is p for p in adam.param_groups[0]["params"])
    before = weight.detach().clone()
    weight.grad = torch.diag(torch.logspace(0, -2, 16))
    muon.step()
    singular = torch.linalg.svdvals(weight.detach() - before)
    assert singular[0] / singular[-1] < 2
