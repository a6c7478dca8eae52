"""Our networks give what plain references of the papers' tables give, with the same weights under published names."""

import pytest
import torch
from import_npt_weights import published_names
from paper_networks import (
    NPT_PARAMETERS,
    aniformer,
    aniformer_names,
    aniformer_shapes,
    maxpool_npt,
    npt,
    npt_shapes,
    random_state,
)

from mimesh.learn.aniformer import AniFormer, AniFormerConfig
from mimesh.learn.npt import NPT, NPTConfig

TOLERANCE = {"atol": 1e-5, "rtol": 0.0}
VERTICES = 60


def meshes(*shape: int) -> torch.Tensor:
    torch.manual_seed(1)
    return torch.rand(*shape, 3) * 2 - 1


def filled(model, names, state):
    """Load a state dict of published names into our model, which refuses missing and further tensors."""
    own = model.state_dict()
    tensors = {ours: state[name] for name, ours in names.items()}
    tensors |= {ours: tensor.permute(2, 0, 1, 3) for ours, tensor in tensors.items() if tensor.ndim == 4}  # embedding
    model.load_state_dict({ours: tensor.reshape(own[ours].shape) for ours, tensor in tensors.items()})
    return model.eval()


def public_aniformer(frames, vertices):
    """The configuration of the public code."""
    layout = {"order": "norm-relu-conv", "output": "2tanh", "vertices": vertices}
    return AniFormerConfig(frames=frames, attention="vertices", heads=1, scaled=False, keys=vertices, **layout)


def test_npt_has_the_published_names_shapes_and_count():
    shapes = npt_shapes()
    assert sum(torch.Size(shape).numel() for shape in shapes.values()) == NPT_PARAMETERS
    assert sum(p.numel() for p in NPT(NPTConfig()).parameters()) == NPT_PARAMETERS


@pytest.mark.parametrize(("frames", "count"), [(1, 19_147_391), (3, 33_258_111)])
def test_aniformer_has_the_published_names_shapes_and_count(frames, count):
    shapes = aniformer_shapes(frames)
    assert sum(torch.Size(shape).numel() for shape in shapes.values()) == count
    unused = sum(torch.Size(shapes[name]).numel() for name in shapes.keys() - aniformer_names().keys())
    with torch.device("meta"):
        model = AniFormer(public_aniformer(frames, 6890))
    assert sum(p.numel() for p in model.parameters()) == count - unused


@pytest.mark.parametrize("public", [False, True], ids=["paper", "public"])
@torch.no_grad()
def test_npt_is_table_5(public):
    state = random_state(npt_shapes())
    config = NPTConfig(order="norm-relu-conv", output="2tanh") if public else NPTConfig()
    model = filled(NPT(config), published_names(), state)
    identity, driving = meshes(2, 2, VERTICES)
    expected = npt(state, identity, driving, public)
    assert expected.std() > 0.1
    torch.testing.assert_close(model(identity, driving), expected, **TOLERANCE)


@pytest.mark.parametrize("public", [False, True], ids=["paper", "public"])
@torch.no_grad()
def test_maxpool_variant_is_c2(public):
    state = random_state(npt_shapes())
    code = {"pose_code": "global_max", "unnormalised": "block" if public else "first"}
    config = NPTConfig(**code, order="norm-relu-conv", output="2tanh") if public else NPTConfig(**code)
    model = filled(NPT(config), published_names(), state)
    identity, driving = meshes(2, VERTICES), meshes(2, VERTICES + 20)
    expected = maxpool_npt(state, identity, driving, public)
    assert (expected - npt(state, identity, driving[:, :VERTICES], public)).abs().max() > 0.1
    torch.testing.assert_close(model(identity, driving), expected, **TOLERANCE)


@pytest.mark.slow
@torch.no_grad()
def test_public_aniformer_is_its_layout():
    """In float64: attention by unscaled products over 1,024 channels multiplies the rounding of float32."""
    state = {name: tensor.double() for name, tensor in random_state(aniformer_shapes(3, VERTICES)).items()}
    model = filled(AniFormer(public_aniformer(3, VERTICES)).double(), aniformer_names(), state)
    identity, driving = meshes(2, VERTICES).double(), meshes(2, 3, VERTICES).double()
    expected = aniformer(state, identity, driving, public=True)
    still = {name: 0 * tensor if name.endswith("gamma") else tensor for name, tensor in state.items()}
    assert (expected - aniformer(still, identity, driving, public=True)).abs().max() > 0.1
    torch.testing.assert_close(model(identity, driving).double(), expected, **TOLERANCE)


@pytest.mark.slow
@torch.no_grad()
def test_aniformer_with_frame_attention_is_section_3():
    """The same published names, with one embedding a frame for all vertices, and no norm that knows them."""
    state = {name: tensor.double() for name, tensor in random_state(aniformer_shapes(3, 1)).items()}
    names = {name: ours for name, ours in aniformer_names().items() if ".norm" not in name}
    names = {name: ours.replace(".vertices.", ".frames.") for name, ours in names.items()}
    config = AniFormerConfig(attention="frames", heads=1, scaled=False)
    model = filled(AniFormer(config).double(), names, state)
    identity, driving = meshes(2, VERTICES).double(), meshes(2, 3, VERTICES).double()
    expected = aniformer(state, identity, driving)
    assert (expected - aniformer(state, identity, driving.roll(1, dims=1)).roll(-1, dims=1)).abs().max() > 0.01
    torch.testing.assert_close(model(identity, driving).double(), expected, **TOLERANCE)
