"""Things that people wear or carry, for training: hats, hair, backpacks, capes, shields, swords, shin guards.

Each is a primitive of random size that hangs rigidly on one joint, as props of characters do. What it is does not
matter, only that it is no part of a body: shapes, sizes and places are drawn far more widely than real ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ..bodies import RiggedBody
from ..bodies.anatomy import anatomy_of
from .primitives import SHAPES, sample_primitive

SHARE = 0.45
"""Share of figures that have each of the SLOTS props: two of three have one at least."""
SLOTS = 2
KINDS = 200
"""Primitives that props are drawn from."""
POINTS = 300
"""Most points of a prop."""
DENSITY = 1600.0
"""Points of a prop per square metre, as on bodies: 3,000 on 1.9 square metres."""
SIZE = (0.015, 0.3)
"""Half of the smallest and of the largest size of a prop along each of its axes (metres), drawn by their logarithm."""
OFFSET = 0.25
"""Largest distance of a prop's centre from its joint (metres), beside half of its length for props that are held."""


@dataclass(frozen=True)
class Props:
    """Props of B figures as S points each, at rest."""

    offset: Float[Tensor, "B S 3"]
    """From the joint that carries the point (metres of the shipped body)."""
    normals: Float[Tensor, "B S 3"]
    joint: Int[Tensor, "B S"]
    there: Bool[Tensor, "B S"]
    """Which points there are: as many as a prop's area asks for, none of props that a figure does not have."""


class PropSampler:
    """Draws props as points at rest, relative to their joints; each call is a pure function of its generator."""

    def __init__(self, body: RiggedBody, device: torch.device) -> None:
        rng = np.random.default_rng(0)
        sizes = np.exp(rng.uniform(np.log(SIZE[0]), np.log(SIZE[1]), (KINDS, 3)))
        drawn = [sample_primitive(SHAPES[k % len(SHAPES)], half, POINTS, rng) for k, half in enumerate(sizes)]
        points, normals = (np.stack([prop[k] for prop in drawn]) for k in range(2))
        # Thomsen's formula for the area of an ellipsoid, which is near enough for the others.
        a, b, c = (sizes**1.6).T
        area = 4 * np.pi * ((a * b + a * c + b * c) / 3) ** (1 / 1.6)
        arrays = (points, normals, np.clip(DENSITY * area, 4, POINTS), np.eye(3)[sizes.argmax(axis=1)] * sizes)
        self.points, self.normals, self.count, self.longest = (
            torch.from_numpy(array).float().to(device) for array in arrays
        )
        shares = anatomy_of(body.name).props
        self.joints = torch.tensor([body.joint(name) for name in shares], device=device)
        self.share = torch.tensor(list(shares.values()), device=device).cumsum(0)
        self.device = device

    def draw(self, size: int, rng: torch.Generator) -> Props:
        """Draw SLOTS props for each figure."""
        shape = (size, SLOTS)
        which = torch.randint(len(self.points), shape, generator=rng, device=self.device)
        # Half of the props stand straight in the figure's axes, as hats and backpacks do.
        straight = self._uniform(rng, *shape, 1, 1) < 0.5
        turn = torch.where(straight, torch.eye(3, device=self.device), random_rotations(shape, rng, self.device))
        direction = nn.functional.normalize(torch.randn(*shape, 3, generator=rng, device=self.device), dim=-1)
        centre = OFFSET * self._uniform(rng, *shape, 1) * direction
        # Half are held at one end, as swords are.
        held = self._uniform(rng, *shape, 1) < 0.5
        centre = centre + (turn @ (held * self.longest[which])[..., None])[..., 0]
        wanted = self.count[which] * (self._uniform(rng, *shape) < SHARE)
        joint = self.joints[torch.searchsorted(self.share, self._uniform(rng, *shape)).clamp_max(len(self.joints) - 1)]
        return Props(
            (self.points[which] @ turn.mT + centre[..., None, :]).flatten(1, 2),
            (self.normals[which] @ turn.mT).flatten(1, 2),
            joint.repeat_interleave(POINTS, dim=1),
            (torch.arange(POINTS, device=self.device) < wanted[..., None]).flatten(1),
        )

    def _uniform(self, rng: torch.Generator, *size: int) -> Tensor:
        return torch.rand(*size, generator=rng, device=self.device)


def random_rotations(size: tuple[int, ...], rng: torch.Generator, device: torch.device) -> Float[Tensor, "*B 3 3"]:
    """Draw uniform random rotations: Gram-Schmidt of normal vectors."""
    x, y = nn.functional.normalize(torch.randn(2, *size, 3, generator=rng, device=device), dim=-1)
    z = nn.functional.normalize(torch.linalg.cross(x, y), dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)
