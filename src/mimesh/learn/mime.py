"""mime: reads the joints of a mesh out of points of its surface, and moves one mesh by the joints of another.

Each mesh is read alone: tokens, some of them joints, attend to the points; then every joint looks at the points near it
in its own frame, where a forearm is a forearm in any pose, and mends its frame, a few times over. Reading an identity
also gives skinning weights of any number of vertices. A result is then linear blend skinning of the identity's own
vertices from its own joints to the driving's rotations, which carries all detail along (clips: `methods/mime.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from ..bodies import RiggedBody
from .joint_frames import GEOMETRY, Frames, Mending, turn
from .skinning import posed_joints, skinned
from .tokens import Block, rms, zero

POINTS = 512
"""That are read of a mesh where it is used; training takes fewer."""
OCTAVES = 5
"""Of sines and cosines that a position becomes."""


@dataclass(frozen=True)
class MimeConfig:
    """Switches of the model."""

    width: int = 128
    """Channels of a token."""
    heads: int = 4
    latents: int = 32
    """Tokens beside those of the joints."""
    blocks: int = 4
    """Of self-attention; every second one looks at the points first."""
    mendings: int = 3
    """How often the joints look at the points near them and mend their frames."""
    near: int = 32
    """Points that a joint then looks at."""
    local: int = 64
    """Channels of a point in a joint's frame."""
    weighing: int = 32
    """Channels of a vertex in a joint's frame, for the skinning weights."""


@dataclass(frozen=True)
class Reading:
    """What is known of B meshes, in the units of their points."""

    tokens: Float[Tensor, "B K C"]
    rotations: tuple[Float[Tensor, "B J 3 3"], ...]
    """Of every joint in the world, one for the first estimate and one after each mending."""
    joints: tuple[Float[Tensor, "B J 3"], ...]
    scale: Float[Tensor, "B 1 1"]
    """Root mean square distance of the points from their mean."""

    def part(self, which: slice) -> Reading:
        """Of some of the meshes."""
        rotations, joints = (tuple(found[which] for found in all_of) for all_of in (self.rotations, self.joints))
        return Reading(self.tokens[which], rotations, joints, self.scale[which])

    @property
    def rotation(self) -> Float[Tensor, "B J 3 3"]:
        """The last one."""
        return self.rotations[-1]

    @property
    def place(self) -> Float[Tensor, "B J 3"]:
        """The last joints."""
        return self.joints[-1]


class Mime(nn.Module):
    """The network; the skeleton's joints are those of the body that it is trained on."""

    stand: Tensor
    octaves: Tensor

    def __init__(self, config: MimeConfig, body: RiggedBody) -> None:
        super().__init__()
        self.config, self.parents = config, body.parents
        stand, middle = _standing(body)
        self.register_buffer("stand", stand, persistent=False)
        self.register_buffer("octaves", 2.0 ** torch.arange(OCTAVES) * math.pi / 2, persistent=False)
        c, joints = config.width, len(body.parents)
        self.embed = nn.Linear(6 + 6 * OCTAVES, c)
        self.mix = nn.Linear(c, c)
        self.tokens = nn.Parameter(0.5 * torch.randn(1, config.latents + joints, c))
        self.blocks = nn.ModuleList(Block(c, config.heads, looks=i % 2 == 0) for i in range(config.blocks))
        self.first = zero(nn.Linear(c, 9))
        self.mending = Mending(middle, c, config.heads, config.local, config.near)
        self.weigh = Weighing(config, joints)

    def read(self, points: Float[Tensor, "B N 3"], normals: Float[Tensor, "B N 3"]) -> Reading:
        """Joints of meshes from points of their surface, evenly spread, in any place, size and order.

        Normals are of unit length, or zero where they are not known.
        """
        centre = points.mean(1, keepdim=True)
        scale = (points - centre).square().sum(-1, keepdim=True).mean(1, keepdim=True).sqrt()
        x = (points - centre) / scale
        seen = self._seen(x, normals)
        tokens = self.tokens.expand(len(x), -1, -1)
        for block in self.blocks:
            tokens = block(tokens, seen)
        guess = self.first(rms(tokens[:, self.config.latents :])).float()
        rotation, joints = turn(guess[..., :6]), self.stand + guess[..., 6:]
        rotations, places = [rotation], [joints]
        known = (x, normals, self.mending.seen(seen))
        for _ in range(self.config.mendings):
            frames = Frames(rotation.detach(), joints.detach())
            tokens, rotation, joints = self.mending(tokens, frames, known)
            rotations.append(rotation)
            places.append(joints)
        return Reading(tokens, tuple(rotations), tuple(p * scale + centre for p in places), scale)

    def weights(
        self, reading: Reading, vertices: Float[Tensor, "B V 3"], normals: Float[Tensor, "B V 3"]
    ) -> Float[Tensor, "B V J"]:
        """Logarithms of the skinning weights of vertices of the meshes that were read, up to a constant a vertex."""
        return self.weigh(reading, vertices, normals)

    def moved(
        self,
        vertices: Float[Tensor, "B V 3"],
        scores: Float[Tensor, "B V J"],
        own: Reading,
        other: Reading,
        root: Float[Tensor, "B 3"] | None = None,
    ) -> Float[Tensor, "B V 3"]:
        """Vertices of the meshes read as `own` in the pose of `other`, the root joint at `root` (None: where it is)."""
        with torch.autocast(vertices.device.type, enabled=False):
            root = own.place[:, 0] if root is None else root
            place = posed_joints(own.rotation, own.place, other.rotation, root, self.parents)
            held = scores.float().softmax(-1)
            return skinned(vertices, held, own.rotation, own.place, other.rotation, place)

    def forward(
        self, identity: tuple[Tensor, Tensor], driving: tuple[Tensor, Tensor]
    ) -> tuple[Reading, Reading, Float[Tensor, "B N J"]]:
        """Read both (points and normals each) in one go, and weigh the first half of the identity's points."""
        both = self.read(*(torch.cat(pair) for pair in zip(identity, driving, strict=True)))
        size = len(identity[0])
        own, other = both.part(slice(size)), both.part(slice(size, None))
        few = slice(identity[0].shape[1] // 2)
        return own, other, self.weights(own, identity[0][:, few], identity[1][:, few])

    def estimate_flops(self, vertices: int, points: int) -> float:
        """Floating-point operations of a transfer with so many points of each mesh: two for each use of a weight."""
        looks = 2 * self.config.width**2 * ((self.config.blocks + 1) // 2)
        times, joints, near = self.config.mendings, len(self.parents), min(self.config.near, points)
        of_points = _numbers(self.embed, self.mix, self.mending.seen) + looks
        of_near = times * _numbers(self.mending.geometry, self.mending.score)
        of_tokens = _numbers(self.blocks) - looks + times * _numbers(self.mending.block, self.mending.pooled)
        read = of_points * points + of_tokens * (self.config.latents + joints) + of_near * joints * near
        return 2.0 * (2 * read + _numbers(self.weigh.geometry, self.weigh.hidden) * joints * vertices)

    def _seen(self, x: Float[Tensor, "B N 3"], normals: Float[Tensor, "B N 3"]) -> Float[Tensor, "B N C"]:
        waves = (x[..., None] * self.octaves).flatten(-2)
        h = self.embed(torch.cat([x, normals, waves.sin(), waves.cos()], -1))
        return rms(h + self.mix(F.relu(h)))


class Weighing(nn.Module):
    """How much each joint holds a vertex, from where the vertex is in its frame."""

    def __init__(self, config: MimeConfig, joints: int) -> None:
        super().__init__()
        h = config.weighing
        self.latents = config.latents
        self.geometry, self.token = nn.Linear(GEOMETRY, h, bias=False), nn.Linear(config.width, h)
        self.joint = nn.Parameter(torch.zeros(1, joints, h))
        self.hidden, self.out = nn.Linear(h, h), nn.Linear(h, 1)

    def forward(self, reading: Reading, vertices: Tensor, normals: Tensor) -> Float[Tensor, "B V J"]:
        unit = reading.scale.detach()
        frames = Frames(reading.rotation.detach(), reading.place.detach() / unit)
        known = frames.of(vertices[:, None] / unit[:, None], normals[:, None])
        token = self.token(rms(reading.tokens[:, self.latents :])) + self.joint
        h = F.relu(self.hidden(F.relu(self.geometry(known) + token[:, :, None])))
        return (self.out(h)[..., 0].float() - known[..., 3].float()).mT


def _numbers(*modules: nn.Module) -> int:
    return sum(p.numel() for module in modules for p in module.parameters())


def _standing(body: RiggedBody) -> tuple[Float[Tensor, "J 3"], Float[Tensor, "J 3"]]:
    """Joints at rest, and the middle of each one's surface seen from there, in the units of `Mime.read`."""
    centre = body.vertices.mean(axis=0)
    scale = np.sqrt(np.square(body.vertices - centre).sum(axis=1).mean())
    share = body.weights / np.maximum(body.weights.sum(axis=0), 1e-9)
    middle = share.T @ body.vertices - body.joints
    return torch.from_numpy((body.joints - centre) / scale).float(), torch.from_numpy(middle / scale).float()
