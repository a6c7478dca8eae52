"""Which optimizer moves which parameter, and by how much."""

import dataclasses

import pytest
import torch

from mimesh.learn.npt import NPT, NPTConfig, NPTTrainConfig
from mimesh.learn.optimizers import Muon, make_optimizers, orthogonalize

CONFIG = NPTTrainConfig(model=NPTConfig(encoder=(8, 16, 16), decoder=(19, 8, 8)), optimizer="muon", learning_rate=1e-2)


def test_every_parameter_has_one_optimizer():
    model = NPT(CONFIG.model)
    for name in ("adam", "muon"):
        optimizers = make_optimizers(
            model, dataclasses.replace(CONFIG, optimizer=name), torch.device("cpu"), torch.float32
        )
        held = [id(p) for o in optimizers for group in o.param_groups for p in group["params"]]
        assert sorted(held) == sorted(id(p) for p in model.parameters())


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_muon_steps_are_orthogonal(dtype):
    """All singular values of an update are alike, whatever the gradient's are."""
    model = NPT(CONFIG.model)
    muon, adam = make_optimizers(model, CONFIG, torch.device("cpu"), dtype)
    weight = model.encoder[2].weight
    assert any(weight is p for p in muon.param_groups[0]["params"])
    assert any(model.encoder[0].weight is p for p in adam.param_groups[0]["params"])
    before = weight.detach().clone()
    weight.grad = torch.diag(torch.logspace(0, -2, 16))
    muon.step()
    singular = torch.linalg.svdvals(weight.detach() - before)
    assert singular[0] / singular[-1] < 2


@pytest.mark.parametrize("weight_decay", [0.0, 0.1])
def test_muon_in_bf16_is_torchs(weight_decay):
    """Same weights after steps on square, wide and tall matrices, and the same names and values in the state."""
    torch.manual_seed(0)
    start = [torch.randn(shape) for shape in ((16, 16), (8, 40), (40, 8))]
    ours, theirs = ([torch.nn.Parameter(m.clone()) for m in start] for _ in range(2))
    options = {"lr": 1e-2, "weight_decay": weight_decay}
    muon = Muon(ours, **options, dtype=torch.bfloat16)
    reference = torch.optim.Muon(theirs, **options, adjust_lr_fn="match_rms_adamw")
    for _ in range(5):
        for a, b in zip(ours, theirs, strict=True):
            a.grad = torch.randn_like(a)
            b.grad = a.grad.clone()
        muon.step()
        reference.step()
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6)
    state, expected = (optimizer.state_dict()["state"] for optimizer in (muon, reference))
    for index, fields in expected.items():
        assert set(state[index]) == set(fields)
        torch.testing.assert_close(state[index]["momentum_buffer"], fields["momentum_buffer"], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shape", [(30, 30), (12, 50), (50, 12)])
def test_orthogonalizing_keeps_singular_vectors_and_evens_values(shape):
    torch.manual_seed(0)
    u, _, v = torch.linalg.svd(torch.randn(shape), full_matrices=False)
    values = torch.linspace(0.2, 3.0, min(shape))
    result, other = orthogonalize(torch.stack([(u * values) @ v, torch.randn(shape)]), torch.float32)
    assert not torch.equal(result, other)
    mixed = u.T @ result @ v.T
    assert (mixed - mixed.diag().diag()).abs().max() < 1e-4
    assert ((mixed.diag() > 0.6) & (mixed.diag() < 1.3)).all()
