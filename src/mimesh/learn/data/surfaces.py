"""Endless people as surfaces: points anywhere on skin and garments, with known joints and skinning weights.

A person is the shipped body with a shape, garments, a scale along and across each bone, and a bumpy surface. All of it
is exact under linear blend skinning, so one person in two poses is a true transfer.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ...bodies import RiggedBody
from ...bodies.dress import GARMENTS, dressed_body, load_garment
from ...bodies.sampled_body import bone_directions, kinds_of_bones
from ...core import geometry, surface_points
from .bodies import CPU, normal, on_device, scaled_joints, skinned_surface, uniform, world_rotations
from .characters import LEVELS, SMALLEST, flattened

WAVES = 6
"""Sines that a person's bumps are the sum of."""
BUMP_HEIGHT, BUMP_FREQUENCY = 0.02, 25.0
"""Largest height of the bumps (metres) and scale of their frequency (radians a metre); mostly they are far less."""
UNUSUAL = 0.4
"""Share of people with unusual proportions: bones of other lengths and girths, larger heads."""
USUAL_SPREAD, UNUSUAL_SPREAD = 0.06, 0.3
"""Largest standard deviation of the logarithm of a bone's scale; for unusual people the second is added."""
HEAD_SCALE = 0.6
"""Logarithm of the largest factor by which heads of unusual people are larger, beside those."""
GARMENT_SHARE = 0.25
"""Share of people who wear each garment."""
MAX_HOLE = 0.45
"""Largest radius of the ball whose points a damaged surface lacks (metres, at rest)."""


@dataclass(frozen=True)
class People:
    """B people, apart from their poses."""

    shape: Float[Tensor, "B K"]
    """Coefficients of the body model (standard deviations)."""
    length: Float[Tensor, "B J"]
    """Scale along each bone, beside that of the shape."""
    girth: Float[Tensor, "B J"]
    """Scale across each bone."""
    bumps: Float[Tensor, "B W 5"]
    """Waves over the surface at rest: direction times frequency (radians a metre), phase, height (metres)."""
    worn: Bool[Tensor, "B G"]
    """Which surfaces a person has: the skin in the first column, always true, then each garment."""
    level: Int[Tensor, " B"]
    """Low-poly version of the surface: 0 for the surface itself, k for that of `characters.LEVELS[k - 1]` triangles."""

    def where(self, some: Bool[Tensor, " B"], others: People) -> People:
        """Take these people where `some` is true, and `others` elsewhere."""
        arrays = {}
        for field in dataclasses.fields(self):
            one, other = getattr(self, field.name), getattr(others, field.name)
            arrays[field.name] = torch.where(some.view(-1, *[1] * (one.ndim - 1)), one, other)
        return People(**arrays)


@dataclass(frozen=True)
class PosedSurface:
    """Points of B people in poses (metres), with the joints and weights that move them."""

    points: Float[Tensor, "B N 3"]
    normals: Float[Tensor, "B N 3"]
    weights: Float[Tensor, "B N J"]
    """Skinning weights, rows sum to 1."""
    rotation: Float[Tensor, "B J 3 3"]
    """Of every joint in the world; at rest all are the identity matrix."""
    joints: Float[Tensor, "B J 3"]
    turning: Bool[Tensor, "B J"]
    """Whether the rotation of a joint is known: figures lack some joints."""
    placed: Bool[Tensor, "B J"]
    """Whether the position of a joint is known."""

    @classmethod
    def joined(cls, surfaces: Sequence[PosedSurface]) -> PosedSurface:
        names = (field.name for field in dataclasses.fields(cls))
        return cls(*(torch.cat([getattr(surface, name) for surface in surfaces]) for name in names))


class SurfaceBody:
    """A fixed set of points, spread evenly over a rigged body and all garments, to be posed in batches."""

    def __init__(
        self, body: RiggedBody, count: int = 20_000, low_poly: bool = False, device: torch.device = CPU
    ) -> None:
        garments = GARMENTS if body.name == "human" else ()
        dressed = dressed_body(body, garments) if garments else body
        self.pieces = 1 + len(garments)
        self.parents = body.parents
        face, share = surface_points.sample_surface(dressed.vertices, dressed.faces, count, np.random.default_rng(0))
        corners = dressed.faces[face]
        starts = np.cumsum([len(body.vertices), *(len(load_garment(name).vertices) for name in garments)])
        bones, branching = bone_directions(body)
        points = surface_points.interpolate(dressed.vertices, corners, share)
        normals = geometry.face_normals(dressed.vertices, dressed.faces)[face]
        components = np.stack([surface_points.interpolate(c, corners, share).T for c in dressed.components])
        arrays = (points.T, normals.T, components, surface_points.interpolate(dressed.weights, corners, share).T)
        self.rest, self.normals, self.components, self.weights, self.joints, self.joint_components, self.bones = (
            on_device(np.ascontiguousarray(array), device)
            for array in (*arrays, body.joints, body.joint_components, bones)
        )
        piece = np.searchsorted(starts, corners[:, 0], side="right")
        self.branching, self.piece = (torch.from_numpy(array).to(device) for array in (branching, piece))
        # Offsets to the points of the low-poly versions, and their normals (L, 2, 3, N).
        coarse = np.zeros((len(LEVELS) * low_poly, 2, 3, count))
        faces_of = np.searchsorted(starts, dressed.faces[:, 0], side="right")
        for number in range(len(starts) * low_poly):
            mine, its_faces = piece == number, dressed.faces[faces_of == number]
            # Garments have as many triangles for their points as the skin.
            counts = [max(round(level * mine.sum() / (piece == 0).sum()), SMALLEST) for level in LEVELS]
            flat = flattened(points[mine], normals[mine], dressed.vertices, its_faces, counts)
            flat[:, 0] -= points[mine]
            coarse[..., mine] = flat.swapaxes(-1, -2)
        self.coarse = on_device(coarse, device)

    def choose(self, people: People, count: int, rng: torch.Generator, missing: float = 0.0) -> Int[Tensor, "B N"]:
        """Choose random points of the surfaces that each person has; a share `missing` of them lack those of a ball.

        The points with the smallest keys are taken: random numbers below 1, raised by 1 within the ball, so that its
        points are taken last, and by 2 on garments that are not worn.
        """
        size, total = len(people.shape), self.rest.shape[1]
        key = uniform(rng, size, total)
        key = key + 2.0 * (~people.worn)[:, self.piece]
        centre = torch.randint(total, (size,), generator=rng, device=self.rest.device)
        radius = MAX_HOLE * uniform(rng, size, 1)
        radius = radius * (uniform(rng, size, 1) < missing)
        distance = (self.rest[:, None] - self.rest[:, centre, None]).square().sum(0)
        key = key + (distance < radius.square())
        return key.topk(count, dim=1, largest=False, sorted=False).indices

    def posed(self, people: People, rotmat: Float[Tensor, "B J 3 3"], index: Int[Tensor, "B N"]) -> PosedSurface:
        """Pose chosen points of people by local joint rotations; the root joint stays where it rests."""
        joints = self.joints + torch.einsum("bk,kjc->bjc", people.shape, self.joint_components)
        rotation = world_rotations(rotmat, self.parents)
        position, linear, normal_map = scaled_joints(
            joints, self.bones[None], self.branching, people.length, people.girth, rotation, self.parents
        )
        rest = self.rest[:, index].transpose(0, 1)
        rest = rest + torch.einsum("bk,kcbn->bcn", people.shape, self.components[:, :, index])
        normal = self.normals[:, index].transpose(0, 1)
        if len(self.coarse):
            flat, level = (people.level > 0)[:, None, None], (people.level - 1).clamp_min(0)[:, None]
            offset, faceted = self.coarse.permute(1, 0, 3, 2)[:, level, index].mT
            rest, normal = rest + flat * offset, torch.where(flat, faceted, normal)
        place = self.rest[:, index].transpose(0, 1)
        waves = people.bumps[..., :3] @ place + people.bumps[..., 3:4]
        rest = rest + (waves.sin() * people.bumps[..., 4:]).sum(1, keepdim=True) * normal
        weights = self.weights[:, index].permute(1, 2, 0)
        points, normals = skinned_surface(rest.mT, normal.mT, weights, (joints, position), linear, normal_map)
        known = torch.ones_like(position[..., 0], dtype=torch.bool)
        return PosedSurface(points, normals, weights, rotation, position, known, known)


class PeopleSampler:
    """Draws random people; each call is a pure function of its generator."""

    def __init__(self, body: RiggedBody, spread: float, device: torch.device) -> None:
        self.components, self.spread = len(body.components), spread
        self.pieces = 1 + len(GARMENTS) * (body.name == "human")
        self.group = torch.from_numpy(kinds_of_bones(body)).to(device)
        self.head = torch.tensor([name == "Head" for name in body.joint_names], device=device)

    def draw(self, size: int, rng: torch.Generator, low_poly: float = 0.0) -> People:
        """Draw people, some with unusual proportions, a share low-poly; left and right bones are scaled alike."""
        shape = self.spread * normal(rng, size, self.components).clamp(-2.5, 2.5)
        unusual = uniform(rng, size, 1) < UNUSUAL
        spread = unusual * UNUSUAL_SPREAD + USUAL_SPREAD * uniform(rng, size, 1)
        groups = int(self.group.max()) + 1
        drawn = [spread * normal(rng, size, groups).clamp(-2, 2) for _ in range(2)]
        larger = HEAD_SCALE * unusual * uniform(rng, size, 1) * self.head
        length, girth = ((scale[:, self.group] + larger).exp() for scale in drawn)
        bumps = random_bumps(size, rng)
        worn = uniform(rng, size, self.pieces) < GARMENT_SHARE
        worn[:, 0] = True
        level = random_levels(size, low_poly, rng)
        return People(shape, length, girth, without_bumps(bumps, level), worn, level)


def random_bumps(size: int, rng: torch.Generator) -> Float[Tensor, "B W 5"]:
    """Draw the bumps of surfaces, as in `People`."""
    # Squared uniform numbers: most surfaces are nearly smooth. The root of WAVES keeps the sum's height.
    height = BUMP_HEIGHT * uniform(rng, size, 1, 1).square() * normal(rng, size, WAVES, 1) / math.sqrt(WAVES)
    frequency = BUMP_FREQUENCY * normal(rng, size, WAVES, 3) * uniform(rng, size, WAVES, 1)
    return torch.cat([frequency, 2 * math.pi * uniform(rng, size, WAVES, 1), height], -1)


def random_levels(size: int, share: float, rng: torch.Generator) -> Int[Tensor, " B"]:
    """Draw the low-poly version of surfaces: 0 for all but a share of them. A share of 0 draws no numbers."""
    if not share:
        return torch.zeros(size, dtype=torch.long, device=rng.device)
    level = torch.randint(1, len(LEVELS) + 1, (size,), generator=rng, device=rng.device)
    return level * (uniform(rng, size) < share)


def without_bumps(bumps: Float[Tensor, "B W 5"], level: Int[Tensor, " B"]) -> Float[Tensor, "B W 5"]:
    """Remove the bumps of low-poly surfaces, whose triangles are flat."""
    return torch.where((level > 0)[:, None, None], torch.zeros_like(bumps), bumps)


def plain_people(shape: Float[Tensor, "B K"], surface: SurfaceBody) -> People:
    """Make people without garments, bumps or proportions of their own."""
    size, joints = len(shape), len(surface.parents)
    one = torch.ones(size, joints, device=shape.device)
    worn = torch.arange(surface.pieces, device=shape.device).expand(size, -1) == 0
    level = torch.zeros(size, dtype=torch.long, device=shape.device)
    return People(shape, one, one, torch.zeros(size, 1, 5, device=shape.device), worn, level)


def repeat_visible(hidden: Bool[Tensor, "B N"]) -> Int[Tensor, "B N"]:
    """Choose all points that are not hidden, repeated up to N; at least one is visible."""
    order = hidden.int().argsort(dim=1, stable=True)
    visible = (~hidden).sum(1, keepdim=True)
    return order.gather(1, torch.arange(hidden.shape[1], device=hidden.device) % visible)
