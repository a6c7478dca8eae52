"""NPT, its max-pool variant and AniFormer as the papers' tables and equations have them, with published weight names.

Plain functions over a state dict, written from the tables alone: nothing of `mimesh.learn` is imported. Features are
(N, C, V), as in the tables. Where the public code differs from the paper, an argument says which is followed.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

EPSILON = 1e-5
"""NPT 3.3."""
NPT_PARAMETERS = 6_054_941
"""Of the published NPT and of its max-pool variant."""
UNITS = (("spadain1", "conv1"), ("spadain2", "conv2"), ("spadain_res", "conv_res"))
"""Published names of a ResBlock's SPAdaIN and convolution (NPT Table 3: rows 3 and 4, 5 and 6, 7 and 8)."""
State = dict[str, Tensor]


def convolution_shapes(name: str, channels_in: int, channels: int) -> dict[str, tuple[int, ...]]:
    """Shapes of a 1x1 convolution's tensors."""
    return {f"{name}.weight": (channels, channels_in, 1), f"{name}.bias": (channels,)}


def block_shapes(name: str, channels: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the tensors of a SPAdaIN ResBlock (NPT Tables 3 and 4)."""
    shapes = {}
    for spadain, conv in UNITS:
        shapes |= convolution_shapes(f"{name}.{spadain}.conv_weight", 3, channels)
        shapes |= convolution_shapes(f"{name}.{spadain}.conv_bias", 3, channels)
        shapes |= convolution_shapes(f"{name}.{conv}", channels, channels)
    return shapes


def npt_shapes() -> dict[str, tuple[int, ...]]:
    """Names and shapes of the published weights of NPT (NPT Table 5); those of the max-pool variant are the same."""
    shapes = convolution_shapes("encoder.conv1", 3, 64)  # row 3
    shapes |= convolution_shapes("encoder.conv2", 64, 128)  # row 5
    shapes |= convolution_shapes("encoder.conv3", 128, 1024)  # row 7
    shapes |= convolution_shapes("decoder.conv1", 1027, 1027)  # row 10
    shapes |= block_shapes("decoder.spadain_block1", 1027)  # row 11
    shapes |= convolution_shapes("decoder.conv2", 1027, 513)  # row 12
    shapes |= block_shapes("decoder.spadain_block2", 513)  # row 13
    shapes |= convolution_shapes("decoder.conv3", 513, 256)  # row 14
    shapes |= block_shapes("decoder.spadain_block3", 256)  # row 15
    return shapes | convolution_shapes("decoder.conv4", 256, 3)  # row 16


def aniformer_names() -> dict[str, str]:
    """Published names of AniFormer's tensors -> those of `mimesh.learn.aniformer`; without `decoder.norm*`."""
    parts = {f"encoder.conv{i + 1}": f"encoder.{i}" for i in range(3)} | {"decoder.conv5": "head"}
    names = {"Temporal_pos_embed": "embedding"}
    for i in range(4):
        attention, block, ours = f"decoder.att_block{i + 1}", f"decoder.spadain_block{i + 1}", f"layers.{i}"
        parts |= {f"decoder.conv{i + 1}": f"{ours}.conv"}
        parts |= {f"{attention}.{name}_conv": f"{ours}.vertices.{name}" for name in ("query", "key", "value")}
        names[f"{attention}.gamma"] = f"{ours}.vertices.gamma"
        for (spadain, conv), unit in zip(UNITS, ("first", "second", "shortcut"), strict=True):
            parts[f"{block}.{spadain}.conv_weight"] = f"{ours}.block.{unit}.norm.scale"
            parts[f"{block}.{spadain}.conv_bias"] = f"{ours}.block.{unit}.norm.shift"
            parts[f"{block}.{conv}"] = f"{ours}.block.{unit}.conv"
    for i in range(3):
        names |= {f"encoder.norm{i + 1}.weight": f"affine.{i}.scale", f"encoder.norm{i + 1}.bias": f"affine.{i}.shift"}
    return names | {f"{name}.{end}": f"{ours}.{end}" for name, ours in parts.items() for end in ("weight", "bias")}


def aniformer_shapes(frames: int = 3, vertices: int = 6890) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the published weights of AniFormer; `decoder.norm*` have no part in its output."""
    shapes = {"Temporal_pos_embed": (1, frames, 1024, vertices)}
    for part in ("encoder", "decoder"):
        for index in (1, 2, 3):
            shapes |= {f"{part}.norm{index}.{kind}": (vertices,) for kind in ("weight", "bias")}
    for index, (channels_in, channels) in enumerate(((3, 64), (64, 128), (128, 1024)), start=1):
        shapes |= convolution_shapes(f"encoder.conv{index}", channels_in, channels)
    for index, (channels_in, channels) in enumerate(((1024, 1024), (1024, 512), (512, 512), (512, 256)), start=1):
        shapes |= convolution_shapes(f"decoder.conv{index}", channels_in, channels)
        for kind in ("query", "key", "value"):
            shapes |= convolution_shapes(f"decoder.att_block{index}.{kind}_conv", channels, channels)
        shapes[f"decoder.att_block{index}.gamma"] = (1,)
        shapes |= block_shapes(f"decoder.spadain_block{index}", channels)
    return shapes | convolution_shapes("decoder.conv5", 256, 3)


def random_state(shapes: dict[str, tuple[int, ...]], seed: int = 0) -> State:
    """Draw weights: those of a convolution as PyTorch begins with them, the others with an effect on the output."""
    generator = torch.Generator().manual_seed(seed)
    state = {}
    for name, shape in shapes.items():
        values = torch.rand(shape, generator=generator) * 2 - 1
        if name.endswith(".bias") and (weight := shapes[name.removesuffix("bias") + "weight"]) != shape:
            state[name] = values / math.sqrt(weight[1])
        elif len(shape) == 3:
            state[name] = values / math.sqrt(shape[1])
        else:  # a gamma, an embedding, and the scale and shift of a LayerNorm
            state[name] = 0.5 * values + float(name.endswith(("gamma", ".weight")))
    return state


def convolve(state: State, name: str, h: Tensor) -> Tensor:
    """Apply a 1x1 convolution: conv1d(C -> D, 1x1)."""
    return torch.einsum("dc,ncv->ndv", state[f"{name}.weight"][:, :, 0], h) + state[f"{name}.bias"][:, None]


def normalise(h: Tensor) -> Tensor:
    """Instance norm (NPT Eq. 1 and 2)."""
    mean = h.sum(dim=2, keepdim=True) / h.shape[2]
    sigma = torch.sqrt(((h - mean) ** 2).sum(dim=2, keepdim=True) / h.shape[2] + EPSILON)
    return (h - mean) / sigma


def spadain(state: State, name: str, h: Tensor, identity: Tensor, normalised: bool = True) -> Tensor:
    """SPAdaIN (NPT Eq. 3, Table 4: rows 3 and 4 the convolutions, 5 the norm, 6 and 7 product and sum)."""
    gamma = convolve(state, f"{name}.conv_weight", identity)
    beta = convolve(state, f"{name}.conv_bias", identity)
    return gamma * (normalise(h) if normalised else h) + beta


def res_block(
    state: State, name: str, h: Tensor, identity: Tensor, public: bool, normalised: tuple[bool, ...] = (True,) * 3
) -> Tensor:
    """SPAdaIN ResBlock (NPT Table 3, whose row 9 is read as the sum of rows 6 and 8).

    `public` has ReLU before each convolution, the table has it behind.
    """

    def unit(index: int, features: Tensor) -> Tensor:
        norm, conv = UNITS[index]
        modulated = spadain(state, f"{name}.{norm}", features, identity, normalised[index])
        if public:
            return convolve(state, f"{name}.{conv}", torch.clamp(modulated, min=0))
        return torch.clamp(convolve(state, f"{name}.{conv}", modulated), min=0)

    row_6 = unit(1, unit(0, h))
    row_8 = unit(2, h)
    return row_6 + row_8


def pose_features(state: State, driving: Tensor, layer_norm: bool = False) -> Tensor:
    """NPT Table 5, rows 3 to 8. `layer_norm`: each norm with a scale and a shift a vertex, as AniFormer's code has."""
    h = driving
    for index in (1, 2, 3):
        h = normalise(convolve(state, f"encoder.conv{index}", h))
        if layer_norm:
            h = h * state[f"encoder.norm{index}.weight"] + state[f"encoder.norm{index}.bias"]
        h = torch.clamp(h, min=0)
    return h


def npt(
    state: State,
    identity: Tensor,
    driving: Tensor,
    public: bool = False,
    pooled: bool = False,
    unnormalised: tuple[int, ...] = (),
) -> Tensor:
    """NPT Table 5 for meshes (N, V, 3). `public` is the public code's reading; `unnormalised`: see `maxpool_norms`."""
    identity, driving = identity.transpose(1, 2), driving.transpose(1, 2)
    code = pose_features(state, driving)
    if pooled:  # NPT C.2
        code = code.amax(dim=2, keepdim=True).repeat(1, 1, identity.shape[2])
    h = torch.cat([code, identity], dim=1)  # row 9
    for index in (1, 2, 3):  # rows 10 to 15
        h = convolve(state, f"decoder.conv{index}", h)
        normalised = tuple(index > 1 or unit not in unnormalised for unit in range(3))
        h = res_block(state, f"decoder.spadain_block{index}", h, identity, public, normalised)
    result = torch.tanh(convolve(state, "decoder.conv4", h))  # rows 16 and 17
    return ((2 if public else 1) * result).transpose(1, 2)


def maxpool_npt(state: State, identity: Tensor, driving: Tensor, public: bool = False) -> Tensor:
    """NPT C.2: one code for the driving mesh, and the decoder without its first instance norm.

    The pooled code reaches the first unit and the shortcut of block 1, whose norms are left out; the public code leaves
    out all three of block 1.
    """
    return npt(state, identity, driving, public, pooled=True, unnormalised=(0, 1, 2) if public else (0, 2))


def attend(state: State, name: str, z: Tensor) -> Tensor:
    """AniFormer Eq. 2 and 3, one head without scaling, for tokens (N, C, tokens).

    Eq. 2 is read as every transformer has it: weights of one query sum to 1 over the keys.
    """
    q, k, v = (convolve(state, f"{name}.{kind}_conv", z) for kind in ("query", "key", "value"))
    energy = torch.einsum("nci,ncj->nij", q, k)
    energy = torch.exp(energy - energy.amax(dim=2, keepdim=True))
    weights = energy / energy.sum(dim=2, keepdim=True)
    return state[f"{name}.gamma"] * torch.einsum("nij,ncj->nci", weights, v) + z


def aniformer(state: State, identity: Tensor, driving: Tensor, public: bool = False) -> Tensor:
    """AniFormer 3.1 for an identity (N, V, 3) and a clip (N, T, V, 3); a frame's embedding may be one for all vertices.

    `public`: LayerNorm in the encoder, vertices that attend to those of their own frame, ReLU before the convolutions
    and 2 tanh. Else as the text: InstanceNorm, a vertex attends to itself in all frames, Table 3's order and tanh.
    """
    n, frames, count, _ = driving.shape
    points = driving.permute(0, 1, 3, 2)
    target = identity.transpose(1, 2).repeat_interleave(frames, dim=0)
    z = pose_features(state, points.flatten(0, 1), layer_norm=public)
    z = (z.unflatten(0, (n, frames)) + state["Temporal_pos_embed"]).flatten(0, 1)  # Eq. 1
    for index in (1, 2, 3, 4):
        z = convolve(state, f"decoder.conv{index}", z)
        if not public:  # tokens of one vertex are its T frames: (N V, C, T)
            z = z.unflatten(0, (n, frames)).permute(0, 3, 2, 1).flatten(0, 1)
        z = attend(state, f"decoder.att_block{index}", z)
        if not public:
            z = z.unflatten(0, (n, count)).permute(0, 3, 2, 1).flatten(0, 1)
        z = res_block(state, f"decoder.spadain_block{index}", z, target, public)
    result = (2 if public else 1) * torch.tanh(convolve(state, "decoder.conv5", z))
    return result.unflatten(0, (n, frames)).transpose(2, 3)
