"""Endless people as surfaces for mime: points anywhere on skin and garments, with joints and skinning weights known.

A person is the shipped human with a shape, garments, lengths and girths of each bone, and bumps. All of it is exact
under linear blend skinning, so one person in two poses is a true transfer.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ..bodies import RiggedBody
from ..bodies.dress import GARMENTS, dressed_body, load_garment
from ..bodies.sampled_body import bone_directions, kinds_of_bones
from ..core import geometry, surface_points

WAVES = 6
"""Of which a person's bumps are the sum."""
STRANGE, HEADS = 0.4, 0.6
"""Share of people with proportions of their own; logarithm of the most that their heads are larger by, beside those."""
LOST_REACH = 0.45
"""Largest radius of what a surface lacks (metres, at rest)."""


@dataclass(frozen=True)
class People:
    """Who B people are."""

    shape: Float[Tensor, "B K"]
    length: Float[Tensor, "B J"]
    """Of each bone, over that of the shape."""
    girth: Float[Tensor, "B J"]
    """The same across the bone."""
    bumps: Float[Tensor, "B W 5"]
    """Waves over the surface at rest: direction times frequency (radians a metre), phase, height (metres)."""
    worn: Bool[Tensor, "B G"]
    """Garments, one column each after the skin, which all wear."""

    def where(self, some: Bool[Tensor, " B"], others: People) -> People:
        """These people where `some` says so, and others elsewhere."""
        arrays = {}
        for field in dataclasses.fields(self):
            one, other = getattr(self, field.name), getattr(others, field.name)
            arrays[field.name] = torch.where(some.view(-1, *[1] * (one.ndim - 1)), one, other)
        return People(**arrays)


@dataclass(frozen=True)
class Surface:
    """Points of B people in poses, metres. Point i has the weights of its place on the surface, however it is posed."""

    points: Float[Tensor, "B N 3"]
    normals: Float[Tensor, "B N 3"]
    weights: Float[Tensor, "B N J"]
    """Skinning weights, rows sum to 1."""
    rotation: Float[Tensor, "B J 3 3"]
    """Of every joint in the world; at rest all are the unit matrix."""
    joints: Float[Tensor, "B J 3"]


class SurfaceBody(nn.Module):
    """Points spread evenly over a rigged body in all its garments, to be posed in any number on any device."""

    rest: Tensor
    normals: Tensor
    components: Tensor
    weights: Tensor
    joints: Tensor
    joint_components: Tensor
    bones: Tensor
    branching: Tensor
    piece: Tensor

    def __init__(self, body: RiggedBody, count: int = 20_000) -> None:
        super().__init__()
        dressed = dressed_body(body, GARMENTS)
        self.parents = body.parents
        face, share = surface_points.sample_surface(dressed.vertices, dressed.faces, count, np.random.default_rng(0))
        corners = dressed.faces[face]
        starts = np.cumsum([len(body.vertices), *(len(load_garment(name).vertices) for name in GARMENTS)])
        bones, branching = bone_directions(body)
        arrays = {
            "rest": surface_points.interpolate(dressed.vertices, corners, share).T,
            "normals": geometry.face_normals(dressed.vertices, dressed.faces)[face].T,
            "components": np.stack([surface_points.interpolate(c, corners, share).T for c in dressed.components]),
            "weights": surface_points.interpolate(dressed.weights, corners, share).T,
            "joints": body.joints,
            "joint_components": body.joint_components,
            "bones": bones,
        }
        for name, array in arrays.items():
            self.register_buffer(name, torch.from_numpy(np.ascontiguousarray(array)).float())
        self.register_buffer("branching", torch.from_numpy(branching))
        self.register_buffer("piece", torch.from_numpy(np.searchsorted(starts, corners[:, 0], side="right")))

    def choose(self, people: People, count: int, rng: torch.Generator, lost: float = 0.0) -> Int[Tensor, "B N"]:
        """Random points of what each of the people wears, without those of a ball that is lost to a share of them."""
        size, total = len(people.shape), self.rest.shape[1]
        key = torch.rand(size, total, generator=rng, device=self.rest.device)
        key = key + 2.0 * (~people.worn)[:, self.piece]
        ball = torch.randint(total, (size,), generator=rng, device=self.rest.device)
        reach = LOST_REACH * torch.rand(size, 1, generator=rng, device=self.rest.device)
        reach = reach * (torch.rand(size, 1, generator=rng, device=self.rest.device) < lost)
        apart = (self.rest[:, None] - self.rest[:, ball, None]).square().sum(0)
        key = key + (apart < reach.square())
        return key.topk(count, dim=1, largest=False, sorted=False).indices

    def posed(self, people: People, rotmat: Float[Tensor, "B J 3 3"], index: Int[Tensor, "B N"]) -> Surface:
        """Chosen points of people under local joint rotations, the root joint where it rests."""
        rotation, position, linear, back = self._joints(people, rotmat)
        rest = self.rest[:, index].transpose(0, 1)
        rest = rest + torch.einsum("bk,kcbn->bcn", people.shape, self.components[:, :, index])
        normal = self.normals[:, index].transpose(0, 1)
        rest = rest + self._bumps(people, index) * normal
        weights = self.weights[:, index].permute(1, 2, 0)
        offset = position - (linear @ self._rest_joints(people)[..., None])[..., 0]
        blended = (weights @ torch.cat([linear, offset[..., None], back], -1).flatten(2)).unflatten(2, (3, 7))
        points = (blended[..., :3] @ rest.mT[..., None])[..., 0] + blended[..., 3]
        normals = (blended[..., 4:] @ normal.mT[..., None])[..., 0]
        return Surface(points, nn.functional.normalize(normals, dim=-1), weights, rotation, position)

    def _rest_joints(self, people: People) -> Float[Tensor, "B J 3"]:
        return self.joints + torch.einsum("bk,kjc->bjc", people.shape, self.joint_components)

    def _joints(self, people: People, rotmat: Tensor):
        """World rotation and place of each joint, what it does to its bone, and to normals (inverse transpose)."""
        rest = self._rest_joints(people)
        length = torch.where(self.branching, people.girth, people.length)[..., None, None]
        girth = people.girth[..., None, None]
        along = self.bones[:, :, None] * self.bones[:, None]
        eye = torch.eye(3, device=rest.device)
        grown, shrunk = girth * eye + (length - girth) * along, eye / girth + (1 / length - 1 / girth) * along
        rotation, position = [rotmat[:, 0]], [rest[:, 0]]
        for j, parent in enumerate(self.parents[1:], 1):
            bone = rotation[parent] @ (grown[:, parent] @ (rest[:, j] - rest[:, parent])[..., None])
            position.append(position[parent] + bone[..., 0])
            rotation.append(rotation[parent] @ rotmat[:, j])
        turned = torch.stack(rotation, 1)
        return turned, torch.stack(position, 1), turned @ grown, turned @ shrunk

    def _bumps(self, people: People, index: Int[Tensor, "B N"]) -> Float[Tensor, "B 1 N"]:
        place = self.rest[:, index].transpose(0, 1)
        waves = people.bumps[..., :3] @ place + people.bumps[..., 3:4]
        return (waves.sin() * people.bumps[..., 4:]).sum(1, keepdim=True)


class Crowd:
    """Draws people; each call is a pure function of its generator."""

    def __init__(self, body: RiggedBody, spread: float, device: torch.device) -> None:
        self.components, self.joints, self.spread, self.device = len(body.components), len(body.joints), spread, device
        self.group = torch.from_numpy(kinds_of_bones(body)).to(device)
        self.head = torch.tensor([name == "Head" for name in body.joint_names], device=device)

    def draw(self, size: int, rng: torch.Generator) -> People:
        """Everyday people, and some with larger heads and bones of other proportions, alike on both sides."""
        shape = self.spread * self._normal(rng, size, self.components).clamp(-2.5, 2.5)
        odd = self._uniform(rng, size, 1) < STRANGE
        strange = odd * 0.3 + 0.06 * self._uniform(rng, size, 1)
        groups = int(self.group.max()) + 1
        drawn = [strange * self._normal(rng, size, groups).clamp(-2, 2) for _ in range(2)]
        larger = HEADS * odd * self._uniform(rng, size, 1) * self.head
        length, girth = ((scale[:, self.group] + larger).exp() for scale in drawn)
        height = 0.02 * self._uniform(rng, size, 1, 1).square() * self._normal(rng, size, WAVES, 1) / math.sqrt(WAVES)
        direction = 25.0 * self._normal(rng, size, WAVES, 3) * self._uniform(rng, size, WAVES, 1)
        bumps = torch.cat([direction, 2 * math.pi * self._uniform(rng, size, WAVES, 1), height], -1)
        worn = self._uniform(rng, size, 1 + len(GARMENTS)) < 0.25
        worn[:, 0] = True
        return People(shape, length, girth, bumps, worn)

    def _uniform(self, rng: torch.Generator, *size: int) -> Tensor:
        return torch.rand(*size, generator=rng, device=self.device)

    def _normal(self, rng: torch.Generator, *size: int) -> Tensor:
        return torch.randn(*size, generator=rng, device=self.device)
