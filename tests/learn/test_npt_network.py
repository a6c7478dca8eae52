"""The network of NPT: size, options, and the properties that its description claims."""

import inspect

import pytest
import torch

from mimesh.learn.layers import PointConv, SPAdaIN, instance_norm
from mimesh.learn.npt import NPT, NPTConfig

TINY = {"encoder": (8, 16, 24), "decoder": (27, 16, 8)}
VARIANTS = [
    {},
    {"pose_code": "global_max"},
    {"pose_code": "global_max", "unnormalised": "block"},
    {"blocks": "conv"},
    {"blocks": "resblock"},
    {"blocks": "conv", "plain_norm": "none"},
    {"blocks": "resblock", "plain_norm": "none"},
    {"blocks": "conv", "pose_code": "global_max"},
    {"order": "norm-relu-conv", "output": "2tanh"},
]


def tiny(**switches) -> NPT:
    torch.manual_seed(0)
    return NPT(NPTConfig(**TINY, **switches)).eval()


def test_size_and_arithmetic_are_the_papers():
    model = NPT(NPTConfig())
    assert sum(p.numel() for p in model.parameters()) == pytest.approx(6.05e6, rel=2e-3)
    assert model.estimate_flops(6890, 6890) == pytest.approx(83e9, rel=0.01)


@pytest.mark.parametrize("switches", VARIANTS)
@torch.no_grad()
def test_shuffling_both_meshes_alike_shuffles_the_result(switches):
    model, order = tiny(**switches), torch.randperm(40)
    identity, driving = torch.rand(2, 2, 40, 3)
    result = model(identity, driving)
    torch.testing.assert_close(model(identity[:, order], driving[:, order]), result[:, order], atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_pooled_code_takes_any_driving_order_and_count():
    model = tiny(pose_code="global_max")
    identity, driving = torch.rand(1, 40, 3), torch.rand(1, 70, 3)
    result = model(identity, driving)
    torch.testing.assert_close(model(identity, driving[:, torch.randperm(70)]), result, atol=1e-5, rtol=1e-5)
    assert result.shape == identity.shape


@pytest.mark.parametrize("switches", VARIANTS)
@torch.no_grad()
def test_driving_pose_reaches_the_result(switches):
    """A norm in the wrong place removes a pooled code; then the driving mesh would not matter."""
    model = tiny(**switches)
    identity, first, second = torch.rand(3, 1, 40, 3)
    assert (model(identity, first) - model(identity, second)).abs().max() > 1e-4


@pytest.mark.parametrize("blocks", ["conv", "resblock"])
@torch.no_grad()
def test_without_any_norm_the_vertices_of_the_decoder_are_independent(blocks):
    identity, driving = torch.rand(2, 1, 40, 3)
    other = identity.clone()
    other[:, 0] += 0.3
    for plain_norm, mixed in (("none", False), ("instance", True)):
        model = tiny(blocks=blocks, plain_norm=plain_norm)
        moved = (model(identity, driving) - model(other, driving))[:, 1:].abs().max()
        assert (moved > 1e-6) == mixed


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_instance_norm_is_equations_1_and_2(dtype):
    h = torch.randn(5, 2, 30, dtype=dtype)
    mean = h.mean(dim=2, keepdim=True)
    sigma = torch.sqrt((h - mean).square().mean(dim=2, keepdim=True) + 1e-5)
    torch.testing.assert_close(instance_norm(h), (h - mean) / sigma, atol=1e-5, rtol=1e-5)


@torch.no_grad()
def test_spadain_is_equation_3():
    layer = SPAdaIN(4)
    h, identity = torch.randn(4, 2, 9), torch.randn(3, 2, 9)
    scale = torch.einsum("dc,cbv->dbv", layer.scale.weight, identity) + layer.scale.bias[:, None, None]
    shift = torch.einsum("dc,cbv->dbv", layer.shift.weight, identity) + layer.shift.bias[:, None, None]
    torch.testing.assert_close(layer(h, identity), scale * instance_norm(h) + shift, atol=1e-5, rtol=1e-5)


def test_every_weight_has_a_gradient():
    for switches in VARIANTS:
        model = tiny(**switches)
        model(*torch.rand(2, 2, 12, 3)).square().sum().backward()
        silent = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.abs().any()]
        # A bias before InstanceNorm cannot matter; everything else must.
        assert all(name.endswith("bias") for name in silent), silent


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")  # PyTorch's own, where it compiles
@pytest.mark.parametrize("channels", [(3, 8), (8, 3)])
def test_maps_of_coordinates_are_the_same_when_compiled(channels: tuple[int, int]):
    """A compiled step computes them in another way."""
    torch.manual_seed(0)
    conv, h = PointConv(*channels), torch.randn(channels[0], 2, 5, requires_grad=True)
    # Checks of types at run time cannot be compiled.
    (torch.compile(inspect.unwrap(PointConv.forward))(conv, h).square().sum()).backward()
    compiled = [h.grad, conv.weight.grad, conv.bias.grad]
    h.grad = conv.weight.grad = conv.bias.grad = None
    conv(h).square().sum().backward()
    for there, here in zip(compiled, [h.grad, conv.weight.grad, conv.bias.grad], strict=True):
        assert torch.allclose(there, here, atol=1e-5)
