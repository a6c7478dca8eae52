"""People for training, made on the device: shapes and poses of the papers' tables, vertices, skinning, normalisation.

NPT's data are 16 people in 400 poses (Table 6), AniFormer's 16 people in 80 motions of 30 frames. A pair is any two of
the people, each in any of the poses; the truth is the first one in the pose of the second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ...bodies import RiggedBody
from ...bodies.sampling import rotvec_to_rotmat as numpy_rotmat
from ...core import geometry
from ...evaluate.clip_protocols import CLIPS_ANIFORMER
from ...evaluate.protocols import HUMAN_NPT
from ..task import DataConfig
from . import endless
from .bodies import TorchBody, extreme_vertices, gather_points, numbers_of_step, on_device, uniform
from .endless import TABLE_KINDS, EndlessPeople, PeopleOptions, ReflectOptions, random_index, random_window


class TablePeople:
    """Draws people and poses of a table on one device; each call is a pure function of its generator."""

    def __init__(self, config: PeopleOptions, body: RiggedBody, device: torch.device, frames: int = 1) -> None:
        """Put the table on the device.

        Args:
            frames: of the windows that are drawn.
        """
        clips = config.kind == "clips80"
        shapes = (CLIPS_ANIFORMER if clips else HUMAN_NPT).train_people(body)
        self.config, self.frames = config, frames
        self.shapes = on_device(shapes, device)
        self.poses = on_device(numpy_rotmat(HUMAN_NPT.train_poses(body)), device)
        # (motions, frames, J, 3, 3); a pose of Table 6 is a motion of one frame.
        self.motions = self.poses[:, None]
        if clips:
            self.motions = on_device(CLIPS_ANIFORMER.train_motions(body), device)
        self.limbs = torch.from_numpy(endless.limb_masks(body)).to(device)

    def pairs(
        self, size: int, rng: torch.Generator
    ) -> tuple[Float[Tensor, "2 B K"], Float[Tensor, "2 B J 3 3"], Bool[Tensor, "2 B"]]:
        """Draw shapes and local joint rotations of identities and driving meshes, and who is in self-contact: nobody.

        The identity is in a Table 6 pose, the driving mesh in one or in a frame of a motion.
        """
        shapes = endless.mixed_people(self.shapes, self.config.mix_people, size, rng)
        table = self.poses[:, None]
        identity = random_window(table, size, 1, rng)
        identity = endless.recombined(identity, table, self.limbs, self.config.recombine, rng)
        driving = self._drawn(size, 1, rng)
        nobody = torch.zeros(2, size, dtype=torch.bool, device=rng.device)
        return shapes, torch.stack([identity[:, 0], driving[:, 0]]), nobody

    def windows(
        self, size: int, rng: torch.Generator
    ) -> tuple[Float[Tensor, "2 B K"], Float[Tensor, "B J 3 3"], Float[Tensor, "B T J 3 3"]]:
        """Draw two people for each window, a Table 6 pose of the identity, and the driving poses of a motion."""
        shapes = endless.mixed_people(self.shapes, self.config.mix_people, size, rng)
        window = self._drawn(size, self.frames, rng)
        return shapes, self.poses[random_index(len(self.poses), (size,), rng)], window

    def _drawn(self, size: int, frames: int, rng: torch.Generator) -> Float[Tensor, "B T J 3 3"]:
        window = random_window(self.motions, size, frames, rng)
        return endless.recombined(window, self.motions, self.limbs, self.config.recombine, rng)


class VertexSampler:
    """Draws vertices of one topology on one device; subclasses draw the meshes and make batches of them.

    A batch is a pure function of the seed and its step, so a resumed training gets what an uninterrupted one would
    have.
    """

    def __init__(
        self,
        vertices: Float[np.ndarray, "V 3"],
        faces: Int[np.ndarray, "F 3"],
        config: DataConfig,
        device: torch.device,
        seed: int,
        by_area: bool = False,
    ) -> None:
        """Prepare the topology.

        Args:
            vertices: of one mesh, for the areas and the order in space.
            by_area: half of the meshes lean towards even density by area.
        """
        self.config, self.by_area = config, by_area
        self.reflected = config.reflect if isinstance(config, ReflectOptions) else 0.0
        self.device, self.seed, self.total = device, seed, len(vertices)
        self.edges = torch.from_numpy(geometry.edges(faces)).to(device)
        order = geometry.spatial_order(vertices)
        # Vertices of no triangle have no edges, so subsets leave them out.
        self.order = torch.from_numpy(order[np.isin(order, faces)]).to(device)
        area = on_device(geometry.vertex_areas(vertices, faces), device)[self.order]
        # Of the vertices in spatial order: cumulative share of their number, and of their area.
        self.cumulative = torch.stack([torch.ones_like(area).cumsum(0) / len(area), area.cumsum(0) / area.sum()])
        self.first_neighbour, self.neighbours = (torch.from_numpy(a).to(device) for a in geometry.neighbours(faces))

    def _sample_vertices(
        self, size: int, rng: torch.Generator
    ) -> tuple[Int[Tensor, "B V"], Int[Tensor, "B U"], Int[Tensor, "B E 2"], float]:
        """Draw indices of identity and truth, of driving, edges among the former, and `PairBatch.edges_of_mesh`.

        With a subset, every second identity vertex is a random neighbour of the one before it, so that edge losses have
        edges to measure. With `pairing: order` the driving's are those of the identity.
        """
        ordered = self.config.pairing == "order"
        if self.config.vertices == 0:
            order = uniform(rng, 2, size, self.total).argsort(-1)
            rank = order[0].argsort(-1)
            edges = rank[:, self.edges.flatten()].unflatten(1, self.edges.shape)
            return order[0], order[0] if ordered else order[1], edges, 1.0
        index = self._stratified_vertices(size, self.config.vertices // 2, rng)
        start, end = self.first_neighbour[index], self.first_neighbour[index + 1]
        pick = uniform(rng, *index.shape) * (end - start)
        index = torch.stack([index, self.neighbours[start + pick.long()]], -1).flatten(1)
        driving = index if ordered else self._stratified_vertices(size, index.shape[1], rng)
        edges = torch.arange(index.shape[1], device=self.device).view(1, -1, 2).expand(size, -1, -1)
        return index, driving, edges, self.edges_of_mesh

    @property
    def edges_of_mesh(self) -> float:
        """Edges per vertex of the whole mesh over those of a subset, which has one for every two vertices."""
        return 2.0 * len(self.edges) / self.total

    def _stratified_vertices(self, size: int, count: int, rng: torch.Generator) -> Int[Tensor, "B N"]:
        """Draw vertices, one from each of `count` equal cells of the mesh, in random order.

        InstanceNorm takes means over them, and those vary far less than over vertices drawn independently. With
        `by_area` half of the meshes are as dense as the file everywhere, the others lean towards even density by area,
        as other meshes may be.
        """
        even = uniform(rng, size, 1) * 2 - 1
        even = even.clamp_min(0) if self.by_area else torch.zeros_like(even)
        cell = torch.arange(count, device=self.device) + uniform(rng, size, count)
        cumulative = self.cumulative[0] + even * (self.cumulative[1] - self.cumulative[0])
        drawn = self.order[torch.searchsorted(cumulative, cell / count).clamp_max(len(self.order) - 1)]
        return drawn.gather(1, uniform(rng, size, count).argsort(1))

    def _reflect(self, rng: torch.Generator, *meshes: Float[Tensor, "B ... 3"]) -> None:
        """Mirror the first pairs of a batch in place, x to -x: the configured share of them.

        Pairs of a batch are drawn independently of their place in it, so the first ones are as good as any. A share
        that is not a whole number of pairs is rounded up or down at random: it is right in the mean.
        """
        # The number of them stays on the device: to read it would make the host wait in every step.
        count = (self.reflected * len(meshes[0]) + torch.rand((), generator=rng, device=self.device)).floor()
        sign = torch.where(torch.arange(len(meshes[0]), device=self.device) < count, -1.0, 1.0)
        for mesh in meshes:
            mesh[..., 0] *= sign.view(-1, *[1] * (mesh.ndim - 2))


@dataclass(frozen=True)
class PairBatch:
    """Normalised meshes of B pairs. Vertex i of `truth` is vertex i of `identity`; `driving` is in another order."""

    identity: Float[Tensor, "B V 3"]
    driving: Float[Tensor, "B U 3"]
    truth: Float[Tensor, "B V 3"]
    truth_radius: Float[Tensor, " B"]
    """Radius of the whole `truth` in its unit: 1 where it was divided by its own."""
    edges: Int[Tensor, "B E 2"]
    edges_of_mesh: float
    """Edges per vertex of the whole mesh over edges per vertex given here."""


class BodySampler(VertexSampler):
    """Draws people of one kind of data and vertices of them on one device; subclasses make batches of them."""

    def __init__(
        self, config: PeopleOptions, body: RiggedBody, device: torch.device, seed: int, frames: int = 0
    ) -> None:
        """Put people and topology on the device.

        Args:
            frames: of the windows that are drawn; 0 where pairs are.
        """
        super().__init__(body.vertices, body.faces, config, device, seed, by_area=config.kind == "wide")
        self.body = TorchBody(body, device=device)
        self.extreme = torch.from_numpy(extreme_vertices(body)).to(device)
        drawn_by = TablePeople if config.kind in TABLE_KINDS else EndlessPeople
        self.people = drawn_by(config, body, device, frames)

    def _normalized_mesh(
        self,
        shape: Float[Tensor, "B K"],
        rotmat: Float[Tensor, "B J 3 3"],
        index: Int[Tensor, "B N"],
        radius: Float[Tensor, "B 1 1"] | None = None,
    ) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B 1 1"]]:
        """Pose people and give chosen vertices, centred on the bounding box and divided by `radius`, and their own one.

        Centre and radius are those of the whole mesh, of which few vertices need to be posed. None: divide by the own.
        """
        count = index.shape[1]
        if count == self.total:
            whole = self.body.posed(shape, rotmat)
            return in_unit_sphere(gather_points(whole, index), whole, radius)
        both = torch.cat([index, self.extreme.expand(len(index), -1)], dim=1)
        skinned = self.body.posed(shape, rotmat, both)
        return in_unit_sphere(skinned[:, :count], skinned[:, count:], radius)


class PairSource(BodySampler):
    """Makes batches of pairs of people."""

    def batch(self, size: int, step: int) -> PairBatch:
        return self.pairs(size, numbers_of_step(self.seed, step, self.device))

    def pairs(self, size: int, rng: torch.Generator) -> PairBatch:
        """Draw two people for each pair, in two poses, and make the first one in the pose of the second, too."""
        (identity_shape, driving_shape), (identity_pose, driving_pose), _ = self.people.pairs(size, rng)
        index, driving_index, edges, edges_of_mesh = self._sample_vertices(size, rng)
        identity, radius = self._normalized_mesh(identity_shape, identity_pose, index)
        driving, _ = self._normalized_mesh(driving_shape, driving_pose, driving_index)
        scale = radius if self.config.target_scale == "identity" else None
        truth, own = self._normalized_mesh(identity_shape, driving_pose, index, scale)
        self._reflect(rng, identity, driving, truth)
        size_of_truth = (own / (own if scale is None else scale))[:, 0, 0]
        return PairBatch(identity, driving, truth, size_of_truth, edges, edges_of_mesh)


def in_unit_sphere(
    points: Float[Tensor, "B N 3"], whole: Float[Tensor, "B P 3"], radius: Float[Tensor, "B 1 1"] | None = None
) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B 1 1"]]:
    """Centre points of meshes on the box of the whole, divide them by `radius` (None: that of the whole); give that."""
    centre = (whole.amax(1, keepdim=True) + whole.amin(1, keepdim=True)) / 2
    own = (whole - centre).norm(dim=-1).amax(1)[:, None, None]
    return (points - centre) / (own if radius is None else radius), own
