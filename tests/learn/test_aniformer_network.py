"""The network of AniFormer: size, options, and what attends to what."""

import math

import numpy as np
import pytest
import torch
from networks import infer_onnx
from torch.nn import functional

from mimesh.learn.aniformer import AniFormer, AniFormerConfig, AniFormerTask, Attention, FrameAttention, VertexAttention
from mimesh.learn.export import compress, to_onnx
from mimesh.methods.onnx_runtime import import_onnxruntime

TINY = {"encoder": (8, 16, 24), "layers": (16, 8), "heads": 2}
VARIANTS = [
    {},
    {"attention": "frames"},
    {"attention": "vertices"},
    {"attention": "off"},
    {"scaled": False, "heads": 1},
    {"embedding": "off"},
    {"head": "regression"},
    {"order": "norm-relu-conv", "output": "2tanh"},
]
PUBLIC_GFLOP = 603
"""A frame of 6,890 vertices by the public code: one head over all vertices of the frame."""


def tiny(gamma: float | None = 1.0, **switches) -> AniFormer:
    """A small model whose attention counts; `gamma=None` leaves it as it starts."""
    torch.manual_seed(0)
    model = AniFormer(AniFormerConfig(**TINY | switches)).eval()
    for module in model.modules():
        if isinstance(module, Attention) and gamma is not None:
            module.gamma.data.fill_(gamma)
    return model


def clip(batch: int = 2, vertices: int = 40, frames: int = 3):
    torch.manual_seed(1)
    return torch.rand(batch, vertices, 3) * 2 - 1, torch.rand(batch, frames, vertices, 3) * 2 - 1


def paper(**switches) -> AniFormer:
    with torch.device("meta"):
        return AniFormer(AniFormerConfig(**switches))


@pytest.mark.slow
def test_size_is_the_papers():
    assert sum(p.numel() for p in paper().parameters()) == pytest.approx(16.93e6, rel=1e-3)
    assert sum(p.numel() for p in paper(attention="vertices").parameters()) == pytest.approx(12.01e6, rel=1e-3)


@pytest.mark.parametrize(
    ("switches", "ratio"),
    [
        ({"attention": "vertices", "keys": 6890}, 1.0),
        ({"attention": "vertices"}, 0.318),
        ({"attention": "frames"}, 0.274),
        ({"attention": "off"}, 0.161),
        ({}, 0.430),
        ({"head": "regression"}, 0.431),
    ],
)
def test_arithmetic_beside_the_public_code(switches, ratio):
    assert paper(**switches).estimate_flops(6890) / (PUBLIC_GFLOP * 1e9) == pytest.approx(ratio, abs=2e-3)


@pytest.mark.parametrize("switches", VARIANTS)
def test_results_have_a_shape_and_a_range_and_depend_on_no_order_and_on_no_other_sample(switches):
    """The order is exact in real numbers as long as every vertex is a key. Half precision is near."""
    model, order, (identity, driving) = tiny(**switches), torch.randperm(40), clip(3)
    with torch.no_grad():
        result = model(identity, driving)
        shuffled = model(identity[:, order], driving[:, :, order])
        single = model(identity[1:2], driving[1:2])
    assert result.shape == (3, 1 if switches.get("head") == "regression" else 3, 40, 3)
    assert result.abs().max() < (2 if switches.get("output") == "2tanh" else 1)
    torch.testing.assert_close(shuffled, result[:, :, order], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(single, result[1:2], atol=1e-5, rtol=1e-5)
    with torch.autocast("cpu", torch.bfloat16):
        half = model(identity, driving)
    assert result.dtype == half.dtype == torch.float32
    assert (half.detach() - result).abs().max() < 0.1
    half.square().sum().backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in model.parameters())


@torch.no_grad()
def test_attention_contributes_nothing_at_the_start():
    model, given = tiny(gamma=None), clip()
    before = model(*given)
    for module in model.modules():
        if isinstance(module, Attention):
            assert module.gamma == 0
            module.value.weight.fill_(7.0)
            module.query.weight.fill_(-3.0)
    assert torch.equal(model(*given), before)


@torch.no_grad()
def test_with_fewer_keys_the_order_of_the_others_does_not_matter():
    model, (identity, driving) = tiny(keys=10), clip()
    order = torch.cat([torch.arange(10), 10 + torch.randperm(30)])
    result = model(identity, driving)
    shuffled = model(identity[:, order], driving[:, :, order])
    torch.testing.assert_close(shuffled, result[:, :, order], atol=1e-5, rtol=1e-5)
    assert (model(identity.flip(1), driving.flip(2)).flip(2) - result).abs().max() > 1e-5


@pytest.mark.parametrize(
    ("attention", "mixed"), [("both", True), ("frames", True), ("vertices", False), ("off", False)]
)
@torch.no_grad()
def test_frames_are_mixed_by_attention_over_frames_only(attention, mixed):
    model, (identity, driving) = tiny(attention=attention), clip()
    other = driving.clone()
    other[:, 2] += 0.3 * torch.randn(other[:, 2].shape)
    change = (model(identity, driving) - model(identity, other)).abs().amax(dim=(0, 2, 3))
    assert (change[:2] > 1e-5).all() == mixed
    assert mixed or (change[:2] == 0).all()
    assert change[2] > 1e-3


@torch.no_grad()
def test_the_embedding_distinguishes_frames_of_a_still_clip():
    identity, driving = clip()
    still = driving[:, :1].expand_as(driving)
    for embedding, distinct in (("learned", True), ("off", False)):
        result = tiny(embedding=embedding)(identity, still)
        assert ((result - result[:, :1]).abs().max() > 1e-4) == distinct
    unattended = tiny(gamma=None)(identity, still)
    assert (unattended - unattended[:, :1]).abs().max() < 1e-5, "InstanceNorm removes it without attention"


@torch.no_grad()
def test_frame_attention_is_equations_2_and_3():
    """Naive twin: token by token, for one head and two."""
    for heads in (1, 2):
        layer = FrameAttention(4, AniFormerConfig(heads=heads))
        layer.gamma.fill_(0.7)
        h, expected = torch.randn(4, 2, 3, 5), torch.empty(4, 2, 3, 5)
        for b in range(2):
            for i in range(5):
                expected[:, b, :, i] = h[:, b, :, i] + 0.7 * attended(layer, h[:, b, :, i], h[:, b, :, i])
        torch.testing.assert_close(layer(h), expected)


@torch.no_grad()
def test_vertex_attention_is_equations_2_and_3():
    for heads, keys, scaled in ((1, 9, False), (2, 9, True), (2, 3, True)):
        layer = VertexAttention(4, AniFormerConfig(heads=heads, keys=keys, scaled=scaled))
        layer.gamma.fill_(0.7)
        h, expected = torch.randn(4, 2, 3, 5), torch.empty(4, 2, 3, 5)
        for b in range(2):
            for t in range(3):
                expected[:, b, t] = h[:, b, t] + 0.7 * attended(layer, h[:, b, t], h[:, b, t, :keys])
        torch.testing.assert_close(layer(h), expected)


def attended(layer: Attention, tokens: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Sum over attended tokens j of softmax_j(q_i k_j / scale) v_j, head by head; tokens are columns."""
    q, k, v = (
        conv.weight @ x + conv.bias[:, None]
        for conv, x in ((layer.query, tokens), (layer.key, others), (layer.value, others))
    )
    parts = []
    for one_q, one_k, one_v in zip(*(x.chunk(layer.heads) for x in (q, k, v)), strict=True):
        size = math.sqrt(len(one_q)) if layer.scale != 1.0 else 1.0
        parts.append(one_v @ functional.softmax(one_q.T @ one_k / size, dim=1).T)
    return torch.cat(parts)


def test_every_weight_has_a_gradient():
    for switches in VARIANTS:
        model = tiny(**switches)
        model(*clip(2, 12)).square().sum().backward()
        silent = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.abs().any()]
        # A bias before InstanceNorm or of a key cannot matter; everything else must.
        assert all(name.endswith("bias") for name in silent), silent


KEYS = 32


@pytest.fixture(scope="module")
def in_onnx():
    """The exporter takes ten seconds for each layer; test_torch_session.py has a network with the other head."""
    model = tiny(keys=KEYS, frames=2, layers=(8,))
    return model, to_onnx(AniFormerTask.onnx_interface(model))


@pytest.mark.slow
@torch.no_grad()
def test_onnx_gives_what_torch_gives_with_fewer_and_more_vertices_than_keys(in_onnx):
    model, network = in_onnx
    half = compress(network)
    for vertices in (2, KEYS - 1, KEYS, KEYS + 1, 400):
        identity, driving = clip(1, vertices, model.config.frames)
        expected = model(identity, driving).numpy()
        assert np.abs(infer_onnx(network, identity.numpy(), driving.numpy()) - expected).max() < 1e-4
        assert np.abs(infer_onnx(half, identity.numpy(), driving.numpy()) - expected).max() < 5e-2


@pytest.mark.slow
def test_the_graph_stores_nothing_larger_than_all_features_or_the_products_of_one_head(in_onnx):
    """Run with every intermediate as an output and look at the sizes themselves."""
    onnxruntime = import_onnxruntime()

    model, network = in_onnx
    vertices, frames, widest = 3000, model.config.frames, max(*model.config.encoder, *model.config.layers)
    watched = type(network).FromString(network.SerializeToString())
    names = {name for node in watched.graph.node for name in node.output} - {o.name for o in watched.graph.output}
    watched.graph.output.extend(type(watched.graph.output[0])(name=name) for name in sorted(names))
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = onnxruntime.InferenceSession(watched.SerializeToString(), options, providers=["CPUExecutionProvider"])
    identity, driving = (x.numpy() for x in clip(1, vertices, frames))
    found = session.run(None, {"identity": identity, "driving": driving})
    largest = max(np.size(array) for array in found)
    assert largest <= max(widest * frames, KEYS) * vertices
