"""mime: reads the joints of a mesh out of points of its surface, and moves one mesh by the joints of another.

Each mesh is read alone: tokens, some of them joints, attend to the points; then every joint looks at the points near it
in its own frame, where a forearm is a forearm in any pose, and mends its frame, a few times. Reading an identity also
gives skinning weights of any number of vertices. A result is then linear blend skinning of the identity's own vertices
from its own joints to the driving's rotations: detail is carried along, and a frame costs one reading.
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
from .skinning import posed_joints, skinned

OCTAVES = 5
"""Of sines and cosines that a position becomes."""
GEOMETRY = 10
"""Numbers that describe a point in a joint's frame."""
CLOSE = 4.0
"""What positions in a joint's frame are multiplied by."""


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
    near: int = 48
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

    middle: Tensor
    stand: Tensor
    octaves: Tensor

    def __init__(self, config: MimeConfig, body: RiggedBody) -> None:
        super().__init__()
        self.config, self.parents = config, body.parents
        stand, middle = _standing(body)
        self.register_buffer("stand", stand, persistent=False)
        self.register_buffer("middle", middle, persistent=False)
        self.register_buffer("octaves", 2.0 ** torch.arange(OCTAVES) * math.pi / 2, persistent=False)
        c, joints = config.width, len(body.parents)
        self.embed = nn.Linear(6 + 6 * OCTAVES, c)
        self.mix = nn.Linear(c, c)
        self.tokens = nn.Parameter(0.5 * torch.randn(1, config.latents + joints, c))
        self.blocks = nn.ModuleList(Block(c, config.heads, looks=i % 2 == 0) for i in range(config.blocks))
        self.first = zero(nn.Linear(c, 9))
        self.mendings = nn.ModuleList(Mending(config) for _ in range(config.mendings))
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
        for mending in self.mendings:
            frame = Frames(rotation.detach(), joints.detach(), self.middle)
            tokens, rotation, joints = mending(tokens, frame, x, normals, seen)
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
        """Read both (points and normals each) in one go, and weigh the identity's points."""
        both = self.read(*(torch.cat(pair) for pair in zip(identity, driving, strict=True)))
        size = len(identity[0])
        own, other = both.part(slice(size)), both.part(slice(size, None))
        return own, other, self.weights(own, *identity)

    def estimate_flops(self, vertices: int, points: int) -> float:
        """Floating-point operations of a transfer with so many points of each mesh: two for each use of a weight."""
        looks = [layer for block in self.blocks if block.look for layer in (block.look.key, block.look.value)]
        of_points = _numbers(self.embed, self.mix, *looks, *(mending.seen for mending in self.mendings))
        of_near = _numbers(*(layer for mending in self.mendings for layer in (mending.geometry, mending.score)))
        of_tokens = _numbers(self.blocks, self.mendings) - _numbers(*looks) - of_near
        joints, near = len(self.parents), min(self.config.near, points)
        read = of_points * points + of_tokens * (self.config.latents + joints) + of_near * joints * near
        return 2.0 * (2 * read + _numbers(self.weigh) * joints * vertices)

    def _seen(self, x: Float[Tensor, "B N 3"], normals: Float[Tensor, "B N 3"]) -> Float[Tensor, "B N C"]:
        waves = (x[..., None] * self.octaves).flatten(-2)
        h = self.embed(torch.cat([x, normals, waves.sin(), waves.cos()], -1))
        return rms(h + self.mix(F.gelu(h)))


@dataclass(frozen=True)
class Frames:
    """Where the joints are thought to be."""

    rotation: Float[Tensor, "B J 3 3"]
    joints: Float[Tensor, "B J 3"]
    middle: Float[Tensor, "J 3"]
    """Middle of each joint's surface, in its frame."""

    def of(self, points: Float[Tensor, "B J N 3"], normals: Float[Tensor, "B J N 3"]) -> Float[Tensor, "B J N G"]:
        """Points and their normals as each joint sees them."""
        with torch.autocast(points.device.type, enabled=False):
            x = CLOSE * (points - self.joints[:, :, None]) @ self.rotation
            return torch.cat([x, x.norm(dim=-1, keepdim=True), normals @ self.rotation, (2 * x).sin()], -1)

    def changed(self, nine: Float[Tensor, "B J 9"]) -> tuple[Float[Tensor, "B J 3 3"], Float[Tensor, "B J 3"]]:
        """Each frame turned by the first six numbers and moved by the last three, as seen from itself."""
        with torch.autocast(nine.device.type, enabled=False):
            moved = self.joints + (self.rotation @ nine[..., 6:, None])[..., 0]
            return self.rotation @ turn(nine[..., :6]), moved

    def middles(self) -> Float[Tensor, "B J 3"]:
        """The middle of each joint's surface."""
        with torch.autocast(self.joints.device.type, enabled=False):
            return self.joints + (self.rotation @ self.middle[..., None])[..., 0]


class Mending(nn.Module):
    """Each joint looks at the points near it, in its own frame, and turns and moves that frame."""

    def __init__(self, config: MimeConfig) -> None:
        super().__init__()
        c, h = config.width, config.local
        self.near, self.latents = config.near, config.latents
        self.geometry, self.token, self.seen = nn.Linear(GEOMETRY, h), nn.Linear(c, h), nn.Linear(c, h, bias=False)
        self.score = nn.Linear(h, config.heads)
        self.pooled = nn.Linear(config.heads * h, c)
        self.block = Block(c, config.heads, looks=False)
        self.mend = zero(nn.Linear(c, 9))

    def forward(self, tokens: Tensor, frames: Frames, x: Tensor, normals: Tensor, seen: Tensor):
        with torch.no_grad():
            apart = (frames.middles()[:, :, None] - x[:, None]).square().sum(-1)
            index = apart.topk(min(self.near, x.shape[1]), dim=2, largest=False, sorted=False).indices
        ours = tokens[:, self.latents :]
        h = self.geometry(frames.of(_pick(x, index), _pick(normals, index)))
        h = F.gelu(h + self.token(rms(ours))[:, :, None] + _pick(self.seen(seen), index))
        share = self.score(h).float().softmax(2).to(h.dtype)
        ours = ours + self.pooled((share.mT @ h).flatten(2))
        tokens = self.block(torch.cat([tokens[:, : self.latents], ours], 1))
        return tokens, *frames.changed(self.mend(rms(tokens[:, self.latents :])).float())


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
        frames = Frames(reading.rotation.detach(), reading.place.detach() / unit, reading.place)
        known = frames.of(vertices[:, None] / unit[:, None], normals[:, None])
        token = self.token(rms(reading.tokens[:, self.latents :])) + self.joint
        h = F.gelu(self.hidden(F.gelu(self.geometry(known) + token[:, :, None])))
        return (self.out(h)[..., 0].float() - known[..., 3].float()).mT


class Block(nn.Module):
    """Pre-norm transformer block; `looks` adds attention to the points before that among tokens."""

    def __init__(self, width: int, heads: int, looks: bool) -> None:
        super().__init__()
        self.look = Attention(width, heads) if looks else None
        self.attend = Attention(width, heads)
        self.up, self.down = nn.Linear(width, 3 * width), zero(nn.Linear(3 * width, width))

    def forward(self, tokens: Float[Tensor, "B K C"], seen: Float[Tensor, "B N C"] | None = None) -> Tensor:
        if self.look is not None and seen is not None:
            tokens = tokens + self.look(rms(tokens), seen)
        h = rms(tokens)
        tokens = tokens + self.attend(h, h)
        return tokens + self.down(F.gelu(self.up(rms(tokens))))


class Attention(nn.Module):
    """Multi-head attention with q and k of one length."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.out = zero(nn.Linear(width, width, bias=False))

    def forward(self, tokens: Float[Tensor, "B K C"], seen: Float[Tensor, "B N C"]) -> Float[Tensor, "B K C"]:
        q, k, v = (
            layer(h).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer, h in ((self.query, tokens), (self.key, seen), (self.value, seen))
        )
        scores = rms(q) @ rms(k).mT * (2.0 / math.sqrt(q.shape[-1]))
        return self.out((scores.softmax(-1) @ v).transpose(1, 2).flatten(2))


def _numbers(*modules: nn.Module) -> int:
    return sum(p.numel() for module in modules for p in module.parameters())


def rms(h: Tensor) -> Tensor:
    """Root mean square 1 over the channels."""
    return F.rms_norm(h, h.shape[-1:])


def turn(six: Float[Tensor, "*B 6"]) -> Float[Tensor, "*B 3 3"]:
    """Rotation of six numbers (Zhou et al., CVPR 2019): zeros are no turn."""
    x = F.normalize(six[..., :3] + six.new_tensor([1.0, 0.0, 0.0]), dim=-1)
    y = six[..., 3:] + six.new_tensor([0.0, 1.0, 0.0])
    y = F.normalize(y - (x * y).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], -1)


def zero(layer: nn.Linear) -> nn.Linear:
    """A layer that gives zeros at first."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer


def _pick(values: Float[Tensor, "B N C"], index: Tensor) -> Float[Tensor, "B J M C"]:
    flat = index.flatten(1)[..., None].expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).unflatten(1, index.shape[1:])


def _standing(body: RiggedBody) -> tuple[Float[Tensor, "J 3"], Float[Tensor, "J 3"]]:
    """Joints at rest, and the middle of each one's surface seen from there, in the units of `Mime.read`."""
    centre = body.vertices.mean(axis=0)
    scale = np.sqrt(np.square(body.vertices - centre).sum(axis=1).mean())
    share = body.weights / np.maximum(body.weights.sum(axis=0), 1e-9)
    middle = share.T @ body.vertices - body.joints
    return torch.from_numpy((body.joints - centre) / scale).float(), torch.from_numpy(middle / scale).float()
