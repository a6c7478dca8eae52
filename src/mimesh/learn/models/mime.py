"""mime: predict the joints of a mesh from points of its surface, and move one mesh by the joints of another.

Each mesh is processed alone. Tokens, one of them for each joint, attend to the points and give a first estimate of
every joint's frame. Then, a few times over, every joint takes in the points near it, expressed in its own frame, where
a forearm looks alike in all poses, and corrects that frame. From the joint tokens of an identity a second head predicts
skinning weights of any number of vertices. A result is linear blend skinning of the identity's own vertices from its
own joints to the driving's rotations, so all surface detail is kept (`methods` has the same for clips).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from ...bodies import RiggedBody
from ..bodies import posed_joints, skinned

POINTS = 512
"""Points of a mesh that the exported network takes; training takes fewer."""
OCTAVES = 5
"""Frequencies of the sines and cosines that a position becomes, each twice the one before."""
FEATURES = 10
"""Numbers that describe a point in a joint's frame: position, distance, normal, sines of the position."""
POSITION_SCALE = 4.0
"""What positions in a joint's frame are multiplied by: near points lie within about a quarter of the mesh's spread."""


@dataclass(frozen=True)
class MimeConfig:
    """Options of the network."""

    width: int = 128
    """Channels of a token."""
    heads: int = 4
    latents: int = 32
    """Tokens beside those of the joints."""
    blocks: int = 4
    """Of self-attention; every second one attends to the points first."""
    refinements: int = 3
    """How often the joints correct their frames by the points near them."""
    near: int = 32
    """Points that a joint takes in for that."""
    local: int = 64
    """Channels of a point in a joint's frame."""
    skinning: int = 32
    """Channels of a vertex in a joint's frame, for the skinning weights."""


@dataclass(frozen=True)
class Prediction:
    """Joints of B meshes, in the units of their points."""

    tokens: Float[Tensor, "B K C"]
    rotations: tuple[Float[Tensor, "B J 3 3"], ...]
    """Of every joint in the world: the first estimate and one after each refinement."""
    positions: tuple[Float[Tensor, "B J 3"], ...]
    """Of every joint, likewise."""
    scale: Float[Tensor, "B 1 1"]
    """Root mean square distance of the points from their mean."""

    def select(self, which: slice) -> Prediction:
        """Take some of the meshes."""
        rotations, positions = (tuple(found[which] for found in all_of) for all_of in (self.rotations, self.positions))
        return Prediction(self.tokens[which], rotations, positions, self.scale[which])

    @property
    def rotation(self) -> Float[Tensor, "B J 3 3"]:
        """The last estimate of the rotations."""
        return self.rotations[-1]

    @property
    def joints(self) -> Float[Tensor, "B J 3"]:
        """The last estimate of the positions."""
        return self.positions[-1]


class MimeNetwork(nn.Module):
    """Predict joints and skinning weights; the joints are those of the body that it is trained on."""

    rest_joints: Tensor
    octaves: Tensor

    def __init__(self, config: MimeConfig, body: RiggedBody) -> None:
        super().__init__()
        self.config, self.parents, self.body = config, body.parents, body
        rest_joints, surface_centres = _rest_pose(body)
        self.register_buffer("rest_joints", rest_joints, persistent=False)
        self.register_buffer("octaves", 2.0 ** torch.arange(OCTAVES) * math.pi / 2, persistent=False)
        c, joints = config.width, len(body.parents)
        self.embed = nn.Linear(6 + 6 * OCTAVES, c)
        self.mix = nn.Linear(c, c)
        self.tokens = nn.Parameter(0.5 * torch.randn(1, config.latents + joints, c))
        self.blocks = nn.ModuleList(Block(c, config.heads, cross=i % 2 == 0) for i in range(config.blocks))
        self.first = zero_initialized(nn.Linear(c, 9))
        self.refinement = JointRefinement(surface_centres, c, config.heads, config.local, config.near)
        self.skinning_head = SkinningHead(config, joints)

    def predict_joints(self, points: Float[Tensor, "B N 3"], normals: Float[Tensor, "B N 3"]) -> Prediction:
        """Predict the joints of meshes from points spread evenly over them, at any place, in any size and order.

        Normals are of unit length, or zero where they are not known.
        """
        centre = points.mean(1, keepdim=True)
        scale = (points - centre).square().sum(-1, keepdim=True).mean(1, keepdim=True).sqrt()
        x = (points - centre) / scale
        features = self._point_features(x, normals)
        tokens = self.tokens.expand(x.shape[0], -1, -1)
        for block in self.blocks:
            tokens = block(tokens, features)
        # The first estimate is relative to the body at rest, each later one to the frame before it.
        estimate = self.first(rms_normalize(tokens[:, self.config.latents :])).float()
        rotation, joints = rotation_from_6d(estimate[..., :6]), self.rest_joints + estimate[..., 6:]
        rotations, positions = [rotation], [joints]
        surface = (x, normals, self.refinement.point(features))
        for _ in range(self.config.refinements):
            # Detached: each estimate has its own loss, and gradients through the choice of near points say little.
            frames = JointFrames(rotation.detach(), joints.detach())
            tokens, rotation, joints = self.refinement(tokens, frames, surface)
            rotations.append(rotation)
            positions.append(joints)
        return Prediction(tokens, tuple(rotations), tuple(p * scale + centre for p in positions), scale)

    def predict_weights(
        self, prediction: Prediction, vertices: Float[Tensor, "B V 3"], normals: Float[Tensor, "B V 3"]
    ) -> Float[Tensor, "B V J"]:
        """Predict logarithms of skinning weights, up to a constant a vertex (softmax gives the weights)."""
        return self.skinning_head(prediction, vertices, normals)

    def skin(
        self,
        vertices: Float[Tensor, "B V 3"],
        scores: Float[Tensor, "B V J"],
        identity: Prediction,
        driving: Prediction,
        root: Float[Tensor, "B 3"] | None = None,
    ) -> Float[Tensor, "B V 3"]:
        """Move vertices of identities to the driving's joint rotations, the root joint at `root` (None: as it is)."""
        with torch.autocast(vertices.device.type, enabled=False):
            root = identity.joints[:, 0] if root is None else root
            joints = posed_joints(identity.rotation, identity.joints, driving.rotation, root, self.parents)
            weights = scores.float().softmax(-1)
            return skinned(vertices, weights, identity.rotation, identity.joints, driving.rotation, joints)

    def forward(
        self, identity: tuple[Tensor, Tensor], driving: tuple[Tensor, Tensor]
    ) -> tuple[Prediction, Prediction, Float[Tensor, "B N J"]]:
        """Predict joints of both (points and normals each) in one batch, and weights of half the identity's points."""
        both = self.predict_joints(*(torch.cat(pair) for pair in zip(identity, driving, strict=True)))
        size = len(identity[0])
        own, other = both.select(slice(size)), both.select(slice(size, None))
        half = slice(identity[0].shape[1] // 2)
        return own, other, self.predict_weights(own, identity[0][:, half], identity[1][:, half])

    def estimate_flops(self, vertices: int, points: int) -> float:
        """Count floating-point operations of a transfer with so many points a mesh: two for each use of a weight."""
        cross = 2 * self.config.width**2 * ((self.config.blocks + 1) // 2)  # keys and values of the points
        times, joints, near = self.config.refinements, len(self.parents), min(self.config.near, points)
        of_points = _count(self.embed, self.mix, self.refinement.point) + cross
        of_near = times * _count(self.refinement.geometry, self.refinement.score)
        of_tokens = _count(self.blocks) - cross + times * _count(self.refinement.block, self.refinement.pooled)
        mesh = of_points * points + of_tokens * (self.config.latents + joints) + of_near * joints * near
        head = _count(self.skinning_head.geometry, self.skinning_head.hidden)
        return 2.0 * (2 * mesh + head * joints * vertices)

    def _point_features(self, x: Float[Tensor, "B N 3"], normals: Float[Tensor, "B N 3"]) -> Float[Tensor, "B N C"]:
        waves = (x[..., None] * self.octaves).flatten(-2)
        h = self.embed(torch.cat([x, normals, waves.sin(), waves.cos()], -1))
        return rms_normalize(h + self.mix(F.relu(h)))


@dataclass(frozen=True)
class JointFrames:
    """Estimated frames of the joints."""

    rotation: Float[Tensor, "B J 3 3"]
    joints: Float[Tensor, "B J 3"]

    def describe(
        self, points: Float[Tensor, "B #J N 3"], normals: Float[Tensor, "B #J N 3"]
    ) -> Float[Tensor, "B J N G"]:
        """Express points and normals in each joint's frame, with distance and sines: the same in every pose."""
        with torch.autocast(points.device.type, enabled=False):
            x = POSITION_SCALE * (points - self.joints[:, :, None]) @ self.rotation
            return torch.cat([x, x.norm(dim=-1, keepdim=True), normals @ self.rotation, (2 * x).sin()], -1)

    def corrected(self, nine: Float[Tensor, "B J 9"]) -> tuple[Float[Tensor, "B J 3 3"], Float[Tensor, "B J 3"]]:
        """Turn each frame by the first six numbers and move it by the last three, both given in that frame."""
        with torch.autocast(nine.device.type, enabled=False):
            moved = self.joints + (self.rotation @ nine[..., 6:, None])[..., 0]
            return self.rotation @ rotation_from_6d(nine[..., :6]), moved

    def to_world(self, places: Float[Tensor, "J 3"]) -> Float[Tensor, "B J 3"]:
        """Transform one point of each frame to the world."""
        with torch.autocast(self.joints.device.type, enabled=False):
            return self.joints + (self.rotation @ places[..., None])[..., 0]


class JointRefinement(nn.Module):
    """Correct each joint's frame by the points near it, expressed in that frame."""

    centres: Tensor

    def __init__(self, centres: Float[Tensor, "J 3"], width: int, heads: int, local: int, near: int) -> None:
        """Build the layers.

        Args:
            centres: of the surface that each joint moves, in the joint's frame; the `near` points nearest to it count.
        """
        super().__init__()
        self.near = near
        self.register_buffer("centres", centres, persistent=False)
        self.geometry, self.token = nn.Linear(FEATURES, local), nn.Linear(width, local)
        self.point = nn.Linear(width, local, bias=False)
        self.score = nn.Linear(local, heads)
        self.pooled = nn.Linear(heads * local, width)
        self.block = Block(width, heads, cross=False)
        self.correction = zero_initialized(nn.Linear(width, 9))

    def forward(
        self,
        tokens: Float[Tensor, "B K C"],
        frames: JointFrames,
        surface: tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"], Float[Tensor, "B N H"]],
    ) -> tuple[Float[Tensor, "B K C"], Float[Tensor, "B J 3 3"], Float[Tensor, "B J 3"]]:
        """Compute new tokens, of which the last J are the joints', and frames.

        Args:
            surface: positions, normals and features (by `point`) of the points.
        """
        x, normals, features = surface
        with torch.no_grad():
            distance = torch.cdist(frames.to_world(self.centres), x)
            index = distance.topk(min(self.near, x.shape[1]), dim=2, largest=False, sorted=False).indices
        others, own = tokens.split([tokens.shape[1] - frames.joints.shape[1], frames.joints.shape[1]], 1)
        # Attention pooling: each head's scores choose among a joint's near points, and their features are averaged.
        h = self.geometry(frames.describe(_gather(x, index), _gather(normals, index)))
        h = F.relu(h + self.token(rms_normalize(own))[:, :, None] + _gather(features, index))
        share = self.score(h).float().softmax(2).to(h.dtype)
        own = own + self.pooled((share.mT @ h).flatten(2))
        tokens = self.block(torch.cat([others, own], 1))
        correction = self.correction(rms_normalize(tokens[:, -own.shape[1] :])).float()
        return tokens, *frames.corrected(correction)


class SkinningHead(nn.Module):
    """Predict how much each joint moves a vertex, from the vertex's position and normal in the joint's frame."""

    def __init__(self, config: MimeConfig, joints: int) -> None:
        super().__init__()
        h = config.skinning
        self.latents = config.latents
        self.geometry, self.token = nn.Linear(FEATURES, h, bias=False), nn.Linear(config.width, h)
        self.joint = nn.Parameter(torch.zeros(1, joints, h))
        self.hidden, self.out = nn.Linear(h, h), nn.Linear(h, 1)

    def forward(self, prediction: Prediction, vertices: Tensor, normals: Tensor) -> Float[Tensor, "B V J"]:
        unit = prediction.scale.detach()
        frames = JointFrames(prediction.rotation.detach(), prediction.joints.detach() / unit)
        local = frames.describe(vertices[:, None] / unit[:, None], normals[:, None])
        token = self.token(rms_normalize(prediction.tokens[:, self.latents :])) + self.joint
        h = F.relu(self.hidden(F.relu(self.geometry(local) + token[:, :, None])))
        # Near joints are likelier before anything is learned: the distance (feature 3) is taken off the score.
        return (self.out(h)[..., 0].float() - local[..., 3].float()).mT


class Block(nn.Module):
    """Apply a pre-norm transformer block; with `cross` tokens attend to the points before they attend to each other."""

    def __init__(self, width: int, heads: int, cross: bool) -> None:
        super().__init__()
        self.cross_attention = TokenAttention(width, heads) if cross else None
        self.self_attention = TokenAttention(width, heads)
        self.up, self.down = nn.Linear(width, 3 * width), zero_initialized(nn.Linear(3 * width, width))

    def forward(self, tokens: Float[Tensor, "B K C"], points: Float[Tensor, "B N C"] | None = None) -> Tensor:
        if self.cross_attention is not None and points is not None:
            tokens = tokens + self.cross_attention(rms_normalize(tokens), points)
        h = rms_normalize(tokens)
        tokens = tokens + self.self_attention(h, h)
        # Squared ReLU (So et al., "Primer", 2021).
        return tokens + self.down(F.relu(self.up(rms_normalize(tokens))).square())


class TokenAttention(nn.Module):
    """Apply multi-head attention with queries and keys normalised to one length (Henry et al. 2020)."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.out = zero_initialized(nn.Linear(width, width, bias=False))

    def forward(self, tokens: Float[Tensor, "B K C"], values: Float[Tensor, "B N C"]) -> Float[Tensor, "B K C"]:
        q, k, v = (
            layer(h).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer, h in ((self.query, tokens), (self.key, values), (self.value, values))
        )
        scores = rms_normalize(q) @ rms_normalize(k).mT * (2.0 / math.sqrt(q.shape[-1]))
        return self.out((scores.softmax(-1) @ v).transpose(1, 2).flatten(2))


def rms_normalize(h: Tensor) -> Tensor:
    """Scale to root mean square 1 over the channels."""
    return F.rms_norm(h, h.shape[-1:])


def zero_initialized(layer: nn.Linear) -> nn.Linear:
    """Set all weights of a layer to zero, so that its output begins with zeros."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer


def rotation_from_6d(six: Float[Tensor, "*B 6"]) -> Float[Tensor, "*B 3 3"]:
    """Convert six numbers to a rotation by Gram-Schmidt (Zhou et al., CVPR 2019); zeros are no rotation."""
    x = F.normalize(six[..., :3] + six.new_tensor([1.0, 0.0, 0.0]), dim=-1)
    y = six[..., 3:] + six.new_tensor([0.0, 1.0, 0.0])
    y = F.normalize(y - (x * y).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], -1)


def _gather(values: Float[Tensor, "B N C"], index: Int[Tensor, "B J M"]) -> Float[Tensor, "B J M C"]:
    flat = index.flatten(1)[..., None].expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).unflatten(1, index.shape[1:])


def _count(*modules: nn.Module) -> int:
    return sum(p.numel() for module in modules for p in module.parameters())


def _rest_pose(body: RiggedBody) -> tuple[Float[Tensor, "J 3"], Float[Tensor, "J 3"]]:
    """Give joints at rest, and the centre of the surface that each moves, relative to it, in units of the spread."""
    centre = body.vertices.mean(axis=0)
    scale = np.sqrt(np.square(body.vertices - centre).sum(axis=1).mean())
    share = body.weights / np.maximum(body.weights.sum(axis=0), 1e-9)
    surface = share.T @ body.vertices - body.joints
    return torch.from_numpy((body.joints - centre) / scale).float(), torch.from_numpy(surface / scale).float()
