"""mime: predict the joints of a mesh from points of its surface, and move one mesh by the joints of another.

Each mesh is processed alone. Tokens, one of them for each joint, attend to the points and give a first estimate of
every joint's frame. Then, a few times over, every joint takes in the points near it, expressed in its own frame, where
a forearm looks alike in all poses, and corrects that frame. From the joint tokens of an identity a second head predicts
skinning weights of any number of vertices. A result is linear blend skinning of the identity's own vertices from its
own joints to the driving's rotations, so all surface detail is kept (`methods` has the same for clips).

Training: pairs of people, characters and figures as points of their surfaces (`data.surfaces`, `data.figures`). Errors
count squared up to their knee and about linearly beyond it (`pseudo_huber`): with plain squares the few people who lie
or twist in unusual ways would be most of the loss.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from ..bodies import RiggedBody
from ..bodies.anatomy import anatomy_of
from ..core import geometry, surface_points
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..evaluate.metrics import pmd_aligned
from ..evaluate.pairs import Pair
from ..evaluate.protocols import QUADRUPED, Protocol
from .data.bodies import gather_points, normal, numbers_of_step, posed_joints, skinned, uniform
from .data.characters import CharacterOptions, TrainingCharacters
from .data.endless import TABLE_KINDS, EndlessPeople, PeopleOptions
from .data.figures import CharacterPairs, share_of
from .data.people import TablePeople
from .data.primitive_animals import primitive_animals
from .data.primitives import primitive_people
from .data.surfaces import People, PeopleSampler, PosedSurface, SurfaceBody, plain_people, repeat_visible
from .task import OnnxInterface, Task, TrainConfig, share_option

POINTS = 512
"""Points of a mesh that the exported network takes; training takes fewer."""
OCTAVES = 5
"""Frequencies of the sines and cosines that a position becomes, each twice the one before."""
FEATURES = 10
"""Numbers that describe a point in a joint's frame: position, distance, normal, sines of the position."""
POSITION_SCALE = 4.0
"""What positions in a joint's frame are multiplied by: near points lie within about a quarter of the mesh's spread."""
DEFAULT_POINTS = 320
"""Points of each mesh, unless the configuration says more."""
MISSING = (0.08, 0.25)
"""Share of identities and of driving meshes that lack the points within a ball."""
WITHOUT_NORMALS = (0.1, 0.2)
"""Share of identities and of driving meshes without normals, as point clouds are."""
ONE_SIDED = 0.1
"""Share of driving meshes of which only the points facing one side are given, as in a scan."""
MAX_NOISE = 0.02
"""Largest standard deviation of the noise on driving points (metres); mostly it is far less."""
RECONSTRUCTION_KNEE, ROTATION_KNEE, JOINT_KNEE = 5e-4, 0.02, 0.002
"""Of squared errors: of a pair (`reconstruction`), of a joint's rotation matrix, and of a joint in units of the points'
spread."""
MIME_DATA = (
    "random people of the shipped body, some in its skirt, tights or hair; rest, Table 6, joint limits, frames of the "
    "training seconds of the shipped motions, limbs that touch; headings, some turned over; noise, one-sided surfaces, "
    "missing parts"
)
"""Description of `wide` for the card."""
ANIMAL_DATA = (
    "random animals of the shipped quadruped; at rest, gaits, sitting, lying and eating, everyday poses, joint limits; "
    "headings, some turned over; noise, one-sided surfaces, missing parts"
)
"""The same of four-legged animals."""


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

    def check(self, where: str) -> None:
        """Raise InputError for a width that the heads do not divide."""
        if self.heads < 1 or self.width % self.heads:
            raise InputError(f"{where}: expected heads that divide width {self.width}, found {self.heads}")


@dataclass(frozen=True)
class MimeData(PeopleOptions, CharacterOptions):
    """What mime is trained on: the table of plain people, or endless people, characters and figures of all kinds."""

    kind: Literal["table6", "wide"] = "table6"
    """`table6`: NPT's 16 people x 400 poses of its Table 6. `wide`: endless people; rest, Table 6, joint limits, frames
    of motions."""
    target_scale: Literal["identity"] = "identity"
    """Lengths are kept."""
    pairing: Literal["random"] = "random"
    character_limits: float | None = share_option(None)
    """As `limits`, of driving characters and figures of primitives; None: that of `limits`. One network that saw many
    took odd shapes for odd poses (docs/log/animals.md)."""
    low_poly: float = share_option()
    """`wide`: share of meshes that are low-poly, as points with the normals of 200 to 1,200 flat triangles."""
    animal_kinds: ClassVar[tuple[str, ...]] = ("wide",)
    clip_kinds: ClassVar[tuple[str, ...]] = ("wide",)
    words: ClassVar[dict[tuple[str, str], str]] = {("wide", "human"): MIME_DATA, ("wide", "quadruped"): ANIMAL_DATA}
    words_of_characters: ClassVar[str] = (
        "; characters of others (`characters`) and people of primitives, in these poses and those of their clips"
    )

    @property
    def with_low_poly(self) -> bool:
        """Whether low-poly versions of the characters are needed."""
        return self.low_poly > 0

    def check(self, where: str) -> None:
        """Raise InputError for options of endless people with the table, and of characters without any."""
        super().check(where)
        for key in ("characters", "low_poly"):
            if (value := getattr(self, key)) and self.kind != "wide":
                raise InputError(f"{where}: expected data.{key} with data.kind wide only, found {value}")
        if self.character_limits is not None and not self.characters:
            raise InputError(
                f"{where}: expected data.character_limits null without data.characters, found "
                f"{self.character_limits}; leave it out"
            )


@dataclass(frozen=True)
class MimeLossConfig:
    """Weights of the terms beside the reconstruction, in units of the identity's squared radius."""

    rotation: float = 0.1
    """Of squared differences of rotation matrices, mean over joints and estimates."""
    joints: float = 0.5
    """Of squared distances of joints, in units of the points' spread."""
    weights: float = 0.01
    """Of the cross-entropy of the skinning weights."""


@dataclass(frozen=True)
class MimeTrainConfig(TrainConfig):
    """The configuration of a training of mime."""

    network: Literal["mime"] = "mime"
    model: MimeConfig = field(default_factory=MimeConfig)
    data: MimeData = field(default_factory=MimeData)
    structure: MimeLossConfig = field(default_factory=MimeLossConfig)

    def check(self, where: str) -> None:
        super().check(where)
        self.model.check(where)


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
        centre = body.vertices.mean(axis=0)
        scale = np.sqrt(np.square(body.vertices - centre).sum(axis=1).mean())
        share = body.weights / np.maximum(body.weights.sum(axis=0), 1e-9)
        surface = share.T @ body.vertices - body.joints
        surface_centres = torch.from_numpy(surface / scale).float()  # of what each joint moves, relative to it
        rest_joints = torch.from_numpy((body.joints - centre) / scale).float()
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
        waves = (x[..., None] * self.octaves).flatten(-2)
        h = self.embed(torch.cat([x, normals, waves.sin(), waves.cos()], -1))
        features = rms_normalize(h + self.mix(F.relu(h)))
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


@dataclass(frozen=True)
class SurfaceBatch:
    """B pairs in metres: exact surfaces, and what the network is given of them, which may be damaged."""

    identity: PosedSurface
    driving: PosedSurface
    truth: PosedSurface
    """The identity's points in the driving pose."""
    inputs: tuple[tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 3"]], ...]
    """Points and normals of identity and of driving; the driving's rows are not those of `driving`."""


class SurfaceSource:
    """Makes batches of one kind of data: NPT's table of plain people, or endless people and characters of all kinds."""

    def __init__(
        self,
        config: MimeData,
        body: RiggedBody,
        device: torch.device,
        seed: int,
        characters: TrainingCharacters | None = None,
    ) -> None:
        self.config, self.device, self.seed = config, device, seed
        self.people = (TablePeople if config.kind in TABLE_KINDS else EndlessPeople)(config, body, device)
        self.surface = SurfaceBody(body, low_poly=config.low_poly > 0, device=device)
        self.dressed = PeopleSampler(body, config.spread, device)
        self.count = config.vertices or DEFAULT_POINTS
        if config.characters:
            assert characters is not None
            primitives = primitive_animals(body) if body.name == "quadruped" else primitive_people(body)
            surfaces = [*characters.surfaces, *primitives]
            drawn = (self.count, math.radians(config.heading) / 4, MISSING, config.low_poly)
            self.figures = CharacterPairs(surfaces, body, device, *drawn)
        if characters is not None:
            assert isinstance(self.people, EndlessPeople)
            self.people.add_poses(characters.all_poses)

    def batch(self, size: int, step: int) -> SurfaceBatch:
        rng = numbers_of_step(self.seed, step, self.device)
        figures = share_of(size, self.config.characters, step)
        groups = [self._people(size - figures, rng)] if figures < size else []
        groups += [self._figures(figures, rng)] if figures else []
        identity, driving, truth = (PosedSurface.joined(surfaces) for surfaces in zip(*groups, strict=True))
        if self.config.kind in TABLE_KINDS:
            exact = tuple((mesh.points, mesh.normals) for mesh in (identity, driving))
            return SurfaceBatch(identity, driving, truth, exact)
        # Of a share of the driving meshes, only the points that face one side, repeated.
        size = len(driving.points)
        angle = 2 * math.pi * uniform(rng, size, 1, 1)
        side = torch.cat([angle.sin(), torch.zeros_like(angle), angle.cos()], -1)
        hidden = ((driving.normals * side).sum(-1) <= 0) & (uniform(rng, size, 1, 1)[..., 0] < ONE_SIDED)
        index = repeat_visible(hidden)
        noise = normal(rng, *driving.points.shape)
        noisy = gather_points(driving.points, index) + MAX_NOISE * uniform(rng, size, 1, 1).square() * noise
        normals = gather_points(driving.normals, index)
        meshes = ((identity.points, identity.normals), (noisy, normals))
        inputs = tuple(
            (points, normals * (uniform(rng, size, 1, 1) >= share))
            for (points, normals), share in zip(meshes, WITHOUT_NORMALS, strict=True)
        )
        return SurfaceBatch(identity, driving, truth, inputs)

    def _people(self, size: int, rng: torch.Generator) -> tuple[PosedSurface, PosedSurface, PosedSurface]:
        shapes, poses, touching = self.people.pairs(size, rng)
        people = self._dress(shapes, touching, rng)
        missing = (0.0, 0.0) if self.config.kind in TABLE_KINDS else MISSING
        index = [self.surface.choose(who, self.count, rng, share) for who, share in zip(people, missing, strict=True)]
        identity, driving = (self.surface.posed(*given) for given in zip(people, poses, index, strict=True))
        return identity, driving, self.surface.posed(people[0], poses[1], index[0])

    def _figures(self, size: int, rng: torch.Generator) -> tuple[PosedSurface, PosedSurface, PosedSurface]:
        assert isinstance(self.people, EndlessPeople)
        return self.figures.draw(self.people.pairs(size, rng, self.config.character_limits)[1], rng)

    def _dress(
        self, shapes: Float[Tensor, "2 B K"], touching: Bool[Tensor, "2 B"], rng: torch.Generator
    ) -> list[People]:
        """Make people of shapes: plain ones of the table, or ones with garments and proportions of their own.

        Those in self-contact stay plain, because with other proportions their parts would not touch.
        """
        plain = [plain_people(shape, self.surface) for shape in shapes]
        if self.config.kind in TABLE_KINDS:
            return plain
        drawn = [self.dressed.draw(len(touching[0]), rng, self.config.low_poly) for _ in shapes]
        return [one.where(some, other) for one, some, other in zip(plain, touching, drawn, strict=True)]


def mime_loss(model: MimeNetwork, batch: SurfaceBatch, weights: MimeLossConfig) -> Float[Tensor, ""]:
    """Compute the reconstruction (root joints together) and the structural terms."""
    own, other, scores = model(*batch.inputs)
    half = slice(scores.shape[1])
    moved = model.skin(batch.identity.points[:, half], scores, own, other, batch.truth.joints[:, 0])
    loss = pseudo_huber(reconstruction(moved, batch), RECONSTRUCTION_KNEE).mean()
    for prediction, true in ((own, batch.identity), (other, batch.driving)):
        rotation, joints = joint_errors(prediction, (true.rotation, true.turning), (true.joints, true.placed))
        loss = loss + weights.rotation * rotation / 2 + weights.joints * joints / 2
    entropy = -(batch.identity.weights[:, half] * scores.log_softmax(-1)).sum(-1).mean()
    return loss + weights.weights * entropy


def pseudo_huber(square: Float[Tensor, "*B"], knee: float) -> Float[Tensor, "*B"]:
    """Turn a squared error into itself far below the knee, and into its root beyond (Charbonnier et al., ICIP 1994)."""
    return 2 * knee * ((square / knee + 1).sqrt() - 1)


def reconstruction(result: Float[Tensor, "B N 3"], batch: SurfaceBatch) -> Float[Tensor, " B"]:
    """Compute the mean squared distance of each pair, over the square of the identity's radius about its centroid."""
    centred = batch.identity.points - batch.identity.points.mean(1, keepdim=True)
    radius = centred.norm(dim=-1).amax(1)
    return (result - batch.truth.points[:, : result.shape[1]]).square().sum(-1).mean(1) / radius.square()


def joint_errors(
    prediction: Prediction,
    rotation: tuple[Float[Tensor, "B J 3 3"], Bool[Tensor, "B #J"]],
    joints: tuple[Float[Tensor, "B J 3"], Bool[Tensor, "B #J"]],
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Compute errors of rotations and of joint positions, mean over the estimates and the joints that are known.

    Args:
        rotation: the true ones, and which are known.
        joints: the same of the positions.
    """
    turned = [(found - rotation[0]).square().sum((-1, -2)) for found in prediction.rotations]
    moved = [((found - joints[0]) / prediction.scale).square().sum(-1) for found in prediction.positions]
    return (
        masked_mean(pseudo_huber(torch.stack(turned), ROTATION_KNEE), rotation[1]),
        masked_mean(pseudo_huber(torch.stack(moved), JOINT_KNEE), joints[1]),
    )


def masked_mean(values: Float[Tensor, "*E B J"], known: Bool[Tensor, "B #J"]) -> Float[Tensor, ""]:
    """Compute the mean of the known values; 0 if none is known."""
    return (values * known).sum() / known.expand_as(values).sum().clamp_min(1)


class MimeTask(Task[MimeTrainConfig, MimeNetwork]):
    """Training, validation and export of mime."""

    config_type = MimeTrainConfig
    test_set = "human-npt"

    @property
    def protocol(self) -> Protocol:
        """Pairs of the body that is trained on."""
        return QUADRUPED if self.config.data.body == "quadruped" else super().protocol

    def make_model(self) -> MimeNetwork:
        return MimeNetwork(self.config.model, self.body)

    def source(self, seed: int) -> SurfaceSource:
        characters = self.user_data if isinstance(self.user_data, TrainingCharacters) else None
        return SurfaceSource(self.config.data, self.body, self.device, seed, characters)

    def loss(self, model: MimeNetwork, batch: SurfaceBatch, step: int) -> Tensor:
        with self.autocast():
            return mime_loss(model, batch, self.config.structure)

    def trial_error(self, model: MimeNetwork, trial: Pair) -> float:
        """Compute the PMD of a pair: joints from points of both surfaces, then skinning of the identity's vertices.

        The network gives its results no place: they are compared about the centres of their boxes.
        """
        mesh = trial.identity
        vertices = self._tensor(mesh.vertices)
        normals = self._tensor(geometry.vertex_normals(mesh.vertices, mesh.faces))
        with self.autocast():
            own, other = (model.predict_joints(*self._points(m)) for m in (mesh, trial.driving))
            scores = model.predict_weights(own, vertices, normals)
        result = model.skin(vertices, scores, own, other)[0]
        return pmd_aligned(result.double().cpu().numpy(), trial.truth)

    def _points(self, mesh: Mesh) -> tuple[Float[Tensor, "1 N 3"], Float[Tensor, "1 N 3"]]:
        """Draw random points of a surface, always the same ones, and their normals."""
        face, share = surface_points.sample_surface(mesh.vertices, mesh.faces, POINTS, np.random.default_rng(0))
        points = surface_points.at_barycentric(mesh.vertices, mesh.faces, face, share)
        return self._tensor(points), self._tensor(geometry.face_normals(mesh.vertices, mesh.faces)[face])

    def _tensor(self, array: Float[np.ndarray, "N 3"]) -> Float[Tensor, "1 N 3"]:
        return torch.from_numpy(array).float()[None].to(self.device)

    def batch_error(self, model: MimeNetwork, batch: SurfaceBatch) -> float:
        """Compute the mean PMD over half of the identities' points, whose boxes and radii are those compared."""
        with self.autocast():
            own, other, scores = model(*batch.inputs)
        count = scores.shape[1]
        result = model.skin(batch.identity.points[:, :count], scores, own, other, batch.truth.joints[:, 0])
        pair = (points.double().cpu().numpy() for points in (result, batch.truth.points[:, :count]))
        return pmd_aligned(*pair)

    def flops_per_pair(self, model: MimeNetwork) -> float:
        return model.estimate_flops(self.vertices, self.vertices)

    @staticmethod
    def onnx_interface(model: MimeNetwork) -> OnnxInterface:
        """Map points and vertices of one mesh, with normals, to joints and scores; skinning is left to the caller."""
        v = torch.export.Dim("vertices", min=1)
        inputs, outputs = ("points", "normals", "vertices", "vertex_normals"), ("rotation", "joints", "scores")
        example = (*torch.randn(2, 1, POINTS, 3), *torch.randn(2, 1, 300, 3))
        return OnnxInterface(_OneMesh(model), inputs, outputs, example, ({}, {}, {1: v}, {1: v}))

    @staticmethod
    def onnx_facts(model: MimeNetwork) -> dict[str, Any]:
        """Give the number of points, names and parents of the joints, and which joints make a leg."""
        body = model.body
        legs = [[body.joint(name) for name in leg] for leg in anatomy_of(body.name).legs]
        joints = {"joints": body.joint_names, "parents": body.parents, "legs": legs, "body": body.name}
        return {"model": "mime", "points": POINTS, **joints}


class _OneMesh(nn.Module):
    """All that the network computes of one mesh, as one function."""

    def __init__(self, model: MimeNetwork) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: Tensor, normals: Tensor, vertices: Tensor, vertex_normals: Tensor):
        prediction = self.model.predict_joints(points, normals)
        scores = self.model.predict_weights(prediction, vertices, vertex_normals)
        return prediction.rotation, prediction.joints, scores
