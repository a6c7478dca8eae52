"""Characters of a pool and figures of primitives as surfaces, with proportions and props drawn at random.

Packs take turns, files are drawn from a pack: a pack of many files counts as much as one of few. All changes are exact
under linear blend skinning, so one figure in two poses is a true transfer.

Props are what people wear or carry: hats, hair, backpacks, capes, shields, swords, shin guards. Each is a primitive of
random size that hangs rigidly on one joint, as props of characters do. What it is does not matter, only that it is no
part of a body: shapes, sizes and places are drawn far more widely than real ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ...bodies import RiggedBody
from ...bodies.anatomy import anatomy_of
from ...bodies.sampled_body import bone_directions, kinds_of_bones
from .bodies import (
    CPU,
    gather_points,
    normal,
    on_device,
    posed_joints,
    scaled_joints,
    skinned,
    skinned_surface,
    uniform,
    world_rotations,
)
from .characters import CharacterSurface
from .endless import random_headings
from .primitives import SHAPES, sample_primitive
from .surfaces import MAX_HOLE, PosedSurface, random_bumps, random_levels, without_bumps

USUAL_SPREAD, UNUSUAL_SPREAD, UNUSUAL = 0.06, 0.3, 0.4
"""Largest standard deviation of the logarithm of a bone's scale, what is added for unusual figures, and their share."""
LARGE_HEADS, HEAD_SCALE = 0.25, 1.1
"""Share of figures with larger heads, and the logarithm of the largest factor: three times."""
SHORT_LIMBS, LIMB_SCALE = 0.15, 0.9
"""Share of figures with shorter arms and legs, and the logarithm of the smallest factor: two fifths."""
WITHOUT_ENDS = 0.1
"""Share of figures without hands, and without feet."""
LAST = 1e3
"""Added to the keys of points that are taken last."""
OWN_REST = 0.5
"""Share of identities in the rest pose of their file."""
PROP_SHARE = 0.45
"""Share of figures that have each of the PROP_SLOTS props: two of three have one at least."""
PROP_SLOTS = 2
PROP_KINDS = 200
"""Primitives that props are drawn from."""
PROP_POINTS = 300
"""Most points of a prop."""
PROP_DENSITY = 1600.0
"""Points of a prop per square metre, as on bodies: 3,000 on 1.9 square metres."""
PROP_SIZE = (0.015, 0.3)
"""Half of the smallest and of the largest size of a prop along each of its axes (metres), drawn by their logarithm."""
PROP_OFFSET = 0.25
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
        sizes = np.exp(rng.uniform(np.log(PROP_SIZE[0]), np.log(PROP_SIZE[1]), (PROP_KINDS, 3)))
        drawn = [sample_primitive(SHAPES[k % len(SHAPES)], half, PROP_POINTS, rng) for k, half in enumerate(sizes)]
        points, normals = (np.stack([prop[k] for prop in drawn]) for k in range(2))
        # Thomsen's formula for the area of an ellipsoid, which is near enough for the others.
        a, b, c = (sizes**1.6).T
        area = 4 * np.pi * ((a * b + a * c + b * c) / 3) ** (1 / 1.6)
        count, longest = np.clip(PROP_DENSITY * area, 4, PROP_POINTS), np.eye(3)[sizes.argmax(axis=1)] * sizes
        self.points, self.normals, self.count, self.longest = (
            on_device(array, device) for array in (points, normals, count, longest)
        )
        shares = anatomy_of(body.name).props
        self.joints = torch.tensor([body.joint(name) for name in shares], device=device)
        self.share = torch.tensor(list(shares.values()), device=device).cumsum(0)
        self.device = device

    def draw(self, size: int, rng: torch.Generator) -> Props:
        """Draw PROP_SLOTS props for each figure."""
        shape = (size, PROP_SLOTS)
        which = torch.randint(len(self.points), shape, generator=rng, device=self.device)
        # Half of the props stand straight in the figure's axes, as hats and backpacks do.
        straight = uniform(rng, *shape, 1, 1) < 0.5
        x, y = nn.functional.normalize(normal(rng, 2, *shape, 3), dim=-1)
        z = nn.functional.normalize(torch.linalg.cross(x, y), dim=-1)
        uniformly = torch.stack([x, torch.linalg.cross(z, x), z], -1)  # Gram-Schmidt of normal vectors
        turn = torch.where(straight, torch.eye(3, device=self.device), uniformly)
        direction = nn.functional.normalize(normal(rng, *shape, 3), dim=-1)
        centre = PROP_OFFSET * uniform(rng, *shape, 1) * direction
        # Half are held at one end, as swords are.
        held = uniform(rng, *shape, 1) < 0.5
        centre = centre + (turn @ (held * self.longest[which])[..., None])[..., 0]
        wanted = self.count[which] * (uniform(rng, *shape) < PROP_SHARE)
        joint = self.joints[torch.searchsorted(self.share, uniform(rng, *shape)).clamp_max(len(self.joints) - 1)]
        return Props(
            (self.points[which] @ turn.mT + centre[..., None, :]).flatten(1, 2),
            (self.normals[which] @ turn.mT).flatten(1, 2),
            joint.repeat_interleave(PROP_POINTS, dim=1),
            (torch.arange(PROP_POINTS, device=self.device) < wanted[..., None]).flatten(1),
        )


@dataclass(frozen=True)
class Figures:
    """B figures, apart from their poses."""

    which: Int[Tensor, " B"]
    """Row of each in the bank."""
    length: Float[Tensor, "B J"]
    """Scale along each bone."""
    girth: Float[Tensor, "B J"]
    """Scale across each bone."""
    bumps: Float[Tensor, "B W 5"]
    """As of `surfaces.People`."""
    level: Int[Tensor, " B"]
    """As of `surfaces.People`."""
    lacking: Bool[Tensor, "B J"]
    """Joints whose surface is missing."""
    props: Props


@dataclass(frozen=True)
class RestSurface:
    """Points of B figures at rest."""

    points: Float[Tensor, "B N 3"]
    normals: Float[Tensor, "B N 3"]
    weights: Float[Tensor, "B N J"]
    joints: Float[Tensor, "B J 3"]


class CharacterBank:
    """All figures of a training, each as the same number of points, to be posed in batches."""

    def __init__(self, surfaces: list[CharacterSurface], body: RiggedBody, device: torch.device = CPU) -> None:
        # Points and normals of the low-poly versions; people of primitives, which have none, keep their points.
        levels = max(0 if surface.coarse is None else len(surface.coarse) for surface in surfaces)
        coarse = [
            np.array([[surface.points, surface.normals]] * levels) if surface.coarse is None else surface.coarse
            for surface in surfaces
        ]
        self.coarse = on_device(np.stack(coarse), device)
        self.parents = body.parents
        self.points, self.normals, self.weights, self.joints, self.alignment = (
            on_device(np.stack([getattr(surface, name) for surface in surfaces]), device)
            for name in ("points", "normals", "weights", "joints", "alignment")
        )
        carrier, placed = (np.stack([getattr(surface, name) for surface in surfaces]) for name in ("carrier", "placed"))
        bones, branching = bone_directions(body)
        self.carrier, self.placed, self.branching = (
            torch.from_numpy(array).to(device) for array in (carrier, placed, branching)
        )
        self.strongest = self.weights.argmax(-1)
        self.bones = (self.alignment @ on_device(bones, device)[..., None])[..., 0]

    def choose(self, figures: Figures, count: int, rng: torch.Generator, missing: float) -> Int[Tensor, "B N"]:
        """Choose random points of figures and props, even by area; a share `missing` of them lack those of a ball.

        Each point has an exponentially distributed key whose rate is the area that it stands for, and the smallest keys
        are taken. Keys are raised where points are taken only if no others are left.
        """
        size, total = len(figures.which), self.points.shape[1]
        device = self.points.device
        strongest = torch.cat([self.strongest[figures.which], figures.props.joint], 1)
        area = (figures.length * figures.girth).gather(1, strongest)
        key = -uniform(rng, *area.shape).log() / area
        centre = torch.randint(total, (size, 1), generator=rng, device=device)
        radius = MAX_HOLE * uniform(rng, size, 1)
        radius = radius * (uniform(rng, size, 1) < missing)
        points = self.points[figures.which]
        offset = points - gather_points(points, centre)
        in_ball = offset.square().sum(-1) < radius.square()
        absent = torch.cat([figures.lacking.gather(1, strongest[:, :total]), ~figures.props.there], 1)
        key = key + LAST * absent
        key[:, :total] += LAST * in_ball
        return key.topk(count, dim=1, largest=False, sorted=False).indices

    def turning(self, which: Int[Tensor, " B"]) -> Bool[Tensor, "B J"]:
        """Tell which joints figures have."""
        return self.carrier[which] == torch.arange(len(self.parents), device=which.device)

    def shaped(self, figures: Figures, index: Int[Tensor, "B N"]) -> RestSurface:
        """Compute chosen points of figures at rest, with their proportions, props and bumps."""
        which, carrier, joints = figures.which, self.carrier[figures.which], self.joints[figures.which]
        rest, normal, weights = self._rest(figures, joints, index)
        length, girth = figures.length.gather(1, carrier), figures.girth.gather(1, carrier)
        unturned = torch.eye(3, device=rest.device).expand(*joints.shape, 3)
        position, linear, normal_map = scaled_joints(
            joints, self.bones[which], self.branching, length, girth, unturned, self.parents
        )
        points, normals = skinned_surface(rest, normal, weights, (joints, position), linear, normal_map)
        return RestSurface(points, normals, weights, position)

    def posed(self, figures: Figures, rest: RestSurface, rotation: Float[Tensor, "B J 3 3"]) -> PosedSurface:
        """Pose figures by the world rotations of their joints; the root joint stays where it rests."""
        which, alignment = figures.which, self.alignment[figures.which]
        of_carrier = self.carrier[which][..., None, None].expand(-1, -1, 3, 3)
        turned = (rotation @ alignment.mT).gather(1, of_carrier)
        unturned = torch.eye(3, device=turned.device).expand_as(turned)
        joints = posed_joints(unturned, rest.joints, turned, rest.joints[:, 0], self.parents)
        points = skinned(rest.points, rest.weights, unturned, rest.joints, turned, joints)
        blended = (rest.weights @ turned.flatten(2)).unflatten(2, (3, 3))
        return PosedSurface(
            points,
            nn.functional.normalize((blended @ rest.normals[..., None])[..., 0], dim=-1),
            rest.weights,
            turned @ alignment,
            joints,
            self.turning(which) & ~figures.lacking,
            self.placed[which],
        )

    def _rest(self, figures: Figures, joints: Float[Tensor, "B J 3"], index: Int[Tensor, "B N"]):
        """Give positions, normals and weights of chosen points of figures and props at rest, with bumps."""
        total, props = self.points.shape[1], figures.props
        of_prop, row = index >= total, (index - total).clamp_min(0)
        who, column = figures.which[:, None], index.clamp_max(total - 1)
        joint = props.joint.gather(1, row)
        place = gather_points(joints, joint) + gather_points(props.offset, row)
        prop_normal = gather_points(props.normals, row)
        points, normals = self.points[who, column], self.normals[who, column]
        if self.coarse.shape[1]:
            flat, level = (figures.level > 0)[:, None, None], (figures.level - 1).clamp_min(0)[:, None]
            points = torch.where(flat, self.coarse[who, level, 0, column], points)
            normals = torch.where(flat, self.coarse[who, level, 1, column], normals)
        rest = torch.where(of_prop[..., None], place, points)
        normal = torch.where(of_prop[..., None], prop_normal, normals)
        one_joint = nn.functional.one_hot(self.carrier[figures.which].gather(1, joint), len(self.parents)).float()
        weights = torch.where(of_prop[..., None], one_joint, self.weights[who, column])
        waves = rest @ figures.bumps[..., :3].mT + figures.bumps[..., None, :, 3]
        return rest + (waves.sin() @ figures.bumps[..., 4:]) * normal, normal, weights


def rows_by_group(groups: list[str], device: torch.device) -> dict[str, Int[Tensor, " _"]]:
    """List the rows of a bank by the group of each."""
    return {
        group: torch.tensor([i for i, other in enumerate(groups) if other == group], device=device)
        for group in dict.fromkeys(groups)
    }


def pick_rows(rows: list[Int[Tensor, " _"]], group: Int[Tensor, " B"], place: Float[Tensor, " B"]) -> Int[Tensor, " B"]:
    """Pick a row of each given group, at a place from 0 to 1 in the list of its rows."""
    of_all = torch.stack([some[(place * len(some)).long()] for some in rows])
    return of_all[group, torch.arange(len(group))]


class FigureSampler:
    """Draws figures of a bank; each call is a pure function of its generator."""

    def __init__(self, surfaces: list[CharacterSurface], body: RiggedBody, device: torch.device) -> None:
        self.rows = list(rows_by_group([surface.pack for surface in surfaces], device).values())
        self.group = torch.from_numpy(kinds_of_bones(body)).to(device)
        names, anatomy, self.device = body.joint_names, anatomy_of(body.name), device
        self.head = torch.tensor([name == "Head" for name in names], device=device)
        self.limbs = torch.tensor([name in anatomy.long_bones for name in names], device=device)
        self.ends = torch.tensor([[name in end for name in names] for end in anatomy.ends], device=device)
        self.props = PropSampler(body, device)

    def draw(self, size: int, rng: torch.Generator, low_poly: float = 0.0) -> Figures:
        """Draw figures, a share of them low-poly; left and right bones are scaled alike."""
        pack = torch.randint(len(self.rows), (size,), generator=rng, device=self.device)
        place = uniform(rng, size)
        which = pick_rows(self.rows, pack, place)
        spread = (uniform(rng, size, 1) < UNUSUAL) * UNUSUAL_SPREAD + USUAL_SPREAD * uniform(rng, size, 1)
        groups = int(self.group.max()) + 1
        drawn = [spread * normal(rng, size, groups).clamp(-2, 2) for _ in range(2)]
        larger = (uniform(rng, size, 1) < LARGE_HEADS) * HEAD_SCALE * uniform(rng, size, 1) * self.head
        shorter = (uniform(rng, size, 1) < SHORT_LIMBS) * LIMB_SCALE * uniform(rng, size, 1) * self.limbs
        length = (drawn[0][:, self.group] + larger - shorter).exp()
        girth = (drawn[1][:, self.group] + larger).exp()
        lacking = ((uniform(rng, size, len(self.ends), 1) < WITHOUT_ENDS) & self.ends).any(1)
        bumps = random_bumps(size, rng)
        props = self.props.draw(size, rng)
        level = random_levels(size, low_poly, rng)
        return Figures(which, length, girth, without_bumps(bumps, level), level, lacking, props)


class CharacterPairs:
    """Draws pairs of characters of a bank; each call is a pure function of its arguments."""

    def __init__(
        self,
        surfaces: list[CharacterSurface],
        body: RiggedBody,
        device: torch.device,
        count: int,
        heading: float,
        missing: tuple[float, float],
        low_poly: float = 0.0,
    ) -> None:
        """Put characters on the device.

        Args:
            count: points of each mesh.
            heading: by which identities at rest are turned at most, in radians.
            missing: share of identities and of driving meshes that lack the points of a ball.
            low_poly: share of figures that are low-poly.
        """
        self.bank, self.figures = CharacterBank(surfaces, body, device), FigureSampler(surfaces, body, device)
        self.count, self.heading, self.missing, self.low_poly = count, heading, missing, low_poly
        self.parents = body.parents

    def draw(
        self, poses: Float[Tensor, "2 B J 3 3"], rng: torch.Generator
    ) -> tuple[PosedSurface, PosedSurface, PosedSurface]:
        """Draw identities, driving characters and truths in poses of the shipped body (local rotations).

        Half of the identities stand as in their files.
        """
        size = poses.shape[1]
        identity, driving = (self.figures.draw(size, rng, self.low_poly) for _ in range(2))
        index = [
            self.bank.choose(figures, self.count, rng, share)
            for figures, share in zip((identity, driving), self.missing, strict=True)
        ]
        has, both_have = self.bank.turning(identity.which), self.bank.turning(driving.which)
        both_have = both_have & has  # joints that one of two lacks stay straight in both, so that the truth is exact
        rest = random_headings(size, self.heading, rng)[:, None] @ self.bank.alignment[identity.which]
        posed = world_rotations(of_known(poses[0], has), self.parents)
        own = uniform(rng, size, 1, 1, 1) < OWN_REST
        turned = world_rotations(of_known(poses[1], both_have), self.parents)
        surface, other = self.bank.shaped(identity, index[0]), self.bank.shaped(driving, index[1])
        return (
            self.bank.posed(identity, surface, torch.where(own, rest, posed)),
            self.bank.posed(driving, other, turned),
            self.bank.posed(identity, surface, turned),
        )


def of_known(local: Float[Tensor, "B J 3 3"], known: Bool[Tensor, "B J"]) -> Float[Tensor, "B J 3 3"]:
    """Keep the rotations of known joints; the others turn with their parents."""
    return torch.where(known[..., None, None], local, torch.eye(3, device=local.device))


def share_of(size: int, share: float, step: int) -> int:
    """Give how many of the `size` pairs of a step a share is: rounded up or down, so that it is right over the steps.

    Parts of a batch may be so small that rounding each in the same way would leave a share out.
    """
    before, after = (math.floor(round(share * size * count, 6)) for count in (step, step + 1))
    return after - before
