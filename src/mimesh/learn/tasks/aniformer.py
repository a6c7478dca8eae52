"""AniFormer: windows of T frames, the loss of Eq. 6, validation on windows of clips.

Every frame of driving and truth is centred on its own bounding box; driving frames are each in their own unit sphere.
Where a result stands is not learned: it follows from the driving's path afterwards.

Losses are one function per equation; `signed` ones are the equations as printed, kept to be measured. As printed Eq. 4
and Eq. 5 are signed differences: the first has no lower bound (and telescopes, so only the first and the last step of a
clip enter), the second is smallest where the mesh is one point. With absolute values both are zero on sets that hold
more than the truth, so neither may stand alone (see each function for what it is zero on).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from ...bodies import RiggedBody
from ...core.errors import InputError
from ...evaluate import protocols
from ...evaluate.clip_protocols import FRAMES, ClipPair
from ...evaluate.pairs import Pair
from ...evaluate.quadruped import QUADRUPED
from .. import losses
from ..bodies import rotvec_to_rotmat
from ..body_sampler import TABLE_KINDS, BodySampler, DataConfig, random_headings
from ..losses import edge_vectors, match_frames, mean_squared_distance
from ..mesh_pairs import HeldOutMeshes, MeshSampler, WindowBatch
from ..models.aniformer import AniFormer, AniFormerConfig
from ..pose_sources import training_takes
from ..validation import clip_error, clips_protocol, pair_error
from .base import OnnxInterface, Task, TrainConfig

MAX_SPEED = 3
"""`clips`: windows of captures, or of animals' gaits, are played at up to this many times their speed."""
CAPTURED = 0.5
"""`clips`: share of windows of these; the others go straight from one pose within the joint limits to another."""
MIN_STEP = 1e-6
"""Least mean square step of a driving frame that Eq. 4 divides by (unit sphere: 1e-3 of the radius a frame)."""


@dataclass(frozen=True)
class ClipLossConfig:
    """Terms of Eq. 6 beside the reconstruction; the largest weights that cost nothing on `val` (docs/LOG.md)."""

    motion: Literal["paper", "velocity", "off"] = "paper"
    motion_weight: float = 1e-3
    appearance: Literal["paper", "ratio", "off"] = "paper"
    appearance_weight: float = 1e-2


@dataclass(frozen=True)
class AniFormerTrainConfig(TrainConfig):
    """The configuration of an AniFormer training."""

    network: Literal["aniformer"] = "aniformer"
    model: AniFormerConfig = field(default_factory=AniFormerConfig)
    losses: ClipLossConfig = field(default_factory=ClipLossConfig)

    def check(self, where: str) -> None:
        """Raise InputError for windows that cannot be cut, attended to or compared."""
        super().check(where)
        model = self.model
        if self.data.kind not in ("clips", "clips80", "meshes"):
            raise InputError(
                f"{where}: expected data.kind clips, clips80 or meshes with aniformer, found {self.data.kind}; set it"
            )
        if not 1 <= model.frames <= FRAMES:
            raise InputError(f"{where}, frames: expected 1 to {FRAMES}, found {model.frames}")
        if model.vertices and self.data.pairing != "order":
            raise InputError(
                f"{where}: expected data.pairing order with model.vertices, found {self.data.pairing}; weights of a "
                "vertex need meshes in one order"
            )
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


class WindowSource(BodySampler):
    """Makes batches of windows of one length."""

    def __init__(self, config: DataConfig, frames: int, body: RiggedBody, device: torch.device, seed: int) -> None:
        self.frames = frames
        super().__init__(config, body, device, seed)

    def _load(self, body: RiggedBody) -> None:
        super()._load(body)
        if self.config.kind in TABLE_KINDS:
            return
        takes = training_takes(body)
        # All frames of all takes in one tensor, and the indices where the fastest window still fits into its take.
        self.captured = self._tensor(np.concatenate(takes))
        ends = np.cumsum([len(take) for take in takes])
        longest = MAX_SPEED * (self.frames - 1)
        starts = [np.arange(end - len(take), end - longest) for end, take in zip(ends, takes, strict=True)]
        self.starts = torch.from_numpy(np.concatenate(starts)).to(self.device)

    def batch(self, size: int, step: int) -> WindowBatch:
        """Make the windows of a step."""
        rng = self._generator(step)
        sample = self._sample_motions if self.config.kind in TABLE_KINDS else self._sample_windows
        (identity_shape, driving_shape), identity_pose, poses = sample(size, rng)
        index, driving_index, edges, share = self._sample_vertices(size, rng)
        identity, radius = self._normalized_mesh(identity_shape, identity_pose, index)
        scale = radius if self.config.target_scale == "identity" else None
        driving, _ = self._normalized_window(driving_shape, poses, driving_index)
        truth, radii = self._normalized_window(identity_shape, poses, index, scale)
        self._reflect(rng, identity, driving, truth)
        divisor = radii if scale is None else radius[:, :, 0].expand_as(radii)
        return WindowBatch(identity, driving, truth, divisor / radius[:, :, 0], radii / divisor, index, edges, share)

    def _sample_motions(self, size: int, rng: torch.Generator):
        """Draw two people of the table, a window of one of the 80 motions, and a Table 6 pose for the identity."""
        shapes = self._sample_table_people(size, rng)
        window = self._recombine(self._random_window(self.motions, size, self.frames, rng), self.motions, rng)
        window = self._replace_by_straight(window, rng)
        pose = self.table_poses[self._random_index(len(self.table_poses), (size,), rng)]
        return shapes, pose, window

    def _sample_windows(self, size: int, rng: torch.Generator):
        """Draw new people, windows of takes at some speed or straight ways between two poses, and headings."""
        shapes, poses, _ = self._sample_people(size, rng)
        frame = torch.arange(self.frames, device=self.device)
        first = self.starts[self._random_index(len(self.starts), (size, 1), rng)]
        speed = 1 + self._random_index(MAX_SPEED, (size, 1), rng)
        captured = self.captured[first + speed * frame]
        if len(self.postures):
            captured = captured + self._random_postures(size, rng)[:, None]
        captured = rotvec_to_rotmat(captured)
        straight = self._straight_windows(size, self.frames, rng)
        heading = random_headings(size, np.deg2rad(self.config.heading), rng)[:, None]
        chosen = torch.rand(size, generator=rng, device=self.device) < CAPTURED
        window = torch.where(chosen[:, None, None, None, None], captured, straight)
        window[:, :, 0] = heading @ window[:, :, 0]
        return shapes, poses[0], window

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


class MeshWindowSource(MeshSampler):
    """Makes batches of windows of registered clips."""

    def batch(self, size: int, step: int) -> WindowBatch:
        """Make the windows of a step."""
        return self.sample(size, step)


def reconstruction(result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"]) -> Float[Tensor, ""]:
    """Compute L_r of Eq. 6: squared distance to the truth, summed over vertices, mean over frames."""
    return losses.reconstruction(result.flatten(0, 1), truth.flatten(0, 1))


def motion_signed(result: Float[Tensor, "B T V 3"], driving: Float[Tensor, "B T U 3"]) -> Float[Tensor, ""]:
    """Compute Eq. 4 as printed: it falls without end as the last step of the result grows."""
    return _change_of_ratio(result, driving).mean()


def motion_paper(result: Float[Tensor, "B T V 3"], driving: Float[Tensor, "B T U 3"]) -> Float[Tensor, ""]:
    """Compute Eq. 4 with absolute values: the ratio of the result's speed to the driving's should not change.

    Zero for the driving itself in any size and place, for a static result, and wherever the two speeds are
    proportional. A driving step below `MIN_STEP` counts as that.
    """
    return _change_of_ratio(result, driving).abs().mean()


def motion_velocity(result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"]) -> Float[Tensor, ""]:
    """Compute the squared difference of velocities, summed over vertices, mean over steps, as the public code does.

    That takes the mean over coordinates and the sum over the steps but the first. Zero for the truth, wherever it
    stands.
    """
    assert result.shape[1] == truth.shape[1] > 1, "velocities are of at least two frames"
    return reconstruction(result.diff(dim=1), truth.diff(dim=1))


def appearance_signed(
    result: Float[Tensor, "B T V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Compute Eq. 5 as printed: least, and negative, where the result is one point. `edges` lists each edge once."""
    return _edge_growth(result, identity, edges).sum(dim=2).mean() * 2.0 / result.shape[2]


def appearance_paper(
    result: Float[Tensor, "B T V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Compute Eq. 5 with absolute values: change of squared edge lengths, summed over neighbours, mean over vertices.

    Zero for whatever keeps the identity's edge lengths, in any pose. Skinning stretches some edges, so the truth is not
    quite zero.
    """
    return _edge_growth(result, identity, edges).abs().sum(dim=2).mean() * 2.0 / result.shape[2]


def appearance_ratio(
    result: Float[Tensor, "B T V 3"], truth: Float[Tensor, "B T V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Compute |length / truth's length - 1|, mean over edges and frames: a third of the public code's edge term."""
    each_frame = edges.repeat_interleave(result.shape[1], dim=0)
    return losses.edge_ratio(result.flatten(0, 1), truth.flatten(0, 1), each_frame)


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


def _change_of_ratio(result: Float[Tensor, "B T V 3"], driving: Float[Tensor, "B T U 3"]) -> Float[Tensor, "B S"]:
    """Compute, for each step and the next (S = T - 2), how much result's over driving's squared speed falls."""
    assert result.shape[1] == driving.shape[1] > 2, "Eq. 4 compares the steps of at least three frames"
    # Means over the vertices where the paper has sums: the ratio is the same, and meshes of two sizes compare.
    moved, wanted = (clip.diff(dim=1).square().sum(dim=3).mean(dim=2) for clip in (result, driving))
    return -(moved / wanted.clamp_min(MIN_STEP)).diff(dim=1)


def _edge_growth(
    result: Float[Tensor, "B T V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, "B T E"]:
    """Compute each edge's squared length less that in the identity."""
    new = [edge_vectors(frame, edges).square().sum(dim=2) for frame in result.unbind(1)]
    return torch.stack(new, dim=1) - edge_vectors(identity, edges).square().sum(dim=2)[:, None]


class AniFormerTask(Task[AniFormerTrainConfig, AniFormer]):
    """Training, validation and export of AniFormer."""

    config_type = AniFormerTrainConfig
    test_set = "clips-aniformer"

    @property
    def protocol(self) -> protocols.Protocol:
        """Clips: those held out where the data are clips of a folder; of animals pairs, whose driving stands still."""
        if self.meshes and (held_out := HeldOutMeshes.of(self.meshes)):
            return held_out
        return QUADRUPED if self.config.data.body == "quadruped" else clips_protocol(self.config.data)

    def make_model(self) -> AniFormer:
        """Build the network with fresh weights."""
        return AniFormer(self.config.model)

    def source(self, seed: int) -> WindowSource | MeshWindowSource:
        """Build the generator of windows.

        Raises:
            InputError: the network has weights for each vertex of meshes of another number of vertices.
        """
        wanted, found = self.config.model.vertices, self.with_vertices(0).vertices
        if wanted not in (0, found):
            raise InputError(f"model.vertices: expected 0 or {found}, the vertices of the meshes, found {wanted}")
        if self.meshes:
            return MeshWindowSource(self.config.data, self.meshes, self.device, seed)
        return WindowSource(self.config.data, self.config.model.frames, self.body, self.device, seed)

    def loss(self, model: AniFormer, batch: WindowBatch, step: int) -> Tensor:
        """Compute Eq. 6 over V."""
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
        """Compute the mean PMD of a batch."""
        with self.autocast():
            result = model(batch.identity, batch.driving, batch.index)
        truth, unit = (match_frames(of_frames, result.shape[1]) for of_frames in (batch.truth, batch.truth_radius))
        return float(mean_squared_distance(result, truth, unit))

    def flops_per_pair(self, model: AniFormer) -> float:
        """Count the floating-point operations of one training window's forward pass."""
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
