"""People for training, made on the device: shapes and poses of the papers' tables, vertices, skinning, normalisation.

NPT's data are 16 people in 400 poses (Table 6), AniFormer's 16 people in 80 motions of 30 frames. A pair is any two of
the people, each in any of the poses; the truth is the first one in the pose of the second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ...bodies import RiggedBody
from ...bodies.anatomy import anatomy_of_joints
from ...bodies.joint_ranges import ranges_of
from ...bodies.sampling import limits_rotvec, sample_pose
from ...bodies.sampling import rotvec_to_rotmat as numpy_rotmat
from ...core import geometry
from ...core.errors import InputError
from ...core.rig import descendants
from ...evaluate.clip_protocols import CLIPS_ANIFORMER
from ...evaluate.protocols import HUMAN_NPT
from ..task import DataConfig, share
from .bodies import TorchBody
from .endless import EndlessOptions, EndlessPeople, random_index, straight_windows

TABLE_KINDS = ("table6", "clips80")
"""Kinds of data with a fixed table of people and poses, as in the papers."""


@dataclass(frozen=True)
class PeopleOptions(EndlessOptions):
    """How people of the tables are drawn, and new ones; the kinds `table6` and `clips80`, and those of new people."""

    between: float = share()
    """`clips80`: share of windows and frames that lie on a straight way between two poses within the joint limits,
    instead of in one of the 80 motions."""
    recombine: float = share()
    """`table6`, `clips80`: share of poses, or windows, whose head, arms and legs are each turned as in another one."""
    mix_people: float = share()
    """`table6`, `clips80`: share of people who are random mixtures of the 16 (`TablePeople.draw_shapes`)."""

    def check(self, where: str) -> None:
        """Raise InputError for changes to tables where there is none."""
        super().check(where)
        for key, kinds in (("between", TABLE_KINDS[1:]), ("recombine", TABLE_KINDS), ("mix_people", TABLE_KINDS)):
            if (value := getattr(self, key)) and self.kind not in kinds:
                raise InputError(f"{where}: expected data.{key} 0 with {self.kind}, found {value}")


@dataclass(frozen=True)
class ReflectOptions(DataConfig):
    """For data whose truth may be mirrored."""

    reflect: float = share()
    """Share of every batch whose meshes are all mirrored, left to right."""


class TablePeople:
    """Draws people and poses of a table on one device; each call is a pure function of its generator."""

    def __init__(self, config: PeopleOptions, body: RiggedBody, device: torch.device, frames: int = 1) -> None:
        """Put the table on the device.

        Args:
            frames: of the windows that are drawn.
        """
        clips = config.kind == "clips80"
        shapes = (CLIPS_ANIFORMER if clips else HUMAN_NPT).train_people(body)
        arrays = (shapes, numpy_rotmat(HUMAN_NPT.train_poses(body)), limits_rotvec(body, ranges_of(body)[1]))
        self.config, self.frames = config, frames
        self.shapes, self.poses, self.limits = (torch.from_numpy(array).float().to(device) for array in arrays)
        # (motions, frames, J, 3, 3); a pose of Table 6 is a motion of one frame.
        self.motions = self.poses[:, None]
        if clips:
            self.motions = torch.from_numpy(CLIPS_ANIFORMER.train_motions(body)).float().to(device)
        self.limbs = torch.from_numpy(limb_masks(body)).to(device)

    def pairs(
        self, size: int, rng: torch.Generator
    ) -> tuple[Float[Tensor, "2 B K"], Float[Tensor, "2 B J 3 3"], Bool[Tensor, "2 B"]]:
        """Draw shapes and local joint rotations of identities and driving meshes, and who is in self-contact: nobody.

        The identity is in a Table 6 pose, the driving mesh in one or in a frame of a motion.
        """
        shapes = self.draw_shapes(size, rng)
        table = self.poses[:, None]
        identity = self._recombine(random_window(table, size, 1, rng), table, rng)
        driving = self._recombine(random_window(self.motions, size, 1, rng), self.motions, rng)
        driving = self._replace_by_straight(driving, rng)
        nobody = torch.zeros(2, size, dtype=torch.bool, device=rng.device)
        return shapes, torch.stack([identity[:, 0], driving[:, 0]]), nobody

    def windows(
        self, size: int, rng: torch.Generator
    ) -> tuple[Float[Tensor, "2 B K"], Float[Tensor, "B J 3 3"], Float[Tensor, "B T J 3 3"]]:
        """Draw two people for each window, a Table 6 pose of the identity, and the driving poses of a motion."""
        shapes = self.draw_shapes(size, rng)
        window = self._recombine(random_window(self.motions, size, self.frames, rng), self.motions, rng)
        window = self._replace_by_straight(window, rng)
        pose = self.poses[random_index(len(self.poses), (size,), rng)]
        return shapes, pose, window

    def draw_shapes(self, size: int, rng: torch.Generator) -> Float[Tensor, "2 B K"]:
        """Draw identities and driving people of the table: its people, the configured share mixtures of them.

        A mixture is their mean plus normal multiples of what each departs from it, so that its mean and covariance are
        those of the people. New people are as hard as new poses: 16 do not span a body of as many shape components.
        """
        people = self.shapes
        shapes = people[random_index(len(people), (2, size), rng)]
        if not self.config.mix_people:
            return shapes
        mean = people.mean(0)
        normal = torch.randn(2, size, len(people), generator=rng, device=rng.device)
        mixtures = mean + normal @ (people - mean) / math.sqrt(len(people))
        some = torch.rand(2, size, 1, generator=rng, device=rng.device) < self.config.mix_people
        return torch.where(some, mixtures, shapes)

    def _recombine(
        self, window: Float[Tensor, "B W J 3 3"], motions: Float[Tensor, "M T J 3 3"], rng: torch.Generator
    ) -> Float[Tensor, "B W J 3 3"]:
        """Turn each limb of the configured share of the windows as in a random window of the motions.

        400 poses or 80 motions are too few to learn how any pose maps to any other: new ones have two to three times
        the error of these. Their limbs make far more.
        """
        if not self.config.recombine:
            return window
        size, frames = window.shape[:2]
        some = torch.rand(size, 1, generator=rng, device=rng.device) < self.config.recombine
        for limb in self.limbs:
            other = random_window(motions, size, frames, rng)
            window = torch.where((some & limb)[:, None, :, None, None], other, window)
        return window

    def _replace_by_straight(self, window: Float[Tensor, "B T J 3 3"], rng: torch.Generator):
        """Replace the configured share of the windows by straight ways between two poses."""
        if not self.config.between:
            return window
        straight = straight_windows(self.limits, len(window), window.shape[1], rng)
        some = torch.rand(len(window), generator=rng, device=rng.device) < self.config.between
        return torch.where(some[:, None, None, None, None], straight, window)


def people_of(
    config: PeopleOptions, body: RiggedBody, device: torch.device, frames: int = 0
) -> TablePeople | EndlessPeople:
    """Make what people of a kind of data are drawn by, in pairs or in windows of some frames."""
    return (TablePeople if config.kind in TABLE_KINDS else EndlessPeople)(config, body, device, frames)


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
        area = torch.from_numpy(geometry.vertex_areas(vertices, faces)).float().to(device)[self.order]
        # Of the vertices in spatial order: cumulative share of their number, and of their area.
        self.cumulative = torch.stack([torch.ones_like(area).cumsum(0) / len(area), area.cumsum(0) / area.sum()])
        self.first_neighbour, self.neighbours = (torch.from_numpy(a).to(device) for a in geometry.neighbours(faces))

    def _generator(self, step: int) -> torch.Generator:
        """Make the random numbers of a step."""
        return torch.Generator(self.device).manual_seed(self.seed * 1_000_003 + step)

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).float().to(self.device)

    def _sample_vertices(
        self, size: int, rng: torch.Generator
    ) -> tuple[Int[Tensor, "B V"], Int[Tensor, "B U"], Int[Tensor, "B E 2"], float]:
        """Draw indices of identity and truth, of driving, edges among the former, and edges of the mesh over these.

        With a subset, every second identity vertex is a random neighbour of the one before it, so that edge losses have
        edges to measure. With `pairing: order` the driving's are those of the identity.
        """
        ordered = self.config.pairing == "order"
        if self.config.vertices == 0:
            order = torch.rand(2, size, self.total, generator=rng, device=self.device).argsort(-1)
            rank = order[0].argsort(-1)
            edges = rank[:, self.edges.flatten()].unflatten(1, self.edges.shape)
            return order[0], order[0] if ordered else order[1], edges, 1.0
        index = self._stratified_vertices(size, self.config.vertices // 2, rng)
        start, end = self.first_neighbour[index], self.first_neighbour[index + 1]
        pick = torch.rand(index.shape, generator=rng, device=self.device) * (end - start)
        index = torch.stack([index, self.neighbours[start + pick.long()]], -1).flatten(1)
        driving = index if ordered else self._stratified_vertices(size, index.shape[1], rng)
        return index, driving, pairs_of_rows(index), self.edge_share

    @property
    def edge_share(self) -> float:
        """Edges a vertex of the whole mesh, over those of a subset: one for every two vertices."""
        return 2.0 * len(self.edges) / self.total

    def _stratified_vertices(self, size: int, count: int, rng: torch.Generator) -> Int[Tensor, "B N"]:
        """Draw vertices, one from each of `count` equal cells of the mesh, in random order.

        InstanceNorm takes means over them, and those vary far less than over vertices drawn independently. With
        `by_area` half of the meshes are as dense as the file everywhere, the others lean towards even density by area,
        as other meshes may be.
        """
        even = torch.rand(size, 1, generator=rng, device=self.device) * 2 - 1
        even = even.clamp_min(0) if self.by_area else torch.zeros_like(even)
        cell = torch.arange(count, device=self.device) + torch.rand(size, count, generator=rng, device=self.device)
        cumulative = self.cumulative[0] + even * (self.cumulative[1] - self.cumulative[0])
        drawn = self.order[torch.searchsorted(cumulative, cell / count).clamp_max(len(self.order) - 1)]
        return drawn.gather(1, torch.rand(size, count, generator=rng, device=self.device).argsort(1))

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
    """Edges a vertex of the whole mesh over edges a vertex given here."""


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
        self.body = TorchBody(body).to(device)
        self.extreme = torch.from_numpy(extreme_vertices(body)).to(device)
        self.people = people_of(config, body, device, frames)

    def pairs(self, size: int, rng: torch.Generator) -> PairBatch:
        """Draw two people for each pair, in two poses, and make the first one in the pose of the second, too."""
        (identity_shape, driving_shape), (identity_pose, driving_pose), _ = self.people.pairs(size, rng)
        index, driving_index, edges, share = self._sample_vertices(size, rng)
        identity, radius = self._normalized_mesh(identity_shape, identity_pose, index)
        driving, _ = self._normalized_mesh(driving_shape, driving_pose, driving_index)
        scale = radius if self.config.target_scale == "identity" else None
        truth, own = self._normalized_mesh(identity_shape, driving_pose, index, scale)
        size_of_truth = (own / (own if scale is None else scale))[:, 0, 0]
        return PairBatch(identity, driving, truth, size_of_truth, edges, share)

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
        if count == self.body.vertex_count:
            points = self.body.posed(shape, rotmat)
            whole, points = points, points.gather(1, index[..., None].expand(-1, -1, 3))
        else:
            both = torch.cat([index, self.extreme.expand(len(index), -1)], dim=1)
            skinned = self.body.posed(shape, rotmat, both)
            points, whole = skinned[:, :count], skinned[:, count:]
        centre = (whole.amax(1, keepdim=True) + whole.amin(1, keepdim=True)) / 2
        own = (whole - centre).norm(dim=-1).amax(1)[:, None, None]
        return (points - centre) / (own if radius is None else radius), own


def limb_masks(body: RiggedBody) -> Bool[np.ndarray, "L J"]:
    """Tell which joints belong to head, arms and legs: those of each limb from its first joint on."""
    tops = [body.joint(top) for top in anatomy_of_joints(body.joint_names).regions.values()]
    joints = np.arange(len(body.joint_names))
    return np.stack([np.isin(joints, list(descendants([top], body.parents))) for top in tops])


def random_window(
    motions: Float[Tensor, "M T J 3 3"], size: int, frames: int, rng: torch.Generator
) -> Float[Tensor, "B W J 3 3"]:
    """Cut windows of some frames out of random motions."""
    which = random_index(len(motions), (size, 1), rng)
    first = random_index(motions.shape[1] - frames + 1, (size, 1), rng)
    return motions[which, first + torch.arange(frames, device=rng.device)]


def pairs_of_rows(index: Int[Tensor, "B N"]) -> Int[Tensor, "B E 2"]:
    """List the edges among drawn vertices of which every second one is a neighbour of the one before it."""
    return torch.arange(index.shape[1], device=index.device).view(1, -1, 2).expand(len(index), -1, -1)


@cache
def extreme_vertices(body: RiggedBody, poses: int = 400) -> Int[np.ndarray, " N"]:
    """Find the vertices that are outermost (along an axis, or from the centre) in any of many random poses.

    Centre and radius of a posed body follow from these alone, within a hundredth or two of the radius. Posing takes
    seconds, so a body's answer is kept.
    """
    found: list[int] = []
    usual, widest = ranges_of(body)
    for i in range(poses):
        limits = usual if i % 2 else widest
        vertices = body.posed(np.zeros(1), numpy_rotmat(sample_pose(body, 0, i, limits)))
        centre = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
        found += [*vertices.argmax(axis=0), *vertices.argmin(axis=0)]
        found += np.argsort(np.linalg.norm(vertices - centre, axis=1))[-3:].tolist()
    return np.unique(found)
