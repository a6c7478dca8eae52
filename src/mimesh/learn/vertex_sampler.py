"""Random vertices of meshes in one topology: subsets with edges to measure, drawn evenly, in independent orders."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from ..core import geometry

if TYPE_CHECKING:
    from .body_sampler import DataConfig


def share_of(size: int, share: float, step: int) -> int:
    """Give how many of the `size` pairs of a step a share is: rounded up or down, so that it is right over the steps.

    Parts of a batch may be so small that rounding each in the same way would leave a share out.
    """
    before, after = (math.floor(round(share * size * count, 6)) for count in (step, step + 1))
    return after - before


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

    def _random_index(self, count: int, shape: tuple[int, ...], rng: torch.Generator) -> Int[Tensor, "..."]:
        return torch.randint(count, shape, generator=rng, device=self.device)

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
        count = (self.config.reflect * len(meshes[0]) + torch.rand((), generator=rng, device=self.device)).floor()
        sign = torch.where(torch.arange(len(meshes[0]), device=self.device) < count, -1.0, 1.0)
        for mesh in meshes:
            mesh[..., 0] *= sign.view(-1, *[1] * (mesh.ndim - 2))


def pairs_of_rows(index: Int[Tensor, "B N"]) -> Int[Tensor, "B E 2"]:
    """List the edges among drawn vertices of which every second one is a neighbour of the one before it."""
    return torch.arange(index.shape[1], device=index.device).view(1, -1, 2).expand(len(index), -1, -1)
