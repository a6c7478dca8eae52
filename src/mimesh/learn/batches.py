"""Training pairs made on the device: people, poses, skinning, normalisation and vertex shuffles, without a worker.

Batch `step` is a pure function of (seed, step), so a resumed training sees what an uninterrupted one would have seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from ..bodies import RiggedBody
from ..bodies.contacts import contact_bank
from ..bodies.sampling import JOINT_LIMITS, TABLE_6, limits_rotvec, lowered_arms, sample_pose
from ..bodies.sampling import rotvec_to_rotmat as numpy_rotmat
from ..core import geometry
from ..evaluate.clip_protocols import CLIPS_ANIFORMER
from ..evaluate.protocols import HUMAN_NPT
from ..evaluate.remesh import template
from ..motions import pose_bank
from .bodies import TorchBody, rotvec_to_rotmat


@dataclass(frozen=True)
class DataConfig:
    """What the pairs are made of."""

    kind: Literal["table6", "wide", "clips80", "clips"] = "table6"
    """`table6`: NPT's 16 people x 400 Table 6 poses. `wide`: endless people, joint limits, motions, headings.
    `clips80`: AniFormer's 16 people x 80 motions of 30 frames. `clips`: endless people and moving poses."""
    vertices: int = 0
    """Vertices of each mesh: 0 for all, else a random subset (ends of random edges for identity and truth)."""
    target_scale: Literal["truth", "identity"] = "truth"
    """Whose radius the truth is divided by. The paper normalises every mesh; users do not know the truth's radius."""
    spread: float = 1.3
    """Standard deviation of the shape coefficients."""
    heading: float = 45.0
    """`wide` only: the driving mesh looks up to this many degrees to either side."""
    tumble: float = 0.0
    """`wide` only: share of driving meshes that are turned any way at all, as people who lie, roll or hang are."""
    contacts: float = 0.0
    """`wide` only: share of people who touch themselves."""


TABLES = ("table6", "clips80")
"""Kinds with few people and poses."""
IDENTITY_MIX = (0.40, 0.80, 0.85)
"""`wide`: identities up to these shares are at rest (arms anywhere from T to lowered), in Table 6, within joint limits;
the others are frames of motions."""
DRIVING_MIX = (0.05, 0.50, 0.62)
"""The same for driving meshes."""


@dataclass(frozen=True)
class Batch:
    """Normalised meshes of B pairs. Vertex i of `truth` is vertex i of `identity`; `driving` is shuffled on its own."""

    identity: Float[Tensor, "B V 3"]
    driving: Float[Tensor, "B U 3"]
    truth: Float[Tensor, "B V 3"]
    edges: Int[Tensor, "B E 2"]
    edges_of_mesh: float
    """Edges a vertex of the whole mesh over edges a vertex given here."""


class PairSource:
    """Makes batches of one kind of data on one device."""

    def __init__(self, config: DataConfig, body: RiggedBody, device: torch.device, seed: int) -> None:
        self.config, self.seed, self.device = config, seed, device
        self.body = TorchBody(body).to(device)
        self.edges = torch.from_numpy(geometry.edges(body.faces)).to(device)
        self.order = torch.from_numpy(geometry.spatial_order(body.vertices)).to(device)
        area = torch.from_numpy(vertex_areas(body)).float().to(device)[self.order]
        # Shares of the body before each vertex of that order, counted in vertices and in area.
        self.shares = torch.stack([torch.ones_like(area).cumsum(0) / len(area), area.cumsum(0) / area.sum()])
        self.first_neighbour, self.neighbours = (
            torch.from_numpy(a).to(device) for a in geometry.neighbours(body.faces)
        )
        self.extreme = torch.from_numpy(extreme_vertices(body)).to(device)
        self._load(body)

    def _load(self, body: RiggedBody) -> None:
        """What people and poses are drawn from."""
        kind = self.config.kind
        if kind in TABLES:
            clips = kind == "clips80"
            self.people = self._tensor((CLIPS_ANIFORMER if clips else HUMAN_NPT).train_people(body))
            self.stands = self._tensor(numpy_rotmat(HUMAN_NPT.train_poses(body)))
            self.motions = self._tensor(CLIPS_ANIFORMER.train_motions(body)) if clips else self.stands[:, None]
        else:
            self.table6 = self._tensor(limits_rotvec(body, TABLE_6))
            self.limits = self._tensor(limits_rotvec(body, JOINT_LIMITS))
            self.bank = self._tensor(pose_bank("train"))
            self.lowered = self._tensor(lowered_arms(body))
            self.contacts = [self._tensor(array) for array in contact_bank()]

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).float().to(self.device)

    def batch(self, size: int, step: int) -> Batch:
        """The pairs of training step `step`."""
        rng = torch.Generator(self.device).manual_seed(self.seed * 1_000_003 + step)
        shapes, poses, _ = (self._from_table if self.config.kind in TABLES else self._endless)(size, rng)
        identity_shape, driving_shape = shapes
        identity_pose, driving_pose = poses
        index, driving_index, edges, share = self._vertices(size, rng)
        identity, radius = self._mesh(identity_shape, identity_pose, index)
        driving, _ = self._mesh(driving_shape, driving_pose, driving_index)
        scale = radius if self.config.target_scale == "identity" else None
        truth, _ = self._mesh(identity_shape, driving_pose, index, scale)
        return Batch(identity, driving, truth, edges, share)

    def _from_table(self, size: int, rng: torch.Generator):
        """Two of the 16 people for each pair, the identity in a Table 6 pose, the driving in that or in a frame."""
        who = self._below(len(self.people), (2, size), rng)
        stand, frames = self._below(len(self.stands), (size,), rng), self.motions.flatten(0, 1)
        nobody = torch.zeros(2, size, dtype=torch.bool, device=self.device)
        return self.people[who], (self.stands[stand], frames[self._below(len(frames), (size,), rng)]), nobody

    def _endless(self, size: int, rng: torch.Generator):
        """Fresh people; identities mostly near a rest pose, driving meshes in all that people do.

        Beside shapes and poses, both for identities and driving, who touch themselves: their pose is for their shape.
        """
        shapes = torch.randn(2, size, len(self.body.components), generator=rng, device=self.device)
        shapes = self.config.spread * shapes.clamp(-2.5, 2.5)
        kinds = torch.rand(2, size, generator=rng, device=self.device)
        poses, touching = [], torch.zeros(2, size, dtype=torch.bool, device=self.device)
        for kind, identity in zip(kinds, (True, False), strict=True):
            table, wide = self._within(self.table6, size, rng), self._within(self.limits, size, rng)
            clip = self.bank[torch.randint(len(self.bank), (size,), generator=rng, device=self.device)]
            rest = self.lowered * torch.rand(size, 1, 1, generator=rng, device=self.device)
            rest = rest + 0.05 * torch.randn(size, *rest.shape[1:], generator=rng, device=self.device)
            edges = IDENTITY_MIX if identity else DRIVING_MIX
            choice = torch.bucketize(kind, torch.tensor(edges, device=self.device))
            pose = torch.stack([rest, table, wide, clip])[choice, torch.arange(size, device=self.device)]
            if self.config.contacts:
                who = len(poses)
                shapes[who], pose, touching[who] = self._touching(shapes[who], pose, rng)
            rotmat = rotvec_to_rotmat(pose)
            turn = math.radians(self.config.heading) * (0.25 if identity else 1.0)
            rotmat[:, 0] = self._headings(size, turn, rng) @ rotmat[:, 0]
            if self.config.tumble and not identity:
                rotmat[:, 0] = self._tumbles(size, rng) @ rotmat[:, 0]
            poses.append(rotmat)
        return shapes, torch.stack(poses), touching

    def _touching(self, shape: Float[Tensor, "B K"], pose: Float[Tensor, "B J 3"], rng: torch.Generator):
        """Some of the people give way to ones who touch themselves."""
        some = torch.rand(len(shape), generator=rng, device=self.device) < self.config.contacts
        drawn = self._below(len(self.contacts[0]), (len(shape),), rng)
        shapes, poses = (bank[drawn] for bank in self.contacts)
        return torch.where(some[:, None], shapes, shape), torch.where(some[:, None, None], poses, pose), some

    def _below(self, count: int, shape: tuple[int, ...], rng: torch.Generator) -> Int[Tensor, "..."]:
        return torch.randint(count, shape, generator=rng, device=self.device)

    def _within(self, bounds: Float[Tensor, "2 J 3"], size: int, rng: torch.Generator) -> Float[Tensor, "B J 3"]:
        part = torch.rand(size, *bounds.shape[1:], generator=rng, device=self.device)
        return bounds[0] + part * (bounds[1] - bounds[0])

    def _headings(self, size: int, reach: float, rng: torch.Generator) -> Float[Tensor, "B 3 3"]:
        angle = reach * (2 * torch.rand(size, generator=rng, device=self.device) - 1)
        zero = torch.zeros_like(angle)
        return rotvec_to_rotmat(torch.stack([zero, angle, zero], -1))

    def _tumbles(self, size: int, rng: torch.Generator) -> Float[Tensor, "B 3 3"]:
        """No turn, or for some any turn."""
        axis = torch.nn.functional.normalize(torch.randn(size, 4, generator=rng, device=self.device), dim=-1)
        angle = 2 * torch.acos(axis[:, :1].clamp(-1, 1))
        rotvec = angle * torch.nn.functional.normalize(axis[:, 1:], dim=-1)
        some = torch.rand(size, 1, generator=rng, device=self.device) < self.config.tumble
        return rotvec_to_rotmat(rotvec * some)

    def _vertices(self, size: int, rng: torch.Generator):
        """Independent shuffles: indices of identity and truth, of driving, and the edges among the former.

        With a subset, every second identity vertex is a random neighbour of the one before it, so that edge losses have
        edges to measure.
        """
        total, wanted = self.body.vertex_count, self.config.vertices
        if wanted == 0:
            order = torch.rand(2, size, total, generator=rng, device=self.device).argsort(-1)
            rank = order[0].argsort(-1)
            edges = rank[:, self.edges.flatten()].unflatten(1, self.edges.shape)
            return order[0], order[1], edges, 1.0
        index = self._spread(size, wanted // 2, rng)
        start, end = self.first_neighbour[index], self.first_neighbour[index + 1]
        pick = torch.rand(index.shape, generator=rng, device=self.device) * (end - start)
        index = torch.stack([index, self.neighbours[start + pick.long()]], -1).flatten(1)
        edges = torch.arange(index.shape[1], device=self.device).view(1, -1, 2).expand(size, -1, -1)
        return index, self._spread(size, index.shape[1], rng), edges, 2.0 * len(self.edges) / total

    def _spread(self, size: int, count: int, rng: torch.Generator) -> Int[Tensor, "B N"]:
        """Random vertices, one from each of `count` equal cells of the body, in random order.

        Means over them (InstanceNorm lives on those) waver far less than over vertices drawn at random. Half of the
        `wide` meshes are as dense as the body's file everywhere, the others lean towards even density by area, as
        meshes of other makers may be.
        """
        even = torch.rand(size, 1, generator=rng, device=self.device) * 2 - 1
        even = even.clamp_min(0) if self.config.kind == "wide" else torch.zeros_like(even)
        cell = torch.arange(count, device=self.device) + torch.rand(size, count, generator=rng, device=self.device)
        shares = self.shares[0] + even * (self.shares[1] - self.shares[0])
        drawn = self.order[torch.searchsorted(shares, cell / count).clamp_max(len(self.order) - 1)]
        return drawn.gather(1, torch.rand(size, count, generator=rng, device=self.device).argsort(1))

    def _mesh(self, shape, rotmat, index, radius=None):
        """Chosen vertices of the normalised mesh, and its radius; centre and radius are those of the whole mesh."""
        count = index.shape[1]
        if count == self.body.vertex_count:
            points = self.body.posed(shape, rotmat)
            whole, points = points, points.gather(1, index[..., None].expand(-1, -1, 3))
        else:
            both = torch.cat([index, self.extreme.expand(len(index), -1)], dim=1)
            skinned = self.body.posed(shape, rotmat, both)
            points, whole = skinned[:, :count], skinned[:, count:]
        centre = (whole.amax(1, keepdim=True) + whole.amin(1, keepdim=True)) / 2
        if radius is None:
            radius = (whole - centre).norm(dim=-1).amax(1)[:, None, None]
        return (points - centre) / radius, radius


NEAR = 0.15
"""Metres along the surface up to which a batch of `TemplateSource` counts vertices as joined by an edge."""


class TemplateSource(PairSource):
    """Pairs on LIMP's template: its vertices, in its order, for all meshes."""

    def _load(self, body: RiggedBody) -> None:
        super()._load(body)
        mesh = template(self.config.vertices)
        self.index = torch.from_numpy(mesh.corners[:, 0]).to(self.device)
        # Straight distances between vertices this near change little in any pose, as those along the surface do.
        points = body.vertices[mesh.corners[:, 0]]
        self.edges = torch.from_numpy(geometry.near_pairs(points, mesh.faces, NEAR)).to(self.device)

    def _vertices(self, size: int, rng: torch.Generator):
        index = self.index.expand(size, -1)
        return index, index, self.edges.expand(size, -1, -1), 1.0


def extreme_vertices(body: RiggedBody, poses: int = 400) -> Int[np.ndarray, " N"]:
    """Vertices that are ever outermost (along an axis, or from the middle) in random poses: enough to normalise by."""
    found: list[int] = []
    for i in range(poses):
        limits = TABLE_6 if i % 2 else JOINT_LIMITS
        vertices = body.posed(np.zeros(1), numpy_rotmat(sample_pose(body, 0, i, limits)))
        centre = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
        found += [*vertices.argmax(axis=0), *vertices.argmin(axis=0)]
        found += np.argsort(np.linalg.norm(vertices - centre, axis=1))[-3:].tolist()
    return np.unique(found)


def vertex_areas(body: RiggedBody) -> Float[np.ndarray, " V"]:
    """Area of the mean shape that belongs to each vertex: a third of its triangles'."""
    areas = geometry.face_areas(body.vertices, body.faces)
    return np.bincount(body.faces.ravel(), np.repeat(areas / 3, 3), minlength=len(body.vertices))
