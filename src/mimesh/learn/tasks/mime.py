"""mime: pairs of people as points of surfaces, the loss, validation through the whole network, export.

Errors count squared up to their knee and about linearly beyond it (`pseudo_huber`): with plain squares the few people
who lie or twist in unusual ways would be most of the loss.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ...bodies import RiggedBody
from ...bodies.anatomy import anatomy_of
from ...core import geometry, surface_points
from ...core.errors import InputError
from ...core.mesh import Mesh
from ...evaluate.metrics import pmd_aligned
from ...evaluate.pairs import Pair
from ...evaluate.protocols import Protocol
from ...evaluate.quadruped import QUADRUPED
from ..body_sampler import TABLE_KINDS, BodySampler, DataConfig
from ..character_surfaces import TrainingCharacters
from ..models.mime import POINTS, MimeConfig, MimeNetwork, Prediction
from ..primitive_animals import primitive_animals
from ..primitives import primitive_people
from ..vertex_sampler import share_of
from .base import OnnxInterface, Task, TrainConfig
from .mime_characters import CharacterPairs
from .mime_people import People, PeopleSampler, PosedSurface, SurfaceBody, plain_people
from .mime_scans import gather_points, repeat_visible, scanned

DEFAULT_POINTS = 320
"""Points of each mesh, unless the configuration says more."""
MISSING = (0.08, 0.25)
"""Share of identities and of driving meshes that lack the points within a ball."""
WITHOUT_NORMALS = (0.1, 0.2)
"""Share of identities and of driving meshes without normals, as point clouds are."""
ONE_SIDED = 0.1
"""Share of driving meshes of which only the points facing one side are given, as in a scan."""
MAX_NOISE = 0.02
"""Largest standard deviation of the noise on driving points (metres); mostly it is far less."""
RECONSTRUCTION_KNEE, ROTATION_KNEE, JOINT_KNEE = 5e-4, 0.02, 0.002
"""Of squared errors: of a pair (`reconstruction`), of a joint's rotation matrix, and of a joint in units of the points'
spread."""


@dataclass(frozen=True)
class MimeLossConfig:
    """Weights of the terms beside the reconstruction, in units of the identity's squared radius."""

    rotation: float = 0.1
    """Of squared differences of rotation matrices, mean over joints and estimates."""
    joints: float = 0.5
    """Of squared distances of joints, in units of the points' spread."""
    weights: float = 0.01
    """Of the cross-entropy of the skinning weights."""


@dataclass(frozen=True)
class MimeTrainConfig(TrainConfig):
    """The configuration of a training of mime."""

    network: Literal["mime"] = "mime"
    model: MimeConfig = field(default_factory=MimeConfig)
    structure: MimeLossConfig = field(default_factory=MimeLossConfig)

    def check(self, where: str) -> None:
        """Raise InputError for data that mime cannot be trained on, or a width that the heads do not divide."""
        super().check(where)
        if self.data.kind not in ("table6", "wide"):
            raise InputError(f"{where}: expected data.kind table6 or wide with mime, found {self.data.kind}; set it")
        if self.data.target_scale != "identity":
            raise InputError(
                f"{where}: expected data.target_scale identity with mime, which keeps lengths, found truth"
            )
        if self.model.heads < 1 or self.model.width % self.model.heads:
            raise InputError(f"{where}: expected heads that divide width {self.model.width}, found {self.model.heads}")
        if not 0.0 <= self.data.characters <= 1.0 or (self.data.characters and self.data.kind != "wide"):
            raise InputError(
                f"{where}: expected data.characters from 0 to 1 with data.kind wide, found "
                f"{self.data.characters} with {self.data.kind}"
            )
        if self.data.reflect:
            raise InputError(f"{where}: expected data.reflect 0 with mime, found {self.data.reflect}; leave it out")


@dataclass(frozen=True)
class SurfaceBatch:
    """B pairs in metres: exact surfaces, and what the network is given of them, which may be damaged."""

    identity: PosedSurface
    driving: PosedSurface
    truth: PosedSurface
    """The identity's points in the driving pose."""
    inputs: tuple[tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"]], ...]
    """Points and normals of identity and of driving; the driving's rows are not those of `driving`."""


class SurfaceSource(BodySampler):
    """Makes batches of one kind of data: NPT's table of plain people, or endless people and characters of all kinds."""

    def __init__(
        self,
        config: DataConfig,
        body: RiggedBody,
        device: torch.device,
        seed: int,
        characters: TrainingCharacters | None = None,
    ) -> None:
        super().__init__(config, body, device, seed)
        self.surface = SurfaceBody(body, low_poly=config.low_poly > 0).to(device)
        self.people = PeopleSampler(body, config.spread, device)
        self.count = config.vertices or DEFAULT_POINTS
        if config.characters:
            assert characters is not None
            primitives = primitive_animals(body) if body.name == "quadruped" else primitive_people(body)
            surfaces = [*characters.surfaces, *primitives]
            drawn = (self.count, math.radians(config.heading) / 4, MISSING, config.low_poly)
            self.pairs = CharacterPairs(surfaces, body, device, *drawn)
        if characters is not None:
            self.motion_frames = torch.cat([self.motion_frames, self._tensor(characters.all_poses)])

    def batch(self, size: int, step: int) -> SurfaceBatch:
        """Make the pairs of a step."""
        rng = self._generator(step)
        figures = share_of(size, self.config.characters, step)
        groups = [self._people(size - figures, rng)] if figures < size else []
        groups += [self._figures(figures, rng)] if figures else []
        identity, driving, truth = (PosedSurface.joined(surfaces) for surfaces in zip(*groups, strict=True))
        if self.config.kind in TABLE_KINDS:
            exact = tuple((mesh.points, mesh.normals) for mesh in (identity, driving))
            return SurfaceBatch(identity, driving, truth, exact)
        return SurfaceBatch(identity, driving, truth, self._damage(identity, driving, rng))

    def _people(self, size: int, rng: torch.Generator) -> tuple[PosedSurface, PosedSurface, PosedSurface]:
        """Make identity, driving mesh and truth of pairs of the shipped body's people."""
        shapes, poses, touching = self._sample_pairs(size, rng)
        people = self._dress(shapes, touching, rng)
        missing = (0.0, 0.0) if self.config.kind in TABLE_KINDS else MISSING
        index = [self.surface.choose(who, self.count, rng, share) for who, share in zip(people, missing, strict=True)]
        identity, driving = (self.surface.posed(*given) for given in zip(people, poses, index, strict=True))
        return identity, driving, self.surface.posed(people[0], poses[1], index[0])

    def _figures(self, size: int, rng: torch.Generator) -> tuple[PosedSurface, PosedSurface, PosedSurface]:
        """Make the same of pairs of characters."""
        pairs = self.pairs.draw(self._sample_pairs(size, rng, self.config.character_limits)[1], rng)
        return pairs.identity, pairs.driving, pairs.truth

    def _dress(
        self, shapes: Float[Tensor, "2 B K"], touching: Bool[Tensor, "2 B"], rng: torch.Generator
    ) -> list[People]:
        """Make people of shapes: plain ones of the table, or ones with garments and proportions of their own.

        Those in self-contact stay plain, because with other proportions their parts would not touch.
        """
        plain = [plain_people(shape, self.surface) for shape in shapes]
        if self.config.kind in TABLE_KINDS:
            return plain
        drawn = [self.people.draw(len(touching[0]), rng, self.config.low_poly) for _ in shapes]
        return [one.where(some, other) for one, some, other in zip(plain, touching, drawn, strict=True)]

    def _damage(self, identity: PosedSurface, driving: PosedSurface, rng: torch.Generator):
        """Add noise to driving points, leave out one side of some and the normals of others; make scans of a share."""
        size, index = len(driving.points), self._one_sided(driving.normals, rng)
        noise = torch.randn(driving.points.shape, generator=rng, device=self.device)
        noisy = gather_points(driving.points, index) + MAX_NOISE * self._uniform(size, rng).square() * noise
        normals = gather_points(driving.normals, index)
        if self.config.scans:
            some = self._uniform(size, rng) < self.config.scans
            scan = scanned(driving.points, driving.normals, rng)
            noisy, normals = torch.where(some, scan[0], noisy), torch.where(some, scan[1], normals)
        meshes = ((identity.points, identity.normals), (noisy, normals))
        return tuple(
            (points, normals * (self._uniform(size, rng) >= share))
            for (points, normals), share in zip(meshes, WITHOUT_NORMALS, strict=True)
        )

    def _one_sided(self, normals: Float[Tensor, "B N 3"], rng: torch.Generator) -> Int[Tensor, "B N"]:
        """Choose all points, or for a share of the meshes those that face one side, repeated up to N."""
        size = len(normals)
        angle = 2 * math.pi * self._uniform(size, rng)
        side = torch.cat([angle.sin(), torch.zeros_like(angle), angle.cos()], -1)
        hidden = ((normals * side).sum(-1) <= 0) & (self._uniform(size, rng)[..., 0] < ONE_SIDED)
        return repeat_visible(hidden)

    def _uniform(self, size: int, rng: torch.Generator) -> Float[Tensor, "B 1 1"]:
        return torch.rand(size, 1, 1, generator=rng, device=self.device)


def mime_loss(model: MimeNetwork, batch: SurfaceBatch, weights: MimeLossConfig) -> Float[Tensor, ""]:
    """Compute the reconstruction (root joints together) and the structural terms."""
    own, other, scores = model(*batch.inputs)
    half = slice(scores.shape[1])
    moved = model.skin(batch.identity.points[:, half], scores, own, other, batch.truth.joints[:, 0])
    loss = pseudo_huber(reconstruction(moved, batch), RECONSTRUCTION_KNEE).mean()
    for prediction, true in ((own, batch.identity), (other, batch.driving)):
        rotation, joints = joint_errors(prediction, (true.rotation, true.turning), (true.joints, true.placed))
        loss = loss + weights.rotation * rotation / 2 + weights.joints * joints / 2
    entropy = -(batch.identity.weights[:, half] * scores.log_softmax(-1)).sum(-1).mean()
    return loss + weights.weights * entropy


def pseudo_huber(square: Float[Tensor, "*B"], knee: float) -> Float[Tensor, "*B"]:
    """Turn a squared error into itself far below the knee, and into its root beyond (Charbonnier et al., ICIP 1994)."""
    return 2 * knee * ((square / knee + 1).sqrt() - 1)


def reconstruction(result: Float[Tensor, "B N 3"], batch: SurfaceBatch) -> Float[Tensor, " B"]:
    """Compute the mean squared distance of each pair, over the square of the identity's radius about its centroid."""
    centred = batch.identity.points - batch.identity.points.mean(1, keepdim=True)
    radius = centred.norm(dim=-1).amax(1)
    return (result - batch.truth.points[:, : result.shape[1]]).square().sum(-1).mean(1) / radius.square()


def joint_errors(
    prediction: Prediction,
    rotation: tuple[Float[Tensor, "B J 3 3"], Bool[Tensor, "B #J"]],
    joints: tuple[Float[Tensor, "B J 3"], Bool[Tensor, "B #J"]],
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Compute errors of rotations and of joint positions, mean over the estimates and the joints that are known.

    Args:
        rotation: the true ones, and which are known.
        joints: the same of the positions.
    """
    turned = [(found - rotation[0]).square().sum((-1, -2)) for found in prediction.rotations]
    moved = [((found - joints[0]) / prediction.scale).square().sum(-1) for found in prediction.positions]
    return (
        masked_mean(pseudo_huber(torch.stack(turned), ROTATION_KNEE), rotation[1]),
        masked_mean(pseudo_huber(torch.stack(moved), JOINT_KNEE), joints[1]),
    )


def masked_mean(values: Float[Tensor, "*E B J"], known: Bool[Tensor, "B #J"]) -> Float[Tensor, ""]:
    """Compute the mean of the known values; 0 if none is known."""
    return (values * known).sum() / known.expand_as(values).sum().clamp_min(1)


class MimeTask(Task[MimeTrainConfig, MimeNetwork]):
    """Training, validation and export of mime."""

    config_type = MimeTrainConfig
    test_set = "human-npt"

    @property
    def protocol(self) -> Protocol:
        """Pairs of the body that is trained on."""
        return QUADRUPED if self.config.data.body == "quadruped" else super().protocol

    def make_model(self) -> MimeNetwork:
        """Build the network with fresh weights."""
        return MimeNetwork(self.config.model, self.body)

    def source(self, seed: int) -> SurfaceSource:
        """Build the generator of pairs."""
        return SurfaceSource(self.config.data, self.body, self.device, seed, self.characters)

    def loss(self, model: MimeNetwork, batch: SurfaceBatch, step: int) -> Tensor:
        """Compute reconstruction and structural terms."""
        with self.autocast():
            return mime_loss(model, batch, self.config.structure)

    def trial_error(self, model: MimeNetwork, trial: Pair) -> float:
        """Compute the PMD of a pair: joints from points of both surfaces, then skinning of the identity's vertices.

        The network gives its results no place: they are compared about the centres of their boxes.
        """
        mesh = trial.identity
        vertices = self._tensor(mesh.vertices)
        normals = self._tensor(geometry.vertex_normals(mesh.vertices, mesh.faces))
        with self.autocast():
            own, other = (model.predict_joints(*self._points(m)) for m in (mesh, trial.driving))
            scores = model.predict_weights(own, vertices, normals)
        result = model.skin(vertices, scores, own, other)[0]
        return pmd_aligned(result.double().cpu().numpy(), trial.truth)

    def _points(self, mesh: Mesh) -> tuple[Float[Tensor, "1 N 3"], Float[Tensor, "1 N 3"]]:
        """Draw random points of a surface, always the same ones, and their normals."""
        face, share = surface_points.sample_surface(mesh.vertices, mesh.faces, POINTS, np.random.default_rng(0))
        points = surface_points.at_barycentric(mesh.vertices, mesh.faces, face, share)
        return self._tensor(points), self._tensor(geometry.face_normals(mesh.vertices, mesh.faces)[face])

    def _tensor(self, array: Float[np.ndarray, "N 3"]) -> Float[Tensor, "1 N 3"]:
        return torch.from_numpy(array).float()[None].to(self.device)

    def batch_error(self, model: MimeNetwork, batch: SurfaceBatch) -> float:
        """Compute the mean PMD over half of the identities' points, whose boxes and radii are those compared."""
        with self.autocast():
            own, other, scores = model(*batch.inputs)
        count = scores.shape[1]
        result = model.skin(batch.identity.points[:, :count], scores, own, other, batch.truth.joints[:, 0])
        pair = (points.double().cpu().numpy() for points in (result, batch.truth.points[:, :count]))
        return pmd_aligned(*pair)

    def flops_per_pair(self, model: MimeNetwork) -> float:
        """Count the floating-point operations of one training pair's forward pass."""
        return model.estimate_flops(self.vertices, self.vertices)

    @staticmethod
    def onnx_interface(model: MimeNetwork) -> OnnxInterface:
        """Map points and vertices of one mesh, with normals, to joints and scores; skinning is left to the caller."""
        v = torch.export.Dim("vertices", min=1)
        inputs, outputs = ("points", "normals", "vertices", "vertex_normals"), ("rotation", "joints", "scores")
        example = (*torch.randn(2, 1, POINTS, 3), *torch.randn(2, 1, 300, 3))
        return OnnxInterface(_OneMesh(model), inputs, outputs, example, ({}, {}, {1: v}, {1: v}))

    @staticmethod
    def onnx_facts(model: MimeNetwork) -> dict[str, Any]:
        """Give the number of points, names and parents of the joints, and which joints make a leg."""
        body = model.body
        legs = [[body.joint(name) for name in leg] for leg in anatomy_of(body.name).legs]
        joints = {"joints": body.joint_names, "parents": body.parents, "legs": legs, "body": body.name}
        return {"model": "mime", "points": POINTS, **joints}


class _OneMesh(nn.Module):
    """All that the network computes of one mesh, as one function."""

    def __init__(self, model: MimeNetwork) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: Tensor, normals: Tensor, vertices: Tensor, vertex_normals: Tensor):
        prediction = self.model.predict_joints(points, normals)
        scores = self.model.predict_weights(prediction, vertices, vertex_normals)
        return prediction.rotation, prediction.joints, scores
