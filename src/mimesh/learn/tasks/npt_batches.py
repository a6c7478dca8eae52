"""Batches of NPT: pairs of people, of registered meshes, and of characters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ...bodies import RiggedBody
from ..body_sampler import BodySampler, DataConfig
from ..character_surfaces import TrainingCharacters
from ..mesh_pairs import MeshSampler
from ..vertex_sampler import pairs_of_rows, share_of
from .mime_characters import CharacterPairs

POINTS = 1024
"""Points of a character from which vertices are drawn; centre and radius of the whole follow from them, within a
hundredth or two of the radius."""
NEIGHBOURS = 6
"""Of these points at rest, the nearest ones that count as neighbours: as many as a vertex of a closed mesh has."""


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

    @classmethod
    def joined(cls, batches: Sequence[PairBatch]) -> PairBatch:
        """Concatenate batches of as many vertices."""
        names = ("identity", "driving", "truth", "truth_radius", "edges")
        joined = {name: torch.cat([getattr(batch, name) for batch in batches]) for name in names}
        return cls(**joined, edges_of_mesh=batches[0].edges_of_mesh)


class PairSource(BodySampler):
    """Makes batches of pairs of people."""

    def batch(self, size: int, step: int) -> PairBatch:
        """Make the pairs of a step."""
        return self._people(size, self._generator(step))

    def _people(self, size: int, rng: torch.Generator) -> PairBatch:
        (identity_shape, driving_shape), (identity_pose, driving_pose), _ = self._sample_pairs(size, rng)
        index, driving_index, edges, share = self._sample_vertices(size, rng)
        identity, radius = self._normalized_mesh(identity_shape, identity_pose, index)
        driving, _ = self._normalized_mesh(driving_shape, driving_pose, driving_index)
        scale = radius if self.config.target_scale == "identity" else None
        truth, own = self._normalized_mesh(identity_shape, driving_pose, index, scale)
        self._reflect(rng, identity, driving, truth)
        size_of_truth = (own / (own if scale is None else scale))[:, 0, 0]
        return PairBatch(identity, driving, truth, size_of_truth, edges, share)


class MeshPairSource(MeshSampler):
    """Makes batches of pairs of registered meshes."""

    def batch(self, size: int, step: int) -> PairBatch:
        """Make the pairs of a step."""
        drawn = self.sample(size, step)
        truth, own = drawn.truth[:, 0], drawn.truth_radius[:, 0]
        return PairBatch(drawn.identity, drawn.driving[:, 0], truth, own, drawn.edges, drawn.edges_of_mesh)


class CharacterPairSource(PairSource):
    """Makes batches of which a share are pairs of characters; people of the shipped body drive every second of them."""

    def __init__(
        self, config: DataConfig, body: RiggedBody, device: torch.device, seed: int, characters: TrainingCharacters
    ) -> None:
        super().__init__(config, body, device, seed)
        self.motion_frames = torch.cat([self.motion_frames, self._tensor(characters.all_poses)])
        heading = math.radians(config.heading) / 4
        self.pairs = CharacterPairs(list(characters.surfaces), body, device, POINTS, heading, missing=(0.0, 0.0))

    def batch(self, size: int, step: int) -> PairBatch:
        """Make the pairs of a step."""
        rng, figures = self._generator(step), share_of(size, self.config.characters, step)
        groups = [self._people(size - figures, rng)] if figures < size else []
        groups += [self._figures(figures, rng)] if figures else []
        return PairBatch.joined(groups)

    def _figures(self, size: int, rng: torch.Generator) -> PairBatch:
        (_, shapes), poses, _ = self._sample_pairs(size, rng)
        pairs = self.pairs.draw(poses, rng)
        index = self._with_neighbours(pairs.rest.points, rng)
        identity, radius = in_unit_sphere(pairs.identity.points, index)
        scale = radius if self.config.target_scale == "identity" else None
        truth, own = in_unit_sphere(pairs.truth.points, index, scale)
        driving, _ = in_unit_sphere(pairs.driving.points, self._random_rows(size, index.shape[1], rng))
        people = size // 2
        vertices = self._stratified_vertices(people, index.shape[1], rng)
        driving[:people] = self._normalized_mesh(shapes[:people], pairs.pose[:people], vertices)[0]
        self._reflect(rng, identity, driving, truth)
        size_of_truth = (own / (own if scale is None else scale))[:, 0, 0]
        return PairBatch(identity, driving, truth, size_of_truth, pairs_of_rows(index), self.edge_share)

    def _with_neighbours(self, rest: Float[Tensor, "B P 3"], rng: torch.Generator) -> Int[Tensor, "B V"]:
        """Draw points of which every second one is a neighbour at rest of the one before it."""
        first = self._random_rows(len(rest), self.config.vertices // 2, rng)
        distance = torch.cdist(rest.gather(1, first[..., None].expand(-1, -1, 3)), rest)
        near = distance.topk(NEIGHBOURS + 1, largest=False).indices[..., 1:]
        pick = self._random_index(NEIGHBOURS, (*first.shape, 1), rng)
        return torch.stack([first, near.gather(2, pick)[..., 0]], -1).flatten(1)

    def _random_rows(self, size: int, count: int, rng: torch.Generator) -> Int[Tensor, "B N"]:
        return torch.rand(size, POINTS, generator=rng, device=self.device).argsort(1)[:, :count]


def in_unit_sphere(
    points: Float[Tensor, "B P 3"], index: Int[Tensor, "B N"], radius: Float[Tensor, "B 1 1"] | None = None
) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B 1 1"]]:
    """Centre some of the points on the box of all, divide them by `radius` (None: that of all); give that of all."""
    centred = points - (points.amax(1, keepdim=True) + points.amin(1, keepdim=True)) / 2
    own = centred.norm(dim=-1).amax(1)[:, None, None]
    return centred.gather(1, index[..., None].expand(-1, -1, 3)) / (own if radius is None else radius), own
