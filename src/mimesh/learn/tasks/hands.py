"""hands: hands with posed fingers as points, in the frame of a predicted hand joint; the loss, validation, export."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ...bodies import RiggedBody
from ...bodies.finger_poses import finger_rotations, sample_finger_poses
from ...bodies.hands import HAND_PARENTS, left_hand_body
from ...bodies.joint_names import finger_joints
from ...core.errors import InputError
from ..bodies import rotvec_to_rotmat, scaled_joints, world_rotations
from ..hand_surfaces import HUMAN, WITHOUT, HandSurface, training_hands
from ..models.hands import HAND_POINTS, HandNetwork
from ..models.mime import MimeConfig, Prediction
from .base import OnnxInterface, Task, TrainConfig
from .mime import JOINT_KNEE, ROTATION_KNEE, pseudo_huber

QUERIES = 96
"""Points of a hand whose skinning weights are predicted in training."""
POSES = 16_384
"""Gestures that a training draws from."""
OWN_REST = 0.25
"""Share of hands whose fingers stand as in the file."""
FRAME_NOISE, WRIST_BEND = math.radians(25), math.radians(60)
"""Largest error of the predicted hand joint's rotation, and largest rotation of the forearm (radians)."""
SIZES, GIRTHS = 0.16, 0.12
"""Standard deviation of the logarithms of the lengths of fingers and of the girths of all bones."""
FULLEST = (0.15, 0.85)
"""Least weight of the hand in the points that the network gets, drawn for each hand: where the wrist is cut."""
NOISE = 0.06
"""Largest noise of the points, as a share of the hand's spread; mostly it is far less."""
BUMPS, BUMP_FREQUENCY = 0.05, 8.0
"""Largest height of bumps and scale of their frequency, in units of the hand's spread."""
MISSING, MAX_HOLE, ONE_SIDED, WITHOUT_NORMALS = 0.15, 0.6, 0.1, 0.15
"""Share of hands that lack the points of a ball, its largest radius in spreads of the hand; shares of hands of which
only one side is given, and without normals."""
LAST = 1e3
"""Added to the keys of points that are taken last."""
WITHOUT_SHARE = 0.25
"""Share of hands without fingers."""
TRIAL_SEED = 77
"""Seed of the gestures of a validation."""


@dataclass(frozen=True)
class HandLossConfig:
    """Weights of the terms beside the rotations."""

    joints: float = 2.0
    """Of squared distances of joints, in units of the points' spread."""
    weights: float = 0.05
    """Of the cross-entropy of the skinning weights."""
    separate: float = 0.05
    """Of the cross-entropy of whether the hand shows separate fingers."""


@dataclass(frozen=True)
class HandsTrainConfig(TrainConfig):
    """The configuration of a training of hands."""

    network: Literal["hands"] = "hands"
    model: MimeConfig = field(default_factory=MimeConfig)
    structure: HandLossConfig = field(default_factory=HandLossConfig)

    def check(self, where: str) -> None:
        """Raise InputError for data that is not of hands, or a width that the heads do not divide."""
        super().check(where)
        if self.data.kind != "hands":
            raise InputError(f"{where}: expected data.kind hands with hands, found {self.data.kind}; set it")
        if not 0.0 <= self.data.characters <= 1 - WITHOUT_SHARE:
            raise InputError(
                f"{where}: expected data.characters from 0 to {1 - WITHOUT_SHARE}, found {self.data.characters}"
            )
        if self.model.heads < 1 or self.model.width % self.model.heads:
            raise InputError(f"{where}: expected heads that divide width {self.model.width}, found {self.model.heads}")


@dataclass(frozen=True)
class HandBatch:
    """B hands: what the network is given, and what is true of them."""

    points: Float[Tensor, "B N 3"]
    normals: Float[Tensor, "B N 3"]
    queries: Float[Tensor, "B Q 3"]
    query_normals: Float[Tensor, "B Q 3"]
    query_weights: Float[Tensor, "B Q 16"]
    rotation: Float[Tensor, "B 16 3 3"]
    joints: Float[Tensor, "B 16 3"]
    separate: Bool[Tensor, " B"]


@cache
def gesture_bank(seed: int) -> Float[np.ndarray, "P 15 3 3"]:
    """Draw the gestures of a training: local rotations of a left hand's joints."""
    return finger_rotations(sample_finger_poses(POSES, np.random.default_rng(seed)), left=True)


class HandSource(nn.Module):
    """Makes batches of hands; a batch is a pure function of the seed and its step."""

    points: Tensor
    normals: Tensor
    weights: Tensor
    joints: Tensor
    alignment: Tensor
    bones: Tensor
    separate: Tensor
    gestures: Tensor
    branching: Tensor

    def __init__(self, surfaces: list[HandSurface], device: torch.device, seed: int, characters: float) -> None:
        """Put the hands on the device.

        Args:
            characters: share of hands of characters and of hands without fingers; the others are the shipped body's.
        """
        super().__init__()
        self.seed, self.device = seed, device
        for name in ("points", "normals", "weights", "joints", "alignment", "bones", "separate"):
            stacked = torch.from_numpy(np.stack([getattr(surface, name) for surface in surfaces]))
            self.register_buffer(name, stacked if name == "separate" else stacked.float())
        self.register_buffer("gestures", torch.from_numpy(gesture_bank(seed)).float())
        self.register_buffer("branching", torch.tensor([j == 0 for j in range(16)]))
        groups = [surface.group for surface in surfaces]
        self.rows = [
            torch.tensor([i for i, group in enumerate(groups) if group == one], device=device)
            for one in dict.fromkeys(groups)
        ]
        kinds = [next(iter(groups[int(rows[0])].split(","))) for rows in self.rows]
        self.shares = torch.tensor(group_shares(kinds, characters), device=device)
        self.to(device)

    def batch(self, size: int, step: int) -> HandBatch:
        """Make the hands of a step."""
        rng = torch.Generator(self.device).manual_seed(self.seed * 1_000_003 + step)
        group = self.shares.multinomial(size, replacement=True, generator=rng)
        place = torch.rand(size, generator=rng, device=self.device)
        which = torch.stack([rows[(place * len(rows)).long()] for rows in self.rows])[group, torch.arange(size)]
        target = self._fingers(which, rng)
        points, normals, joints = self._posed(which, target, rng)
        weights, centre = self.weights[which], points.mean(1, keepdim=True)
        spread = (points - centre).square().sum(-1).mean(1).sqrt()[:, None, None]
        points, joints = (points - centre) / spread, (joints - centre) / spread
        index = self._chosen(points, normals, weights, rng)
        taken, taken_normals, taken_weights = (_gather(values, index) for values in (points, normals, weights))
        noise = NOISE * self._uniform(rng, size, 1, 1).pow(3)
        noisy = taken + noise * torch.randn(taken.shape, generator=rng, device=self.device)
        turn = self._turn(rng, size, FRAME_NOISE)
        noisy, turned_normals, joints = (values @ turn.mT for values in (noisy, taken_normals, joints))
        turned_normals = turned_normals * (self._uniform(rng, size, 1, 1) >= WITHOUT_NORMALS)
        of_hand = torch.cat([taken_weights[..., :2].sum(-1, keepdim=True), taken_weights[..., 2:]], -1)
        given, asked = slice(HAND_POINTS), slice(HAND_POINTS, None)
        return HandBatch(
            noisy[:, given],
            turned_normals[:, given],
            noisy[:, asked],
            turned_normals[:, asked],
            of_hand[:, asked],
            turn[:, None] @ target,
            joints,
            self.separate[which],
        )

    def _fingers(self, which: Int[Tensor, " B"], rng: torch.Generator) -> Float[Tensor, "B 16 3 3"]:
        """Draw the rotation of every joint, in the hand's frame; a share of the fingers stands as in the file."""
        size = len(which)
        gesture = torch.randint(POSES, (size,), generator=rng, device=self.device)
        hand = torch.eye(3, device=self.device).expand(size, 1, 3, 3)
        posed = world_rotations(torch.cat([hand, self.gestures[gesture]], 1), HAND_PARENTS)
        # A hand in a file is turned back to the frame of its palm, in which it is posed too.
        rest = self.alignment[which][:, :1].mT @ self.alignment[which]
        own = self._uniform(rng, size, 1, 1, 1) < OWN_REST
        return torch.where(own | ~self.separate[which][:, None, None, None], rest, posed)

    def _posed(self, which: Int[Tensor, " B"], target: Float[Tensor, "B 16 3 3"], rng: torch.Generator):
        """Scale the bones, bend the wrist and pose the fingers: points, normals and joints."""
        size, rest_joints = len(which), self.joints[which]
        fingers = SIZES * self._normal(rng, size, 6)
        length = torch.cat([fingers[:, :1], fingers[:, 1:].repeat_interleave(3, 1)], 1)
        length = (length + 0.5 * SIZES * self._normal(rng, size, 16)).clamp(-0.5, 0.5).exp()
        girth = (GIRTHS * (self._normal(rng, size, 1) + self._normal(rng, size, 16))).clamp(-0.45, 0.45).exp()
        turned = target @ self.alignment[which].mT
        joints, linear, normal_map = scaled_joints(
            rest_joints, self.bones[which], self.branching, length, girth, turned, HAND_PARENTS
        )
        # The forearm turns about the wrist: it is the first of 17 columns.
        bend = self._turn(rng, size, WRIST_BEND)[:, None] @ turned[:, :1]
        linear, normal_map = torch.cat([bend, linear], 1), torch.cat([bend, normal_map], 1)
        place, rest_place = (torch.cat([at[:, :1], at], 1) for at in (joints, rest_joints))
        offset = place - (linear @ rest_place[..., None])[..., 0]
        maps = torch.cat([linear, offset[..., None], normal_map], -1).flatten(2)
        blended = (self.weights[which] @ maps).unflatten(2, (3, 7))
        rest = self._bumpy(which, rng)
        points = (blended[..., :3] @ rest[..., None])[..., 0] + blended[..., 3]
        normals = F.normalize((blended[..., 4:] @ self.normals[which][..., None])[..., 0], dim=-1)
        return points, normals, joints

    def _bumpy(self, which: Int[Tensor, " B"], rng: torch.Generator) -> Float[Tensor, "B N 3"]:
        """Move the points of hands at rest along their normals by a wave."""
        size, points = len(which), self.points[which]
        spread = (points - points.mean(1, keepdim=True)).square().sum(-1).mean(1).sqrt()[:, None, None]
        direction = BUMP_FREQUENCY * self._normal(rng, size, 1, 3) / spread
        phase = 2 * math.pi * self._uniform(rng, size, 1, 1)
        height = BUMPS * spread * self._uniform(rng, size, 1, 1).square()
        wave = ((points * direction).sum(-1, keepdim=True) + phase).sin()
        return points + height * wave * self.normals[which]

    def _chosen(self, points, normals, weights, rng: torch.Generator) -> Int[Tensor, "B M"]:
        """Choose random points of the hand, cut somewhere at the wrist; some hands lack a hole or one side."""
        size, total = points.shape[:2]
        key = torch.rand(size, total, generator=rng, device=self.device)
        low, high = FULLEST
        least = low + (high - low) * self._uniform(rng, size, 1)
        centre = torch.randint(total, (size, 1, 1), generator=rng, device=self.device).expand(-1, -1, 3)
        radius = MAX_HOLE * self._uniform(rng, size, 1) * (self._uniform(rng, size, 1) < MISSING)
        hole = (points - points.gather(1, centre)).norm(dim=-1) < radius
        view = F.normalize(self._normal(rng, size, 1, 3), dim=-1)
        hidden = ((normals * view).sum(-1) < 0) & (self._uniform(rng, size, 1) < ONE_SIDED)
        beyond = weights[..., 1:].sum(-1) < least
        key = key + LAST * (hole | hidden) + 2 * LAST * beyond
        order = key.topk(HAND_POINTS + QUERIES, dim=1, largest=False).indices
        # Where too few points are left, the first ones are repeated.
        enough = (key < LAST).sum(1, keepdim=True).clamp_min(1)
        place = torch.arange(order.shape[1], device=self.device)
        order = order.gather(1, torch.where(place < enough, place, place % enough))
        shuffled = torch.rand(size, order.shape[1], generator=rng, device=self.device).argsort(1)
        return order.gather(1, shuffled)

    def _turn(self, rng: torch.Generator, size: int, largest: float) -> Float[Tensor, "B 3 3"]:
        """Draw rotations about any axis by up to an angle (radians)."""
        axis = F.normalize(self._normal(rng, size, 3), dim=-1)
        return rotvec_to_rotmat(axis * largest * self._uniform(rng, size, 1))

    def _uniform(self, rng: torch.Generator, *size: int) -> Tensor:
        return torch.rand(*size, generator=rng, device=self.device)

    def _normal(self, rng: torch.Generator, *size: int) -> Tensor:
        return torch.randn(*size, generator=rng, device=self.device)


def group_shares(groups: list[str], characters: float) -> list[float]:
    """Give the share of each group in a batch: people, packs of characters, hands without fingers."""
    packs = len(groups) - sum(group in (HUMAN, WITHOUT) for group in groups)
    without = groups.count(WITHOUT)
    share = {HUMAN: 1 - WITHOUT_SHARE - characters * bool(packs), WITHOUT: WITHOUT_SHARE / max(without, 1)}
    return [share.get(group, characters / max(packs, 1)) for group in groups]


def hands_loss(model: nn.Module, batch: HandBatch, weights: HandLossConfig) -> Float[Tensor, ""]:
    """Compute the errors of rotations, joints and weights of hands with fingers, and of the logits of all."""
    prediction, logit, scores = model(batch.points, batch.normals, batch.queries, batch.query_normals)
    known = batch.separate[:, None]
    rotation = [(found - batch.rotation).square().sum((-1, -2)) for found in prediction.rotations]
    joints = [((found - batch.joints) / prediction.scale).square().sum(-1) for found in prediction.positions]
    terms = (
        _masked_mean(pseudo_huber(torch.stack(rotation), ROTATION_KNEE), known),
        weights.joints * _masked_mean(pseudo_huber(torch.stack(joints), JOINT_KNEE), known),
        -weights.weights * _masked_mean((batch.query_weights * scores.log_softmax(-1)).sum(-1)[None], known),
        weights.separate * F.binary_cross_entropy_with_logits(logit, batch.separate.float()),
    )
    return torch.stack(terms).sum()


def _masked_mean(values: Float[Tensor, "E B J"], known: Bool[Tensor, "B 1"]) -> Float[Tensor, ""]:
    return (values * known).sum() / (values.shape[0] * values.shape[2] * known.sum().clamp_min(1))


def joint_error(prediction: Prediction, batch: HandBatch) -> Float[Tensor, " B"]:
    """Compute the mean squared distance of the finger joints in squared spreads of the hand."""
    return ((prediction.joints - batch.joints) / prediction.scale)[:, 1:].square().sum(-1).mean(1)


class HandTrials:
    """Hands of people that no training gets, in place of the pairs of a protocol."""

    validation_kinds = ("unseen",)

    def __init__(self, source: HandSource) -> None:
        self.source = source

    def count(self, kind: str, limit: int) -> int:
        """Give the number of trials, each of one hand."""
        return limit

    def pair(self, split: str, kind: str, index: int) -> HandBatch:
        """Make a trial: hands with gestures of their own."""
        return self.source.batch(8, index)


class HandsTask(Task[HandsTrainConfig, HandNetwork]):
    """Training, validation and export of hands."""

    config_type = HandsTrainConfig
    test_set = "fingers"

    @property
    def body(self) -> RiggedBody:
        """The left hand of the shipped body."""
        return left_hand_body()

    @property
    def protocol(self) -> Any:
        """Hands of other people, in place of a protocol of pairs."""
        return HandTrials(HandSource(training_hands(super().body, (), seed=1), self.device, TRIAL_SEED, 0.0))

    def make_model(self) -> HandNetwork:
        """Build the network with fresh weights."""
        return HandNetwork(self.config.model)

    def source(self, seed: int) -> HandSource:
        """Build the generator of hands."""
        characters = self.characters.characters if self.characters else ()
        return HandSource(training_hands(super().body, characters), self.device, seed, self.config.data.characters)

    def loss(self, model: HandNetwork, batch: HandBatch, step: int) -> Tensor:
        """Compute the loss of a batch."""
        with self.autocast():
            return hands_loss(model, batch, self.config.structure)

    def trial_error(self, model: HandNetwork, trial: HandBatch) -> float:
        """Compute the mean squared error of the finger joints of a trial."""
        return self.batch_error(model, trial)

    def batch_error(self, model: HandNetwork, batch: HandBatch) -> float:
        """Compute the mean squared error of the finger joints of hands with fingers, in squared spreads."""
        with self.autocast():
            prediction = model.predict_joints(batch.points, batch.normals)
        return float(joint_error(prediction, batch)[batch.separate].mean()) if batch.separate.any() else 0.0

    def flops_per_pair(self, model: HandNetwork) -> float:
        """Count the floating-point operations of the forward pass of one hand."""
        return model.estimate_flops(QUERIES, HAND_POINTS)

    @staticmethod
    def onnx_interface(model: HandNetwork) -> OnnxInterface:
        """Map points and queries of any number of hands, with normals, to joints, logits and scores."""
        b, v = torch.export.Dim("hands", min=1), torch.export.Dim("vertices", min=1)
        inputs = ("points", "normals", "vertices", "vertex_normals")
        example = (*torch.randn(2, 3, HAND_POINTS, 3), *torch.randn(2, 3, 300, 3))
        dynamic = ({0: b}, {0: b}, {0: b, 1: v}, {0: b, 1: v})
        return OnnxInterface(_Outputs(model), inputs, ("rotation", "joints", "scores", "separate"), example, dynamic)

    @staticmethod
    def onnx_facts(model: HandNetwork) -> dict[str, Any]:
        """Give the number of points and the names of the joints of a left hand."""
        return {"model": "hands", "points": HAND_POINTS, "joints": ("LeftHand", *finger_joints("Left"))}


class _Outputs(nn.Module):
    """All that the network computes, as tensors."""

    def __init__(self, model: HandNetwork) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: Tensor, normals: Tensor, vertices: Tensor, vertex_normals: Tensor):
        prediction, logit, scores = self.model(points, normals, vertices, vertex_normals)
        return prediction.rotation, prediction.joints, scores, logit


def _gather(values: Float[Tensor, "B N C"], index: Int[Tensor, "B M"]) -> Float[Tensor, "B M C"]:
    return values.gather(1, index[..., None].expand(-1, -1, values.shape[-1]))
