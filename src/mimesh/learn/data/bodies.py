"""Body kinematics and linear blend skinning in torch (batched, differentiable twins of the NumPy ones), random numbers.

`TorchBody` poses the people that `RiggedBody` poses, thousands a second on any device; a test compares the two.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ...bodies import RiggedBody
from ...bodies.joint_ranges import ranges_of
from ...bodies.sampling import rotvec_to_rotmat as numpy_rotmat
from ...bodies.sampling import sample_pose

CPU = torch.device("cpu")


class TorchBody:
    """A RiggedBody whose arrays are tensors with coordinates as the first axis.

    In that layout skinning is one matrix product and three fused multiply-adds over long rows: six times as many bodies
    a second on two cores as with vertices first.
    """

    def __init__(self, body: RiggedBody, dtype: torch.dtype = torch.float32, device: torch.device = CPU) -> None:
        self.parents = body.parents
        arrays = (body.vertices.T, body.components.transpose(0, 2, 1), body.weights.T)
        self.rest, self.components, self.weights, self.joints, self.joint_components = (
            torch.from_numpy(array).to(device, dtype).contiguous()
            for array in (*arrays, body.joints, body.joint_components)
        )

    def posed(
        self, shape: Float[Tensor, "B K"], rotmat: Float[Tensor, "B J 3 3"], index: Int[Tensor, "B N"] | None = None
    ) -> Float[Tensor, "B N 3"]:
        """Compute vertices of people under local joint rotations; `index` picks vertices before any work is done."""
        transforms = self.skinning_transforms(shape, rotmat).flatten(2)
        if index is None:
            rest = self.rest + (shape @ self.components.flatten(1)).unflatten(1, self.rest.shape)
            blended = (transforms.mT.flatten(0, 1) @ self.weights).unflatten(0, (len(shape), 3, 4))
        else:
            rest = self.rest[:, index].transpose(0, 1)
            rest = rest + torch.einsum("bk,kcbn->bcn", shape, self.components[:, :, index])
            blended = (transforms.mT @ self.weights[:, index].transpose(0, 1)).unflatten(1, (3, 4))
        moved = blended[:, :, 3]
        for c in range(3):
            moved = torch.addcmul(moved, blended[:, :, c], rest[:, None, c])
        return moved.mT

    def skinning_transforms(
        self, shape: Float[Tensor, "B K"], rotmat: Float[Tensor, "B J 3 3"]
    ) -> Float[Tensor, "B J 3 4"]:
        """Compute the 3x4 matrix that each joint applies to a rest point: forward kinematics from the root outwards."""
        joints = self.joints + torch.einsum("bk,kjc->bjc", shape, self.joint_components)
        rotation: list[Tensor] = []
        position: list[Tensor] = []
        for j, parent in enumerate(self.parents):
            if parent < 0:
                rotation.append(rotmat[:, j])
                position.append(joints[:, j])
            else:
                bone = (joints[:, j] - joints[:, parent])[..., None]
                rotation.append(rotation[parent] @ rotmat[:, j])
                position.append(position[parent] + (rotation[parent] @ bone)[..., 0])
        turned = torch.stack(rotation, 1)
        offset = torch.stack(position, 1)[..., None] - turned @ joints[..., None]
        return torch.cat([turned, offset], dim=-1)


def on_device(array: np.ndarray, device: torch.device) -> Tensor:
    """Copy an array to a device in float32."""
    return torch.from_numpy(array).float().to(device)


def copied_to(device: torch.device, value: Any) -> Any:
    """Copy a tensor to a device, or a tuple or dataclass with all tensors in it."""
    if isinstance(value, Tensor):
        return value.to(device)
    if isinstance(value, tuple):
        return tuple(copied_to(device, part) for part in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = {field.name: copied_to(device, getattr(value, field.name)) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **parts)
    return value


def numbers_of_step(seed: int, step: int, device: torch.device) -> torch.Generator:
    """Make the random numbers of a step of a training; seeds are a million steps apart."""
    return torch.Generator(device).manual_seed(seed * 1_000_003 + step)


def uniform(rng: torch.Generator, *size: int) -> Tensor:
    """Draw numbers from 0 to 1 on the device of a generator."""
    return torch.rand(size, generator=rng, device=rng.device)


def normal(rng: torch.Generator, *size: int) -> Tensor:
    """Draw normal numbers on the device of a generator."""
    return torch.randn(size, generator=rng, device=rng.device)


def scaled_joints(
    rest: Float[Tensor, "B J 3"],
    bones: Float[Tensor, "#B J 3"],
    branching: Bool[Tensor, " J"],
    length: Float[Tensor, "B J"],
    girth: Float[Tensor, "B J"],
    turned: Float[Tensor, "B J 3 3"],
    parents: tuple[int, ...],
) -> tuple[Float[Tensor, "B J 3"], Float[Tensor, "B J 3 3"], Float[Tensor, "B J 3 3"]]:
    """Compute positions of joints, and each joint's linear map of rest points and of rest normals, under bone scales.

    A joint scales its surface by `length` along its bone's direction d and by `girth` across, then rotates it:
    S = girth 1 + (length - girth) d d^T. Normals are mapped by the inverse transpose, which has 1 / girth and
    1 / length in their place. Where bones branch there is no one direction, and `girth` is used for both.

    Args:
        rest: joints at rest.
        bones: direction of each joint's bone at rest.
        branching: joints with several bones.
        turned: rotation of each joint from rest, in the world.
    """
    length = torch.where(branching, girth, length)[..., None, None]
    girth = girth[..., None, None]
    along = bones[..., :, None] * bones[..., None, :]
    eye = torch.eye(3, device=rest.device)
    scaling, inverse = girth * eye + (length - girth) * along, eye / girth + (1 / length - 1 / girth) * along
    position = [rest[:, 0]]
    for j, parent in enumerate(parents[1:], 1):
        bone = turned[:, parent] @ (scaling[:, parent] @ (rest[:, j] - rest[:, parent])[..., None])
        position.append(position[parent] + bone[..., 0])
    return torch.stack(position, 1), turned @ scaling, turned @ inverse


def skinned_surface(
    points: Float[Tensor, "B N 3"],
    normals: Float[Tensor, "B N 3"],
    weights: Float[Tensor, "B N J"],
    joints: tuple[Float[Tensor, "B J 3"], Float[Tensor, "B J 3"]],
    linear: Float[Tensor, "B J 3 3"],
    normal_map: Float[Tensor, "B J 3 3"],
) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"]]:
    """Skin points and unit normals linearly by the joints' linear maps, such as those of `scaled_joints`.

    Args:
        joints: positions at rest, and where the maps leave them.
        linear: map of each joint's points, about the joint.
        normal_map: map of its normals.
    """
    rest, position = joints
    offset = position - (linear @ rest[..., None])[..., 0]
    # Of each joint the 7 columns of both maps and the offset are blended together, in one matrix product.
    maps = torch.cat([linear, offset[..., None], normal_map], -1)
    blended = (weights @ maps.flatten(2)).unflatten(2, (3, 7))
    moved = (blended[..., :3] @ points[..., None])[..., 0] + blended[..., 3]
    return moved, nn.functional.normalize((blended[..., 4:] @ normals[..., None])[..., 0], dim=-1)


def world_rotations(local: Float[Tensor, "B J 3 3"], parents: tuple[int, ...]) -> Float[Tensor, "B J 3 3"]:
    """Multiply local rotations along the skeleton."""
    world = [local[:, 0]]
    for j, parent in enumerate(parents[1:], 1):
        world.append(world[parent] @ local[:, j])
    return torch.stack(world, 1)


def rotvec_to_rotmat(rotvec: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3 3"]:
    """Convert rotation vectors (radians) to rotation matrices by Rodrigues' formula."""
    angle = rotvec.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    x, y, z = (rotvec / angle).unbind(-1)
    sine, cosine = angle.sin()[..., None], angle.cos()[..., None]
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    eye = torch.eye(3, dtype=rotvec.dtype, device=rotvec.device)
    return eye + sine * cross + (1.0 - cosine) * (cross @ cross)


def gather_points(values: Float[Tensor, "B N C"], index: Int[Tensor, "B M"]) -> Float[Tensor, "B M C"]:
    """Select the values of points by their indices."""
    return values.gather(1, index[..., None].expand(-1, -1, values.shape[-1]))


def posed_joints(
    rotation: Float[Tensor, "B J 3 3"],
    joints: Float[Tensor, "B J 3"],
    target: Float[Tensor, "B J 3 3"],
    root: Float[Tensor, "B 3"],
    parents: tuple[int, ...],
) -> Float[Tensor, "B J 3"]:
    """Compute joint positions after each joint turns from `rotation` to `target` (world); bones keep their lengths."""
    position = [root]
    for j, parent in enumerate(parents[1:], 1):
        bone = rotation[:, parent].mT @ (joints[:, j] - joints[:, parent])[..., None]
        position.append(position[parent] + (target[:, parent] @ bone)[..., 0])
    return torch.stack(position, 1)


def skinned(
    vertices: Float[Tensor, "B V 3"],
    weights: Float[Tensor, "B V J"],
    rotation: Float[Tensor, "B J 3 3"],
    joints: Float[Tensor, "B J 3"],
    target: Float[Tensor, "B J 3 3"],
    target_joints: Float[Tensor, "B J 3"],
) -> Float[Tensor, "B V 3"]:
    """Skin vertices linearly: each joint moves them from its frame (rotation, joints) to its target frame."""
    turned = target @ rotation.mT
    offset = target_joints - (turned @ joints[..., None])[..., 0]
    blended = (weights @ torch.cat([turned, offset[..., None]], -1).flatten(2)).unflatten(2, (3, 4))
    return (blended[..., :3] @ vertices[..., None])[..., 0] + blended[..., 3]


@cache
def extreme_vertices(body: RiggedBody) -> Int[np.ndarray, " N"]:
    """Find the vertices that are outermost (along an axis, or from the centre) in any of 400 random poses.

    Centre and radius of a posed body follow from these alone, within a hundredth or two of the radius. Posing takes
    seconds, so a body's answer is kept.
    """
    found: list[int] = []
    usual, widest = ranges_of(body)
    for i in range(400):
        limits = usual if i % 2 else widest
        vertices = body.posed(np.zeros(1), numpy_rotmat(sample_pose(body, 0, i, limits)))
        centre = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
        found += [*vertices.argmax(axis=0), *vertices.argmin(axis=0)]
        found += np.argsort(np.linalg.norm(vertices - centre, axis=1))[-3:].tolist()
    return np.unique(found)
