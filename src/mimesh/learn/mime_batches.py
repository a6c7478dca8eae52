"""Pairs for mime, made on the device: points of two people, and what is to be read from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ..bodies import RiggedBody
from .batches import TABLES, PairSource
from .people import Crowd, People, Surface, SurfaceBody

POINTS = 320
"""Of each mesh, unless the configuration says more."""
LOST = (0.08, 0.25)
"""Share of identities and of driving meshes that lack the points of a ball."""
BARE = (0.1, 0.2)
"""Share of identities and of driving meshes without normals, as point clouds are."""
HALF = 0.1
"""Share of driving meshes of which only one side is given, as a scan from there would see it."""
NOISE = 0.02
"""Most standard deviation of the noise on driving points (metres); mostly it is far less."""


@dataclass(frozen=True)
class MimeBatch:
    """B pairs, metres. The surfaces are whole and exact; what the network is given of them may be not."""

    identity: Surface
    driving: Surface
    truth: Surface
    """The identity's points in the driving pose."""
    given: tuple[tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"]], ...]
    """Points and normals of identity and of driving; those of the driving are not row by row those of `driving`."""


class MimeSource(PairSource):
    """Makes batches of one kind of data: NPT's table of plain people, or endless people of all kinds."""

    def _load(self, body: RiggedBody) -> None:
        super()._load(body)
        self.surface = SurfaceBody(body).to(self.device)
        self.crowd = Crowd(body, self.config.spread, self.device)

    def batch(self, size: int, step: int) -> MimeBatch:  # type: ignore[override]
        """The pairs of training step `step`."""
        rng = torch.Generator(self.device).manual_seed(self.seed * 1_000_003 + step)
        table = self.config.kind in TABLES
        shapes, poses, touching = (self._from_table if table else self._endless)(size, rng)
        people = [plain(shape, self.surface) for shape in shapes]
        if not table:
            drawn = [self.crowd.draw(size, rng) for _ in shapes]
            people = [one.where(some, other) for one, some, other in zip(people, touching, drawn, strict=True)]
        count = self.config.vertices or POINTS
        index = [
            self.surface.choose(who, count, rng, 0.0 if table else lost) for who, lost in zip(people, LOST, strict=True)
        ]
        identity, driving = (self.surface.posed(*given) for given in zip(people, poses, index, strict=True))
        truth = self.surface.posed(people[0], poses[1], index[0])
        if table:
            given = tuple((mesh.points, mesh.normals) for mesh in (identity, driving))
            return MimeBatch(identity, driving, truth, given)
        return MimeBatch(identity, driving, truth, self._damaged(identity, driving, rng))

    def _damaged(self, identity: Surface, driving: Surface, rng: torch.Generator):
        """Driving meshes with noise, some seen from one side only, and meshes whose normals are not known."""
        size, side = len(driving.points), self._side(driving.normals, rng)
        noise = torch.randn(driving.points.shape, generator=rng, device=self.device)
        noisy = _pick(driving.points, side) + NOISE * self._uniform(size, rng).square() * noise
        meshes = ((identity.points, identity.normals), (noisy, _pick(driving.normals, side)))
        return tuple(
            (points, normals * (self._uniform(size, rng) >= bare))
            for (points, normals), bare in zip(meshes, BARE, strict=True)
        )

    def _side(self, normals: Float[Tensor, "B N 3"], rng: torch.Generator) -> Int[Tensor, "B N"]:
        """All points, or of some meshes those that face one side, over and over."""
        size, count = normals.shape[:2]
        angle = 2 * math.pi * self._uniform(size, rng)
        side = torch.cat([angle.sin(), torch.zeros_like(angle), angle.cos()], -1)
        hidden = ((normals * side).sum(-1) <= 0) & (self._uniform(size, rng)[..., 0] < HALF)
        order = hidden.int().argsort(dim=1, stable=True)
        seen = (~hidden).sum(1, keepdim=True)
        return order.gather(1, torch.arange(count, device=self.device) % seen)

    def _uniform(self, size: int, rng: torch.Generator) -> Float[Tensor, "B 1 1"]:
        return torch.rand(size, 1, 1, generator=rng, device=self.device)


def _pick(values: Float[Tensor, "B N 3"], index: Int[Tensor, "B N"]) -> Float[Tensor, "B N 3"]:
    return values.gather(1, index[..., None].expand(-1, -1, 3))


def plain(shape: Float[Tensor, "B K"], surface: SurfaceBody) -> People:
    """People without garments, bumps or proportions of their own."""
    size, joints = len(shape), len(surface.parents)
    one = torch.ones(size, joints, device=shape.device)
    worn: Bool[Tensor, "B G"] = torch.arange(4, device=shape.device).expand(size, -1) == 0
    return People(shape, one, one, torch.zeros(size, 1, 5, device=shape.device), worn)
