"""Scans of surfaces from one camera, for mime: points that the camera sees, with holes and noise."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

ELEVATION = math.radians(40)
"""Largest angle of the camera above or below the horizon."""
GRAZING = 0.1
"""Cosine of the angle between ray and normal below which a depth camera gets no point."""
CELL, CELLS = 0.1, 32
"""Size of the pixels in which points hide others (metres), and their number along a side: with 320 points a person has
one or two in each pixel on the side that is seen."""
THICKNESS = 0.12
"""Depth behind the nearest point of a pixel (metres) from which on a point is hidden: limbs are thinner than this."""
HOLES, MAX_RADIUS = 4, 0.15
"""Number of holes (hair, dark cloth, reflections) and their largest radius (metres)."""
MAX_DEPTH_NOISE = 0.02
"""Largest standard deviation of the noise along the camera's rays (metres); mostly it is far less."""
MAX_NORMAL_NOISE = 0.5
"""Largest standard deviation of the noise on the components of unit normals, which scans estimate from neighbours."""
FEWEST = 24
"""Visible points below which the whole surface is given."""


def scanned(
    points: Float[Tensor, "B N 3"], normals: Float[Tensor, "B N 3"], rng: torch.Generator
) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"]]:
    """Scan surfaces (metres), each from a random side: points and normals, repeated up to N."""
    size, device = len(points), points.device
    camera = _camera(size, rng, device)
    hidden = _hidden(points, normals, camera) | _in_holes(points, rng)
    hidden &= (~hidden).sum(1, keepdim=True) >= FEWEST
    index = repeat_visible(hidden)
    amount = torch.rand(2, size, 1, 1, generator=rng, device=device).square()
    depth = MAX_DEPTH_NOISE * amount[0] * torch.randn(*index.shape, 1, generator=rng, device=device)
    bent = MAX_NORMAL_NOISE * amount[1] * torch.randn(points.shape, generator=rng, device=device)
    ray = camera[:, None, 2]
    return (
        gather_points(points, index) + depth * ray,
        nn.functional.normalize(gather_points(normals, index) + bent, dim=-1),
    )


def repeat_visible(hidden: Bool[Tensor, "B N"]) -> Int[Tensor, "B N"]:
    """Choose all points that are not hidden, repeated up to N; at least one is visible."""
    order = hidden.int().argsort(dim=1, stable=True)
    visible = (~hidden).sum(1, keepdim=True)
    return order.gather(1, torch.arange(hidden.shape[1], device=hidden.device) % visible)


def gather_points(values: Float[Tensor, "B N C"], index: Int[Tensor, "B M"]) -> Float[Tensor, "B M C"]:
    """Select the values of points by their indices."""
    return values.gather(1, index[..., None].expand(-1, -1, values.shape[-1]))


def _camera(size: int, rng: torch.Generator, device: torch.device) -> Float[Tensor, "B 3 3"]:
    """Draw the axes of cameras in rows: right, up, and towards the camera."""
    around, above = torch.rand(2, size, generator=rng, device=device)
    angle, elevation = 2 * math.pi * around, ELEVATION * (2 * above - 1)
    zero = torch.zeros_like(angle)
    right = torch.stack([angle.cos(), zero, -angle.sin()], -1)
    towards = torch.stack([angle.sin() * elevation.cos(), elevation.sin(), angle.cos() * elevation.cos()], -1)
    return torch.stack([right, torch.linalg.cross(towards, right), towards], 1)


def _hidden(
    points: Float[Tensor, "B N 3"], normals: Float[Tensor, "B N 3"], camera: Float[Tensor, "B 3 3"]
) -> Bool[Tensor, "B N"]:
    """Tell which points face away from the camera, or lie behind another point of the same pixel."""
    seen = (points - points.mean(1, keepdim=True)) @ camera.mT
    pixel = (seen[..., :2] / CELL + CELLS / 2).long().clamp(0, CELLS - 1)
    pixel = pixel[..., 0] * CELLS + pixel[..., 1]
    depth = seen[..., 2]
    away = (normals * camera[:, None, 2]).sum(-1) < GRAZING
    front = torch.full((len(points), CELLS * CELLS), -math.inf, device=points.device)
    front = front.scatter_reduce(1, pixel, depth, "amax")
    return away | (depth < front.gather(1, pixel) - THICKNESS)


def _in_holes(points: Float[Tensor, "B N 3"], rng: torch.Generator) -> Bool[Tensor, "B N"]:
    """Tell which points lie in random balls around points; small balls are frequent."""
    size, count = points.shape[:2]
    centre = torch.randint(count, (size, HOLES), generator=rng, device=points.device)
    radius = MAX_RADIUS * torch.rand(size, 1, HOLES, generator=rng, device=points.device).square()
    return (torch.cdist(points, gather_points(points, centre)) < radius).any(-1)
