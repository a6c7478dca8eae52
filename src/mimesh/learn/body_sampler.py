"""Random people in random poses, made on the device: shapes, poses, skinning, normalisation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ..bodies import RiggedBody
from ..bodies.anatomy import anatomy_of_joints
from ..bodies.joint_ranges import ranges_of
from ..bodies.sampling import limits_rotvec, sample_pose
from ..bodies.sampling import rotvec_to_rotmat as numpy_rotmat
from ..core.rig import descendants
from ..evaluate.clip_protocols import CLIPS_ANIFORMER
from ..evaluate.protocols import HUMAN_NPT
from .bodies import TorchBody, rotvec_to_rotmat
from .pose_sources import pose_sources
from .vertex_sampler import VertexSampler


@dataclass(frozen=True)
class DataConfig:
    """What training meshes are made of."""

    kind: Literal["table6", "wide", "clips80", "clips", "hands", "meshes"] = "table6"
    """`table6`: NPT's 16 people x 400 poses of its Table 6. `wide`: endless people; rest, Table 6, joint limits, frames
    of motions. `clips80`: AniFormer's 16 people x 80 motions of 30 frames. `clips`: endless people and motions.
    `hands`: hands of the shipped body and of characters with posed fingers, and hands without fingers. `meshes`:
    registered meshes or clips of a folder."""
    vertices: int = 0
    """Vertices of each mesh: 0 for all, else a random subset (ends of random edges for identity and truth)."""
    target_scale: Literal["truth", "identity"] = "truth"
    """Whose radius the truth is divided by. The papers normalise every mesh; users do not know the truth's radius."""
    pairing: Literal["random", "order"] = "random"
    """Which driving vertex an identity vertex is paired with: a random one (NPT shuffles every mesh), or its own
    (AniFormer's public code never shuffles the sequences that it trains on)."""
    spread: float = 1.3
    """Standard deviation of the shape coefficients of endless people."""
    heading: float = 45.0
    """`wide`, `clips`: the driving mesh is turned about the vertical by up to so many degrees to either side."""
    tumble: float = 0.0
    """`wide`: share of driving meshes that are rotated any way at all, as people who lie or roll are."""
    contacts: float = 0.0
    """`wide`: share of people whose body parts touch each other; animals have no such poses."""
    characters: float = 0.0
    """`mime`, `npt` (`wide`) and `hands`: share of a batch that are characters of a folder, for `mime` also of
    primitives."""
    leave_out: tuple[str, ...] = ()
    """`mime`, `npt` (`wide`) and `hands`: packs of the folder of characters that are not trained on."""
    limits: float = 0.12
    """`wide`: share of driving meshes that are posed anyhow within the joint limits."""
    character_limits: float | None = None
    """`mime`: the same share of driving characters and figures of primitives; None: that of `limits`. One network
    that saw many took odd shapes for odd poses (docs/LOG.md, "Animals of the shipped body in any pose")."""
    low_poly: float = 0.0
    """`mime`, `wide`: share of meshes that are low-poly, as points with the normals of 200 to 1,200 flat triangles."""
    scans: float = 0.0
    """`mime`, `wide`: share of driving meshes that are scans from one camera: hidden points missing, holes, noise."""
    reflect: float = 0.0
    """`npt` and `aniformer`: share of every batch whose meshes are all mirrored, left to right."""
    between: float = 0.0
    """`clips80`: share of windows and frames that lie on a straight way between two poses within the joint limits,
    instead of in one of the 80 motions."""
    recombine: float = 0.0
    """`table6`, `clips80`: share of poses, or windows, whose head, arms and legs are each turned as in another one."""
    mix_people: float = 0.0
    """`table6`, `clips80`: share of people who are random mixtures of the 16 (`_sample_table_people`)."""
    pattern: str = ""
    """`meshes`: how the files are named, such as "{person}-{pose}.ply"; empty: found (`mesh_layouts.LAYOUTS`)."""
    up: str = ""
    """`meshes`: axis of the files away from the ground, such as "+z"; empty: that of the files, or detected."""
    front: str = ""
    """`meshes`: axis of the files that people face; empty: detected, the same for all meshes."""
    hold_out_people: str = ""
    """`meshes`: people that networks are validated on instead of trained: a number (the last ones by name), names with
    commas between (one name ends with a comma), or none; empty: a tenth."""
    hold_out_poses: str = ""
    """`meshes`: the same of poses, or motions."""
    frames: int = 0
    """`meshes`: so many evenly spread frames of each clip, AniFormer's 30 for example; 0: all."""
    body: Literal["human", "quadruped"] = "human"
    """`mime` and `npt` (`wide`), `aniformer` (`clips`): shipped body of the people, or the animals, that are drawn.
    `meshes`: what the meshes are."""


TABLE_KINDS = ("table6", "clips80")
"""Kinds of data with a fixed table of people and poses, as in the papers."""
IDENTITY_MIX = (0.40, 0.80, 0.85)
"""`wide`: identities up to these cumulative shares are at rest (arms anywhere from T to lowered), in Table 6, within
joint limits; the others are frames of motions. Chosen by hand: identities that users have mostly stand."""
DRIVING_SHARES = (0.05, 0.45, 0.38)
"""The same for driving meshes, as shares beside `DataConfig.limits`: at rest, in Table 6, in frames of motions."""
REST_NOISE = 0.05
"""`wide`: standard deviation of joint rotations at rest (radians)."""
MAX_STEP = 0.15
"""Windows on a straight way between two poses: the largest share of it that one frame covers. Where a frame
covers none, the window is still."""
SHAPE_LIMIT = 2.5
"""Shape coefficients are clipped to so many standard deviations."""


class BodySampler(VertexSampler):
    """Draws people, poses and vertices of one kind of data on one device; subclasses make batches of them."""

    def __init__(self, config: DataConfig, body: RiggedBody, device: torch.device, seed: int) -> None:
        super().__init__(body.vertices, body.faces, config, device, seed, by_area=config.kind == "wide")
        self.body = TorchBody(body).to(device)
        self.extreme = torch.from_numpy(extreme_vertices(body)).to(device)
        self._load(body)

    def _load(self, body: RiggedBody) -> None:
        """Put on the device what people and poses are drawn from."""
        kind = self.config.kind
        if kind in TABLE_KINDS:
            clips = kind == "clips80"
            self.table_shapes = self._tensor((CLIPS_ANIFORMER if clips else HUMAN_NPT).train_people(body))
            self.table_poses = self._tensor(numpy_rotmat(HUMAN_NPT.train_poses(body)))
            # (motions, frames, J, 3, 3); a pose of Table 6 is a motion of one frame.
            self.motions = self._tensor(CLIPS_ANIFORMER.train_motions(body)) if clips else self.table_poses[:, None]
            self.limits = self._tensor(limits_rotvec(body, ranges_of(body)[1]))
            self.limbs = torch.from_numpy(limb_masks(body)).to(self.device)
        else:
            sources = pose_sources(body)
            self.usual, self.limits = self._tensor(sources.usual), self._tensor(sources.limits)
            self.motion_frames = self._tensor(sources.frames)
            self.resting, self.postures = self._tensor(sources.resting), self._tensor(sources.postures)
            self.contacts = [self._tensor(array) for array in (sources.contact_shapes, sources.contact_poses)]

    def _sample_pairs(
        self, size: int, rng: torch.Generator, limits: float | None = None
    ) -> tuple[Float[Tensor, "2 B K"], Float[Tensor, "2 B J 3 3"], Bool[Tensor, "2 B"]]:
        """Draw shapes and local joint rotations of identities and driving meshes, and who is in self-contact.

        Args:
            limits: share of driving meshes posed anyhow within the joint limits; None: that of the configuration.
        """
        if self.config.kind in TABLE_KINDS:
            return self._sample_table(size, rng)
        return self._sample_people(size, rng, limits)

    def _sample_table(self, size: int, rng: torch.Generator):
        """Draw two people of the table for each pair: the identity in a Table 6 pose, the driving in one or a frame."""
        shapes = self._sample_table_people(size, rng)
        table = self.table_poses[:, None]
        identity = self._recombine(self._random_window(table, size, 1, rng), table, rng)
        driving = self._recombine(self._random_window(self.motions, size, 1, rng), self.motions, rng)
        driving = self._replace_by_straight(driving, rng)
        nobody = torch.zeros(2, size, dtype=torch.bool, device=self.device)
        return shapes, torch.stack([identity[:, 0], driving[:, 0]]), nobody

    def _sample_table_people(self, size: int, rng: torch.Generator) -> Float[Tensor, "2 B K"]:
        """Draw identities and driving people of the table: its people, the configured share mixtures of them.

        A mixture is their mean plus normal multiples of what each departs from it, so that its mean and covariance are
        those of the people. New people are as hard as new poses: 16 do not span a body of as many shape components.
        """
        people = self.table_shapes
        shapes = people[self._random_index(len(people), (2, size), rng)]
        if not self.config.mix_people:
            return shapes
        mean = people.mean(0)
        normal = torch.randn(2, size, len(people), generator=rng, device=self.device)
        mixtures = mean + normal @ (people - mean) / math.sqrt(len(people))
        some = torch.rand(2, size, 1, generator=rng, device=self.device) < self.config.mix_people
        return torch.where(some, mixtures, shapes)

    def _recombine(
        self, window: Float[Tensor, "B W J 3 3"], motions: Float[Tensor, "M T J 3 3"], rng: torch.Generator
    ) -> Float[Tensor, "B W J 3 3"]:
        """Turn each limb of the configured share of the windows as in a random window of the motions.

        400 poses or 80 motions are too few to learn how any pose maps to any other: new ones have two to three times
        the error of these. Their limbs make far more.
        """
        if not self.config.recombine:
            return window
        size, frames = window.shape[:2]
        some = torch.rand(size, 1, generator=rng, device=self.device) < self.config.recombine
        for limb in self.limbs:
            other = self._random_window(motions, size, frames, rng)
            window = torch.where((some & limb)[:, None, :, None, None], other, window)
        return window

    def _random_window(
        self, motions: Float[Tensor, "M T J 3 3"], size: int, frames: int, rng: torch.Generator
    ) -> Float[Tensor, "B W J 3 3"]:
        """Cut windows of some frames out of random motions."""
        which = self._random_index(len(motions), (size, 1), rng)
        first = self._random_index(motions.shape[1] - frames + 1, (size, 1), rng)
        return motions[which, first + torch.arange(frames, device=self.device)]

    def _replace_by_straight(self, window: Float[Tensor, "B T J 3 3"], rng: torch.Generator):
        """Replace the configured share of the windows by straight ways between two poses."""
        if not self.config.between:
            return window
        straight = self._straight_windows(len(window), window.shape[1], rng)
        some = torch.rand(len(window), generator=rng, device=self.device) < self.config.between
        return torch.where(some[:, None, None, None, None], straight, window)

    def _straight_windows(self, size: int, frames: int, rng: torch.Generator) -> Float[Tensor, "B T J 3 3"]:
        """Draw windows on straight ways from one pose within the joint limits towards another."""
        start, stop = (self._random_between(self.limits, size, rng)[:, None] for _ in range(2))
        step = MAX_STEP * torch.rand(size, 1, 1, 1, generator=rng, device=self.device)
        frame = torch.arange(frames, device=self.device)
        return rotvec_to_rotmat(start + step * frame[:, None, None] * (stop - start))

    def _sample_people(self, size: int, rng: torch.Generator, limits: float | None = None):
        """Draw new people: identities mostly near a rest pose, driving meshes in all poses.

        Who is in self-contact is given because such a pose fits one shape only.
        """
        shapes = torch.randn(2, size, len(self.body.components), generator=rng, device=self.device)
        shapes = self.config.spread * shapes.clamp(-SHAPE_LIMIT, SHAPE_LIMIT)
        kinds = torch.rand(2, size, generator=rng, device=self.device)
        poses, touching = [], torch.zeros(2, size, dtype=torch.bool, device=self.device)
        for row, mix in enumerate((IDENTITY_MIX, driving_mix(self.config.limits if limits is None else limits))):
            pose = self._sample_poses(kinds[row], mix, rng)
            if self.config.contacts and len(self.contacts[0]):
                shapes[row], pose, touching[row] = self._replace_by_contacts(shapes[row], pose, rng)
            rotmat = rotvec_to_rotmat(pose)
            driving = row == 1
            reach = math.radians(self.config.heading) * (1.0 if driving else 0.25)
            rotmat[:, 0] = random_headings(size, reach, rng) @ rotmat[:, 0]
            if self.config.tumble and driving:
                rotmat[:, 0] = self._random_tumbles(size, rng) @ rotmat[:, 0]
            poses.append(rotmat)
        return shapes, torch.stack(poses), touching

    def _sample_poses(
        self, kinds: Float[Tensor, " B"], mix: tuple[float, ...], rng: torch.Generator
    ) -> Float[Tensor, "B J 3"]:
        """Draw joint rotation vectors; `kinds` are uniform numbers that choose among the kinds of pose of a mix."""
        size = len(kinds)
        # All kinds are drawn for everybody, so that a batch takes the same random numbers whatever it is made of.
        table, wide = self._random_between(self.usual, size, rng), self._random_between(self.limits, size, rng)
        frame = self.motion_frames[self._random_index(len(self.motion_frames), (size,), rng)]
        rest = self.resting * torch.rand(size, 1, 1, generator=rng, device=self.device)
        rest = rest + REST_NOISE * torch.randn(size, *rest.shape[1:], generator=rng, device=self.device)
        if len(self.postures):
            posture = self._random_postures(size, rng)
            rest, table, frame = rest + posture, table + posture, frame + posture
        choice = torch.bucketize(kinds, torch.tensor(mix, device=self.device))
        return torch.stack([rest, table, wide, frame])[choice, torch.arange(size, device=self.device)]

    def _random_postures(self, size: int, rng: torch.Generator) -> Float[Tensor, "B J 3"]:
        """Draw shares of the ways in which animals stand."""
        share = torch.rand(size, 1, 1, generator=rng, device=self.device)
        return share * self.postures[self._random_index(len(self.postures), (size,), rng)]

    def _replace_by_contacts(self, shape: Float[Tensor, "B K"], pose: Float[Tensor, "B J 3"], rng: torch.Generator):
        """Replace a share of the people by ones in self-contact: shapes, poses, and who was replaced."""
        some = torch.rand(len(shape), generator=rng, device=self.device) < self.config.contacts
        drawn = self._random_index(len(self.contacts[0]), (len(shape),), rng)
        shapes, poses = (bank[drawn] for bank in self.contacts)
        return torch.where(some[:, None], shapes, shape), torch.where(some[:, None, None], poses, pose), some

    def _random_between(
        self, bounds: Float[Tensor, "2 J 3"], size: int, rng: torch.Generator
    ) -> Float[Tensor, "B J 3"]:
        part = torch.rand(size, *bounds.shape[1:], generator=rng, device=self.device)
        return bounds[0] + part * (bounds[1] - bounds[0])

    def _random_tumbles(self, size: int, rng: torch.Generator) -> Float[Tensor, "B 3 3"]:
        """Draw a uniform random rotation for the configured share, and none for the others.

        A random direction in four dimensions is a uniform unit quaternion.
        """
        quaternion = torch.nn.functional.normalize(torch.randn(size, 4, generator=rng, device=self.device), dim=-1)
        angle = 2 * torch.acos(quaternion[:, :1].clamp(-1, 1))
        rotvec = angle * torch.nn.functional.normalize(quaternion[:, 1:], dim=-1)
        some = torch.rand(size, 1, generator=rng, device=self.device) < self.config.tumble
        return rotvec_to_rotmat(rotvec * some)

    def _normalized_mesh(
        self,
        shape: Float[Tensor, "B K"],
        rotmat: Float[Tensor, "B J 3 3"],
        index: Int[Tensor, "B N"],
        radius: Float[Tensor, "B 1 1"] | None = None,
    ) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B 1 1"]]:
        """Pose people and give chosen vertices, centred on the bounding box and divided by `radius`, and their own one.

        Centre and radius are those of the whole mesh, of which few vertices need to be posed. None: divide by the own.
        """
        count = index.shape[1]
        if count == self.body.vertex_count:
            points = self.body.posed(shape, rotmat)
            whole, points = points, points.gather(1, index[..., None].expand(-1, -1, 3))
        else:
            both = torch.cat([index, self.extreme.expand(len(index), -1)], dim=1)
            skinned = self.body.posed(shape, rotmat, both)
            points, whole = skinned[:, :count], skinned[:, count:]
        centre = (whole.amax(1, keepdim=True) + whole.amin(1, keepdim=True)) / 2
        own = (whole - centre).norm(dim=-1).amax(1)[:, None, None]
        return (points - centre) / (own if radius is None else radius), own


def limb_masks(body: RiggedBody) -> Bool[np.ndarray, "L J"]:
    """Tell which joints belong to head, arms and legs: those of each limb from its first joint on."""
    tops = [body.joint(top) for top in anatomy_of_joints(body.joint_names).regions.values()]
    joints = np.arange(len(body.joint_names))
    return np.stack([np.isin(joints, list(descendants([top], body.parents))) for top in tops])


def driving_mix(limits: float) -> tuple[float, float, float]:
    """Give the cumulative shares of driving meshes at rest, in Table 6 and within the joint limits."""
    rest, table, frames = DRIVING_SHARES
    scale = (1 - limits) / (rest + table + frames)
    return scale * rest, scale * (rest + table), scale * (rest + table) + limits


def random_headings(size: int, reach: float, rng: torch.Generator) -> Float[Tensor, "B 3 3"]:
    """Draw rotations about the vertical by up to `reach` radians to either side."""
    angle = reach * (2 * torch.rand(size, generator=rng, device=rng.device) - 1)
    zero = torch.zeros_like(angle)
    return rotvec_to_rotmat(torch.stack([zero, angle, zero], -1))


@cache
def extreme_vertices(body: RiggedBody, poses: int = 400) -> Int[np.ndarray, " N"]:
    """Find the vertices that are outermost (along an axis, or from the centre) in any of many random poses.

    Centre and radius of a posed body follow from these alone, within a hundredth or two of the radius. Posing takes
    seconds, so a body's answer is kept.
    """
    found: list[int] = []
    usual, widest = ranges_of(body)
    for i in range(poses):
        limits = usual if i % 2 else widest
        vertices = body.posed(np.zeros(1), numpy_rotmat(sample_pose(body, 0, i, limits)))
        centre = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
        found += [*vertices.argmax(axis=0), *vertices.argmin(axis=0)]
        found += np.argsort(np.linalg.norm(vertices - centre, axis=1))[-3:].tolist()
    return np.unique(found)
