"""The network of NPT: size, options, and the properties that its description claims."""

import inspect

import pytest
import torch

from mimesh.learn.layers import PointConv
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


def test_the_arithmetic_is_the_papers():
    assert NPT(NPTConfig()).estimate_flops(6890, 6890) == pytest.approx(83e9, rel=0.01)


@pytest.mark.parametrize("switches", VARIANTS)
def test_results_depend_on_the_pose_on_every_weight_and_on_no_order(switches):
    """A norm in the wrong place removes a pooled code; then the driving mesh would not matter."""
    model, order = tiny(**switches), torch.randperm(40)
    identity, driving, other = torch.rand(3, 2, 40, 3)
    result = model(identity, driving)
    shuffled = model(identity[:, order], driving[:, order])
    torch.testing.assert_close(shuffled, result[:, order], atol=1e-5, rtol=1e-5)
    assert (result - model(identity, other)).abs().max() > 1e-4
    result.square().sum().backward()
    silent = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.abs().any()]
    # A bias before InstanceNorm cannot matter; everything else must.
    assert all(name.endswith("bias") for name in silent), silent


@torch.no_grad()
def test_pooled_code_takes_any_driving_order_and_count():
    model = tiny(pose_code="global_max")
    identity, driving = torch.rand(1, 40, 3), torch.rand(1, 70, 3)
    result = model(identity, driving)
    torch.testing.assert_close(model(identity, driving[:, torch.randperm(70)]), result, atol=1e-5, rtol=1e-5)
    assert result.shape == identity.shape


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
