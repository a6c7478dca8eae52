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

Training takes windows of T frames and the loss of Eq. 6. Every frame of driving and truth is centred on its own
bounding box; driving frames are each in their own unit sphere. Where a result stands is not learned: it follows from
the driving's path afterwards. Losses are one function per equation. As printed Eq. 4 and Eq. 5 are signed differences:
the first has no lower bound (and telescopes, so only the first and the last step of a clip enter), the second is
smallest where the mesh is one point. With absolute values both are zero on sets that hold more than the truth, so
neither may stand alone (see each function for what it is zero on).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, cast

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from ..core.errors import InputError
from ..evaluate.clip_protocols import FRAMES, ClipPair
from ..evaluate.pairs import Pair
from . import layers
from .data.bodies import numbers_of_step
from .data.endless import PeopleOptions
from .data.people import BodySampler
from .data.registered import MeshOptions, MeshWindowSource, WindowBatch
from .layers import PointConv, ResBlock, edge_vectors, instance_norm, match_frames, mean_squared_distance
from .task import OnnxInterface, TrainConfig
from .validation import PaperTask, clip_error, pair_error

Index = Tensor | slice
"""Of vertices that have weights of their own: (B, 1, V), or `EVERY`."""
EVERY = slice(None)
"""All vertices, in their order."""
MIN_STEP = 1e-6
"""Least mean square step of a driving frame that Eq. 4 divides by (unit sphere: 1e-3 of the radius a frame)."""


@dataclass(frozen=True)
class AniFormerConfig:
    """Options of the network; by default the paper's features and the public code's layers (16.9 M parameters)."""

    frames: int = 3
    """T, the driving frames of a window."""
    encoder: tuple[int, int, int] = (64, 128, 1024)
    """Channels of the pose feature extractor, as NPT's."""
    layers: tuple[int, ...] = (1024, 512, 512, 256)
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


@dataclass(frozen=True)
class AniFormerData(PeopleOptions, MeshOptions):
    """What AniFormer is trained on: windows of its motions, of endless people's, or of registered clips."""

    kind: Literal["clips80", "clips", "meshes"] = "clips80"
    """`clips80`: 16 people x 80 motions of 30 frames. `clips`: endless people and motions. `meshes`: registered clips
    of a folder."""
    animal_kinds: ClassVar[tuple[str, ...]] = ("clips", "meshes")


@dataclass(frozen=True)
class ClipLossConfig:
    """Terms of Eq. 6 beside the reconstruction; the largest weights that cost nothing on `val` (docs/log/papers.md)."""

    motion: Literal["paper", "velocity", "off"] = "paper"
    motion_weight: float = 1e-3
    appearance: Literal["paper", "ratio", "off"] = "paper"
    appearance_weight: float = 1e-2


@dataclass(frozen=True)
class AniFormerTrainConfig(TrainConfig):
    """The configuration of an AniFormer training."""

    network: Literal["aniformer"] = "aniformer"
    model: AniFormerConfig = field(default_factory=AniFormerConfig)
    data: AniFormerData = field(default_factory=AniFormerData)
    losses: ClipLossConfig = field(default_factory=ClipLossConfig)

    @property
    def window(self) -> int:
        """T: the frames of a clip that the network takes at once."""
        return self.model.frames

    def check(self, where: str) -> None:
        """Raise InputError for windows that cannot be cut, attended to or compared."""
        super().check(where)
        model = self.model
        if not 1 <= model.frames <= FRAMES:
            raise InputError(f"{where}, frames: expected 1 to {FRAMES}, found {model.frames}")
        if model.vertices and self.data.pairing != "order":
            raise InputError(
                f"{where}: expected data.pairing order with model.vertices, found {self.data.pairing}; weights of a "
                "vertex need meshes in one order"
            )
        if not model.layers:
            raise InputError(f"{where}, layers: expected the channels of one layer or more, found none")
        undivided = [width for width in model.layers if model.heads < 1 or width % model.heads]
        if undivided and model.attention != "off":
            raise InputError(f"{where}: expected heads that divide every layer, found {model.heads} for {undivided[0]}")
        frames = 1 if model.head == "regression" else model.frames
        least = {"off": 1, "velocity": 2, "paper": 3}[self.losses.motion]
        if frames < least:
            raise InputError(
                f"{where}: expected results of {least} frames or more for losses.motion "
                f"{self.losses.motion}, found {frames}; set losses.motion to off"
            )


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
        q, k, v = (
            x.unflatten(0, (self.heads, -1)).flatten(2, 3).permute(2, 0, 3, 1).contiguous()
            for x in (self.query(h), self.key(attended_to), self.value(attended_to))
        )
        if h.is_cuda:
            attended = F.scaled_dot_product_attention(q, k, v, scale=self.scale)
        else:  # the fused kernel of a CPU takes three times as long as one head's V x `keys` products after another
            heads = zip(q.unbind(1), k.unbind(1), v.unbind(1), strict=True)
            attended = torch.stack([_attend(*head, self.scale) for head in heads], dim=1)
        return h + self.gamma * attended.permute(1, 3, 0, 2).flatten(0, 1).unflatten(1, h.shape[1:3])


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
            h = self.mlp[1](self.mlp[0](h.mean(dim=2, keepdim=True)).relu())
        bound = 2.0 if self.config.output == "2tanh" else 1.0
        return bound * torch.tanh(self.head(h).float()).permute(1, 2, 3, 0)

    def _embedding_of(self, index: Int[Tensor, "B V"] | None) -> Float[Tensor, "C #B T #V"]:
        """Give E_t, for chosen vertices where it has a vector for each."""
        assert self.embedding is not None
        if index is None or not self.config.vertices:
            return self.embedding
        return self.embedding[:, 0][..., index].transpose(1, 2)

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


class WindowSource(BodySampler):
    """Makes batches of windows of one length."""

    def batch(self, size: int, step: int) -> WindowBatch:
        rng = numbers_of_step(self.seed, step, self.device)
        (identity_shape, driving_shape), identity_pose, poses = self.people.windows(size, rng)
        index, driving_index, edges, share = self._sample_vertices(size, rng)
        identity, radius = self._normalized_mesh(identity_shape, identity_pose, index)
        scale = radius if self.config.target_scale == "identity" else None
        driving, _ = self._normalized_window(driving_shape, poses, driving_index)
        truth, radii = self._normalized_window(identity_shape, poses, index, scale)
        self._reflect(rng, identity, driving, truth)
        divisor = radii if scale is None else radius[:, :, 0].expand_as(radii)
        return WindowBatch(identity, driving, truth, divisor / radius[:, :, 0], radii / divisor, index, edges, share)

    def _normalized_window(
        self,
        shape: Float[Tensor, "B K"],
        rotmat: Float[Tensor, "B T J 3 3"],
        index: Int[Tensor, "B N"],
        radius: Float[Tensor, "B 1 1"] | None = None,
    ) -> tuple[Float[Tensor, "B T N 3"], Float[Tensor, "B T"]]:
        """Pose people and give chosen vertices of every frame, centred and divided by a radius, and their own radii."""
        frames = rotmat.shape[1]
        shape, index = (x.repeat_interleave(frames, dim=0) for x in (shape, index))
        scale = None if radius is None else radius.repeat_interleave(frames, dim=0)
        points, radii = self._normalized_mesh(shape, rotmat.flatten(0, 1), index, scale)
        return points.unflatten(0, (-1, frames)), radii.view(-1, frames)


def reconstruction(result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"]) -> Float[Tensor, ""]:
    """Compute L_r of Eq. 6: squared distance to the truth, summed over vertices, mean over frames."""
    return layers.reconstruction(result.flatten(0, 1), truth.flatten(0, 1))


def motion_paper(result: Float[Tensor, "B T V 3"], driving: Float[Tensor, "B T U 3"]) -> Float[Tensor, ""]:
    """Compute Eq. 4 with absolute values: the ratio of the result's speed to the driving's should not change.

    Zero for the driving itself in any size and place, for a static result, and wherever the two speeds are
    proportional. A driving step below `MIN_STEP` counts as that.
    """
    assert result.shape[1] == driving.shape[1] > 2, "Eq. 4 compares the steps of at least three frames"
    # Means over the vertices where the paper has sums: the ratio is the same, and meshes of two sizes compare.
    moved, wanted = (clip.diff(dim=1).square().sum(dim=3).mean(dim=2) for clip in (result, driving))
    return (moved / wanted.clamp_min(MIN_STEP)).diff(dim=1).abs().mean()


def motion_velocity(result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"]) -> Float[Tensor, ""]:
    """Compute the squared difference of velocities, summed over vertices, mean over steps, as the public code does.

    That takes the mean over coordinates and the sum over the steps but the first. Zero for the truth, wherever it
    stands.
    """
    assert result.shape[1] == truth.shape[1] > 1, "velocities are of at least two frames"
    return reconstruction(result.diff(dim=1), truth.diff(dim=1))


def appearance_paper(
    result: Float[Tensor, "B T V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Compute Eq. 5 with absolute values: change of squared edge lengths, summed over neighbours, mean over vertices.

    Zero for whatever keeps the identity's edge lengths, in any pose. Skinning stretches some edges, so the truth is not
    quite zero.
    """
    new = torch.stack([edge_vectors(frame, edges).square().sum(dim=2) for frame in result.unbind(1)], dim=1)
    growth = new - edge_vectors(identity, edges).square().sum(dim=2)[:, None]
    return growth.abs().sum(dim=2).mean() * 2.0 / result.shape[2]


def appearance_ratio(
    result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Compute |length / truth's length - 1|, mean over edges and frames: a third of the public code's edge term."""
    each_frame = edges.repeat_interleave(result.shape[1], dim=0)
    return layers.edge_ratio(result.flatten(0, 1), truth.flatten(0, 1), each_frame)


def aniformer_loss(
    result: Float[Tensor, "B T V 3"],
    truth: Float[Tensor, "B W V 3"],
    identity: Float[Tensor, "B V 3"],
    driving: Float[Tensor, "B W U 3"],
    edges: Int[Tensor, "B E 2"],
    unit: Float[Tensor, "B W"] | None = None,
    motion: str = "paper",
    motion_weight: float = 1e-3,
    appearance: str = "paper",
    appearance_weight: float = 1e-2,
    edges_of_mesh: float = 1.0,
) -> Float[Tensor, ""]:
    """Compute Eq. 6 with distances and velocities divided by the vertex count, as Eq. 5 is: L_r is then PMD (Eq. 7).

    The one frame (T = 1) that the regression head gives of a window (W frames) is compared with the truth's middle one;
    the motion term needs two frames (`velocity`) or three (`paper`).

    Args:
        unit: radii by which the frames of the truth were divided, over that of the identity. Eq. 5 compares lengths of
            the two, so the result is brought to the identity's unit. None: they have one unit.
        motion: `paper` (Eq. 4 with absolute values), `velocity` (public code) or `off`.
        appearance: `paper` (Eq. 5 with absolute values), `ratio` (public code) or `off`.
        edges_of_mesh: edges a vertex that the whole mesh has, over those given here, when `edges` is a sample.
    """
    count = result.shape[2]
    truth = match_frames(truth, result.shape[1])
    loss = reconstruction(result, truth) / count
    if motion == "paper":
        loss = loss + motion_weight * motion_paper(result, driving)
    elif motion == "velocity":
        loss = loss + motion_weight * motion_velocity(result, truth) / count
    if appearance == "paper":
        sized = result if unit is None else result * match_frames(unit, result.shape[1])[..., None, None]
        loss = loss + appearance_weight * edges_of_mesh * appearance_paper(sized, identity, edges)
    elif appearance == "ratio":
        loss = loss + appearance_weight * appearance_ratio(result, truth, edges)
    return loss


class AniFormerTask(PaperTask[AniFormerTrainConfig, AniFormer]):
    """Training, validation and export of AniFormer."""

    config_type = AniFormerTrainConfig
    test_set = "clips-aniformer"

    @property
    def of_one_order(self) -> bool:
        """Whether norms and embedding have weights for each vertex."""
        return bool(self.config.model.vertices)

    def make_model(self) -> AniFormer:
        return AniFormer(self.config.model)

    def source(self, seed: int) -> WindowSource | MeshWindowSource:
        """Build the generator of windows.

        Raises:
            InputError: the network has weights for each vertex of meshes of another number of vertices.
        """
        wanted, found = self.config.model.vertices, self.mesh_vertices
        if wanted not in (0, found):
            raise InputError(f"model.vertices: expected 0 or {found}, the vertices of the meshes, found {wanted}")
        if self.meshes:
            return MeshWindowSource(self.config.data, self.meshes, self.device, seed)
        return WindowSource(self.config.data, self.body, self.device, seed, self.config.model.frames)

    def loss(self, model: AniFormer, batch: WindowBatch, step: int) -> Tensor:
        with self.autocast():
            result = model(batch.identity, batch.driving, batch.index)
        given = (batch.truth, batch.identity, batch.driving, batch.edges, batch.unit)
        weights = dataclasses.asdict(self.config.losses)
        return aniformer_loss(result, *given, **weights, edges_of_mesh=batch.edges_of_mesh)

    def trial_error(self, model: AniFormer, trial: Pair | ClipPair) -> float:
        """Compute the mean PMD over the frames of a clip's middle window, or the PMD of a pair."""
        frames = self.config.model.frames

        def infer(identity: Float[Tensor, "V 3"], driving: Float[Tensor, "T U 3"]) -> Float[Tensor, "R V 3"]:
            window = driving.expand(frames, -1, -1)  # repeats the one frame of a pair
            with self.autocast():
                return model(identity[None], window[None])[0]

        where = (self.config.data.target_scale, self.device)
        if isinstance(trial, ClipPair):
            return clip_error(infer, trial, *where, frames)
        return pair_error(infer, trial, *where)

    def batch_error(self, model: AniFormer, batch: WindowBatch) -> float:
        with self.autocast():
            result = model(batch.identity, batch.driving, batch.index)
        truth, unit = (match_frames(of_frames, result.shape[1]) for of_frames in (batch.truth, batch.truth_radius))
        return float(mean_squared_distance(result, truth, unit))

    def flops_per_pair(self, model: AniFormer) -> float:
        return self.config.model.frames * model.estimate_flops(self.vertices)

    @staticmethod
    def onnx_interface(model: AniFormer) -> OnnxInterface:
        """Map identity (1, V, 3) and driving (1, T, V, 3) to result (1, T, V, 3), or (1, 1, V, 3) by regression.

        One window at a time, so that memory stays small. V is a number where the weights are for so many vertices.
        """
        count = model.config.vertices or 300
        example = (torch.randn(1, count, 3), torch.randn(1, model.config.frames, count, 3))
        v = torch.export.Dim("vertices", min=2)
        dynamic = ({}, {}) if model.config.vertices else ({1: v}, {2: v})
        return OnnxInterface(model, ("identity", "driving"), ("result",), example, dynamic)

    @staticmethod
    def onnx_facts(model: AniFormer) -> dict[str, Any]:
        """Give the frames of a window, the kind of head, and the vertices that all meshes must have, or 0."""
        config = model.config
        return {"model": "aniformer", "frames": config.frames, "head": config.head, "vertices": config.vertices}
