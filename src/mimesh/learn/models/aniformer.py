"""AniFormer (Chen et al., BMVC 2021): give an identity mesh the motion of T driving frames at once.

Section 3.1 and Fig. 2: NPT's pose encoder turns every driving vertex of every frame into features, the frame's temporal
embedding is added (Eq. 1), and four layers follow: a 1x1 convolution, attention (Eq. 2) added with a weight that starts
at zero (Eq. 3), and a SPAdaIN ResBlock of the identity mesh. Driving vertex i is paired with identity vertex i, at
random, and is the same point of the surface in all frames. Departures from the public code:

- InstanceNorm in the encoder and an embedding that all vertices share (the code's need 6,890 vertices in one order).
- Attention across frames. The text attends over the driving *sequence*, the code to the vertices of one frame.
  `attention="both"` is factorised: a vertex attends to itself in the T frames, then to vertices of its own frame.
- Vertices attend to `keys` vertices of their frame, by several heads: V x V products are 73 % of the code's arithmetic.

InstanceNorm removes whatever all vertices of a frame share, so the embedding acts through attention alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, cast

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from .layers import PointConv, ResBlock, instance_norm

Index = Tensor | slice
"""Of vertices that have weights of their own: (B, 1, V), or `EVERY`."""
EVERY = slice(None)
"""All vertices, in their order."""


@dataclass(frozen=True)
class AniFormerConfig:
    """Options of the network; by default the paper's features and the public code's layers (16.9 M parameters)."""

    frames: int = 3
    """T, the driving frames of a window."""
    encoder: tuple[int, int, int] = (64, 128, 1024)
    """Channels of the pose feature extractor, as NPT's."""
    layers: tuple[int, int, int, int] = (1024, 512, 512, 256)
    """Output channels of each layer (the public code's; the paper leaves them to a supplement)."""
    attention: Literal["both", "frames", "vertices", "off"] = "both"
    """What a vertex attends to: itself in all frames, vertices of its frame, or both in that order."""
    heads: int = 4
    """Heads of each attention; they divide the channels of every layer. The public code has 1."""
    scaled: bool = True
    """Divide q k by the square root of a head's channels. Eq. 2 and the public code do not."""
    keys: int = 1024
    """Most vertices of its frame that a vertex attends to: the first ones, a random sample if the order is random."""
    embedding: Literal["learned", "off"] = "learned"
    """E_t of Eq. 1: one learned vector a frame, shared by all vertices."""
    head: Literal["frames", "regression"] = "frames"
    """`regression` is Table 1's vanilla head: features averaged over the frames give one frame, the middle one."""
    order: Literal["norm-conv-relu", "norm-relu-conv"] = "norm-conv-relu"
    """Of a ResBlock's units: as NPT's Table 3, or as the public code."""
    output: Literal["tanh", "2tanh"] = "tanh"
    """`2tanh` is the public code's, whose results may leave the unit sphere."""
    vertices: int = 0
    """As in the public code, the encoder's norms and the embedding have weights for each of so many vertices, which
    every mesh then has in one order; 0: any meshes."""


class VertexAffine(nn.Module):
    """Scale and shift each vertex by its own numbers, the same in all channels: the public code's LayerNorm."""

    def __init__(self, vertices: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(vertices))
        self.shift = nn.Parameter(torch.zeros(vertices))

    def forward(self, h: Float[Tensor, "C B T V"], index: Index) -> Float[Tensor, "C B T V"]:
        return self.scale[index] * h + self.shift[index]


class Attention(nn.Module):
    """Hold what both kinds share: q, k and v as 1x1 convolutions, and the weight gamma, zero at first (Eq. 3)."""

    def __init__(self, channels: int, config: AniFormerConfig) -> None:
        super().__init__()
        assert channels % config.heads == 0, f"{config.heads} heads do not divide {channels} channels"
        self.query, self.key, self.value = (PointConv(channels, channels) for _ in range(3))
        self.gamma = nn.Parameter(torch.zeros(()))
        self.heads = config.heads
        self.scale = (channels // config.heads) ** -0.5 if config.scaled else 1.0


class FrameAttention(Attention):
    """Let each vertex attend to itself in all frames.

    T is small, so the T x T products are element-wise, over the features as they lie in memory.
    """

    def forward(self, h: Float[Tensor, "C B T V"]) -> Float[Tensor, "C B T V"]:
        q, k = self._by_frame(self.query, h), self._by_frame(self.key, h)
        # scores[s, t] is q of frame s times k of frame t, summed over a head's channels: (T, T, H, B, V).
        scores = torch.stack([torch.stack([(here * there).sum(1) for there in k]) for here in q])
        weights = (self.scale * scores.float()).softmax(dim=1).to(h.dtype)
        v = self._by_frame(self.value, h)
        attended = torch.stack([_weighted_sum(row, v) for row in weights], dim=3).flatten(0, 1)
        return h + self.gamma * attended

    def _by_frame(self, conv: PointConv, h: Float[Tensor, "C B T V"]) -> tuple[Float[Tensor, "H D B V"], ...]:
        return by_frame(conv, h).unflatten(0, (self.heads, -1)).unbind(3)


class VertexAttention(Attention):
    """Let each vertex attend to the first `keys` vertices of its own frame; no V x V matrix is stored."""

    def __init__(self, channels: int, config: AniFormerConfig) -> None:
        super().__init__(channels, config)
        self.keys = config.keys

    def forward(self, h: Float[Tensor, "C B T V"]) -> Float[Tensor, "C B T V"]:
        attended_to = h.narrow(3, 0, cast(int, torch.sym_min(h.shape[3], self.keys)))  # in a graph V is a symbol
        q, k, v = (self._by_head(x) for x in (self.query(h), self.key(attended_to), self.value(attended_to)))
        if h.is_cuda:
            attended = F.scaled_dot_product_attention(q, k, v, scale=self.scale)
        else:  # the fused kernel of a CPU takes three times as long as one head's V x `keys` products after another
            heads = zip(q.unbind(1), k.unbind(1), v.unbind(1), strict=True)
            attended = torch.stack([_attend(*head, self.scale) for head in heads], dim=1)
        return h + self.gamma * attended.permute(1, 3, 0, 2).flatten(0, 1).unflatten(1, h.shape[1:3])

    def _by_head(self, h: Float[Tensor, "C B T N"]) -> Float[Tensor, "BT H N D"]:
        """Transpose to the contiguous layout that the fused kernels need."""
        return h.unflatten(0, (self.heads, -1)).flatten(2, 3).permute(2, 0, 3, 1).contiguous()


class Layer(nn.Module):
    """Apply convolution, attention and ResBlock: one layer of the AniFormer encoder (Fig. 2, right)."""

    def __init__(self, channels_in: int, channels: int, config: AniFormerConfig) -> None:
        super().__init__()
        self.conv = PointConv(channels_in, channels)
        self.frames = FrameAttention(channels, config) if config.attention in ("frames", "both") else nn.Identity()
        self.vertices = VertexAttention(channels, config) if config.attention in ("vertices", "both") else nn.Identity()
        self.block = ResBlock(channels, config.order)

    def forward(self, h: Float[Tensor, "C B T V"], identity: Float[Tensor, "3 B 1 V"]) -> Float[Tensor, "D B T V"]:
        h = self.frames(by_frame(self.conv, h))
        return by_frame(lambda frame: self.block(self.vertices(frame), identity), h)


class AniFormer(nn.Module):
    """Map identity and driving frames to the identity in those frames; each mesh centred, in a unit sphere."""

    def __init__(self, config: AniFormerConfig) -> None:
        super().__init__()
        self.config = config
        a, b, code = config.encoder
        self.encoder = nn.ModuleList([PointConv(3, a), PointConv(a, b), PointConv(b, code)])
        self.affine = nn.ModuleList(VertexAffine(config.vertices) for _ in self.encoder if config.vertices)
        # 0.5 is about the standard deviation of the features that it is added to.
        learned = config.embedding == "learned"
        self.embedding = (
            nn.Parameter(0.5 * torch.randn(code, 1, config.frames, config.vertices or 1)) if learned else None
        )
        widths = itertools.pairwise((code, *config.layers))
        self.layers = nn.ModuleList(Layer(i, o, config) for i, o in widths)
        last = config.layers[-1]
        self.mlp = nn.ModuleList(PointConv(last, last) for _ in range(2 if config.head == "regression" else 0))
        self.head = PointConv(last, 3)

    def encode(self, driving: Float[Tensor, "3 B T V"], index: Index = EVERY) -> Float[Tensor, "C B T V"]:
        """Compute the pose features Z_t of every frame, without the embedding."""
        h = driving
        for i, conv in enumerate(self.encoder):
            h = instance_norm(conv(h))
            h = self.affine[i](h, index).relu() if len(self.affine) else h.relu()
        return h

    def forward(
        self,
        identity: Float[Tensor, "B V 3"],
        driving: Float[Tensor, "B T V 3"],
        index: Int[Tensor, "B V"] | None = None,
    ) -> Float[Tensor, "B R V 3"]:
        """Compute the identity in all driving frames (R = T), or in the middle one (`head="regression"`: R = 1).

        Args:
            index: with `AniFormerConfig.vertices`, which of these each mesh has; None: all of them.
        """
        assert driving.shape[1] == self.config.frames, "a window has the frames of the configuration"
        points = identity.permute(2, 0, 1)[:, :, None]
        of_vertex = EVERY if index is None else index[:, None]
        h = by_frame(lambda frames: self.encode(frames, of_vertex), driving.permute(3, 0, 1, 2))
        h = h if self.embedding is None else h + self._embedding_of(index)
        for layer in self.layers:
            h = layer(h, points)
        if self.config.head == "regression":
            h = self._mlp(h.mean(dim=2, keepdim=True))
        bound = 2.0 if self.config.output == "2tanh" else 1.0
        return bound * torch.tanh(self.head(h).float()).permute(1, 2, 3, 0)

    def _embedding_of(self, index: Int[Tensor, "B V"] | None) -> Float[Tensor, "C #B T #V"]:
        """Give E_t, for chosen vertices where it has a vector for each."""
        assert self.embedding is not None
        if index is None or not self.config.vertices:
            return self.embedding
        return self.embedding[:, 0][..., index].transpose(1, 2)

    def _mlp(self, h: Float[Tensor, "C B 1 V"]) -> Float[Tensor, "C B 1 V"]:
        """Apply the MLP block of the regression head."""
        return self.mlp[1](self.mlp[0](h).relu())

    def estimate_flops(self, vertices: int) -> float:
        """Count floating-point operations of a window's forward pass, a driving frame: two for each use of a weight.

        The products of queries with keys and of weights with values are counted; norms and activations are not. A
        training step costs three times as much.
        """
        config, keys = self.config, min(self.config.keys, vertices)
        count = sum(m.weight.numel() for m in self.modules() if isinstance(m, PointConv)) * vertices
        for module in self.modules():
            if isinstance(module, Attention):
                channels = module.query.weight.shape[0]
                count += 2 * channels * vertices * (config.frames if isinstance(module, FrameAttention) else keys)
            if isinstance(module, VertexAttention):
                count -= 2 * module.key.weight.numel() * (vertices - keys)
        if config.head == "regression":
            last = [m for part in (self.mlp, self.head) for m in part.modules() if isinstance(m, PointConv)]
            once = sum(m.weight.numel() for m in last) * vertices
            count -= once * (config.frames - 1) / config.frames
        return 2.0 * count


def by_frame(
    function: Callable[[Float[Tensor, "C B T V"]], Float[Tensor, "D B T V"]], h: Float[Tensor, "C B T V"]
) -> Float[Tensor, "D B T V"]:
    """Apply a function that treats frames alike: to all at once, or in an exported graph one by one, to save memory."""
    if not torch.compiler.is_exporting():
        return function(h)
    return torch.cat([function(frame) for frame in h.split(1, dim=2)], dim=2)


def _attend(
    q: Float[Tensor, "N V D"], k: Float[Tensor, "N K D"], v: Float[Tensor, "N K D"], scale: float
) -> Float[Tensor, "N V D"]:
    return ((scale * q) @ k.transpose(1, 2)).softmax(dim=2, dtype=q.dtype) @ v


def _weighted_sum(
    weights: Float[Tensor, "S H B V"], values: tuple[Float[Tensor, "H D B V"], ...]
) -> Float[Tensor, "H D B V"]:
    total = weights[0][:, None] * values[0]
    for weight, value in zip(weights[1:], values[1:], strict=True):
        total = torch.addcmul(total, weight[:, None], value)
    return total
