"""Endless people and animals: new shapes in all kinds of poses, from the shipped bodies and motions.

The papers have a table of people and poses (`people`), and networks trained on it know no others. Here every shape is
new. Poses are those of NPT's Table 6, anything within the joint limits, frames of motions, poses at rest and in
self-contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ...bodies import RiggedBody, quadruped
from ...bodies.anatomy import anatomy_of_joints
from ...bodies.contacts import contact_bank
from ...bodies.joint_ranges import ranges_of
from ...bodies.sampling import folded_legs, limits_rotvec, lowered_arms
from ...core.errors import InputError
from ...core.rig import descendants
from ...motions import mirror, pose_bank
from ...motions.clips import split_windows
from ...motions.gaits import quadruped_poses, quadruped_takes
from ...motions.motion import rotmat_to_rotvec
from ..task import DataConfig, share_option
from .bodies import normal, on_device, rotvec_to_rotmat, uniform

TABLE_KINDS = ("table6", "clips80")
"""Kinds of data with a fixed table of people and poses, as in the papers."""
IDENTITY_MIX = (0.40, 0.80, 0.85)
"""`wide`: identities up to these cumulative shares are at rest (arms anywhere from T to lowered), in Table 6, within
joint limits; the others are frames of motions. Chosen by hand: identities that users have mostly stand."""
DRIVING_SHARES = (0.05, 0.45, 0.38)
"""The same for driving meshes, as shares beside `PeopleOptions.limits`: at rest, in Table 6, in frames of motions."""
REST_NOISE = 0.05
"""`wide`: standard deviation of joint rotations at rest (radians)."""
MAX_STEP = 0.15
"""Windows on a straight way between two poses: the largest share of it that one frame covers. Where a frame
covers none, the window is still."""
SHAPE_LIMIT = 2.5
"""Shape coefficients are clipped to so many standard deviations."""
FOLDED = 4000
"""Folded legs that are drawn from."""
MAX_SPEED = 3
"""`clips`: windows of captures, or of animals' gaits, are played at up to this many times their speed."""
CAPTURED = 0.5
"""`clips`: share of windows of these; the others go straight from one pose within the joint limits to another."""


@dataclass(frozen=True)
class PeopleOptions(DataConfig):
    """How people are drawn: new ones (`wide`, `clips`), or more than those of a table (`table6`, `clips80`)."""

    spread: float = 1.3
    """Standard deviation of the shape coefficients of endless people."""
    heading: float = 45.0
    """The driving mesh is turned about the vertical by up to so many degrees to either side."""
    tumble: float = share_option()
    """Share of driving meshes that are rotated any way at all, as people who lie or roll are."""
    contacts: float = share_option()
    """Share of people whose body parts touch each other; animals have no such poses."""
    folded: float = share_option()
    """Share of people whose legs are folded as those of people who sit, squat and kneel; animals have no such poses."""
    limits: float = share_option(0.12)
    """Share of driving meshes that are posed anyhow within the joint limits."""
    recombine: float = share_option()
    """`table6`, `clips80`: share of poses, or windows, whose head, arms and legs are each turned as in another one."""
    mix_people: float = share_option()
    """`table6`, `clips80`: share of people who are random mixtures of the 16 (`mixed_people`)."""
    animal_kinds: ClassVar[tuple[str, ...]] = ()
    """Kinds of data that a model can be trained on with `body` quadruped."""

    def check(self, where: str) -> None:
        """Raise InputError for animals in data of people, and for more of a table where there is none."""
        super().check(where)
        for key in ("recombine", "mix_people"):
            if (value := getattr(self, key)) and self.kind not in TABLE_KINDS:
                raise InputError(f"{where}: expected data.{key} 0 with {self.kind}, found {value}")
        if self.body == "quadruped" and self.kind not in self.animal_kinds:
            raise InputError(
                f"{where}: expected data.body human with data.kind {self.kind}, found quadruped; animals are data of "
                f"the kinds {', '.join(self.animal_kinds)}"
            )


@dataclass(frozen=True)
class ReflectOptions(DataConfig):
    """For data whose truth may be mirrored."""

    reflect: float = share_option()
    """Share of every batch whose meshes are all mirrored, left to right."""


class EndlessPeople:
    """Draws people and poses on one device; each call is a pure function of its generator."""

    def __init__(self, config: PeopleOptions, body: RiggedBody, device: torch.device, frames: int = 0) -> None:
        """Put on the device what people and poses are drawn from.

        Args:
            frames: of the windows that are drawn, if any.
        """
        self.config, self.device, self.shape_components = config, device, len(body.components)
        sources = pose_sources(body)
        self.usual, self.limits = on_device(sources.usual, device), on_device(sources.limits, device)
        self.motion_frames = on_device(sources.frames, device)
        self.resting, self.postures = on_device(sources.resting, device), on_device(sources.postures, device)
        self.contacts = [on_device(array, device) for array in (sources.contact_shapes, sources.contact_poses)]
        self.folded = on_device(sources.folded, device)
        self.is_leg = (self.folded != 0).any(dim=0).any(dim=-1, keepdim=True)
        self.frames = frames
        if frames:
            takes = training_takes(body)
            # All frames of all takes in one tensor, and the indices where the fastest window still fits into its take.
            self.captured = on_device(np.concatenate(takes), device)
            ends = np.cumsum([len(take) for take in takes])
            longest = MAX_SPEED * (frames - 1)
            starts = [np.arange(end - len(take), end - longest) for end, take in zip(ends, takes, strict=True)]
            self.starts = torch.from_numpy(np.concatenate(starts)).to(device)

    def add_poses(self, poses: Float[np.ndarray, "P J 3"]) -> None:
        """Add rotation vectors (radians), such as those of characters' clips, to the frames of motions."""
        self.motion_frames = torch.cat([self.motion_frames, on_device(poses, self.device)])

    def pairs(
        self, size: int, rng: torch.Generator, limits: float | None = None
    ) -> tuple[Float[Tensor, "2 B K"], Float[Tensor, "2 B J 3 3"], Bool[Tensor, "2 B"]]:
        """Draw shapes and local joint rotations of identities and driving meshes, and who is in self-contact.

        Identities are mostly near a rest pose, driving meshes in all poses. Who is in self-contact is given because
        such a pose fits one shape only.

        Args:
            limits: share of driving meshes posed anyhow within the joint limits; None: that of the configuration.
        """
        shapes = normal(rng, 2, size, self.shape_components)
        shapes = self.config.spread * shapes.clamp(-SHAPE_LIMIT, SHAPE_LIMIT)
        kinds = uniform(rng, 2, size)
        poses, touching = [], torch.zeros(2, size, dtype=torch.bool, device=self.device)
        for row, mix in enumerate((IDENTITY_MIX, driving_mix(self.config.limits if limits is None else limits))):
            pose = self._sample_poses(kinds[row], mix, rng)
            if self.config.folded and len(self.folded):
                legs = self.folded[random_index(len(self.folded), (len(pose),), rng)]
                folded = uniform(rng, len(pose), 1, 1) < self.config.folded
                pose = torch.where(folded & self.is_leg, legs, pose)
            if self.config.contacts and len(self.contacts[0]):
                shape = shapes[row]
                touch = uniform(rng, len(shape)) < self.config.contacts
                drawn = random_index(len(self.contacts[0]), (len(shape),), rng)
                touching_shapes, touching_poses = (bank[drawn] for bank in self.contacts)
                shapes[row], pose, touching[row] = (
                    torch.where(touch[:, None], touching_shapes, shape),
                    torch.where(touch[:, None, None], touching_poses, pose),
                    touch,
                )
            rotmat = rotvec_to_rotmat(pose)
            driving = row == 1
            reach = math.radians(self.config.heading) * (1.0 if driving else 0.25)
            rotmat[:, 0] = random_headings(size, reach, rng) @ rotmat[:, 0]
            if self.config.tumble and driving:
                # A random direction in four dimensions is a uniform unit quaternion.
                quaternion = torch.nn.functional.normalize(normal(rng, size, 4), dim=-1)
                angle = 2 * torch.acos(quaternion[:, :1].clamp(-1, 1))
                rotvec = angle * torch.nn.functional.normalize(quaternion[:, 1:], dim=-1)
                some = uniform(rng, size, 1) < self.config.tumble
                rotmat[:, 0] = rotvec_to_rotmat(rotvec * some) @ rotmat[:, 0]
            poses.append(rotmat)
        return shapes, torch.stack(poses), touching

    def windows(
        self, size: int, rng: torch.Generator
    ) -> tuple[Float[Tensor, "2 B K"], Float[Tensor, "B J 3 3"], Float[Tensor, "B T J 3 3"]]:
        """Draw two new people for each window, a pose of the identity, and the driving poses.

        They are windows of takes at some speed, or straight ways between two poses, under random headings.
        """
        shapes, poses, _ = self.pairs(size, rng)
        frame = torch.arange(self.frames, device=self.device)
        first = self.starts[random_index(len(self.starts), (size, 1), rng)]
        speed = 1 + random_index(MAX_SPEED, (size, 1), rng)
        captured = self.captured[first + speed * frame]
        if len(self.postures):
            captured = captured + self._random_postures(size, rng)[:, None]
        captured = rotvec_to_rotmat(captured)
        start, stop = (random_between(self.limits, size, rng)[:, None] for _ in range(2))
        step = MAX_STEP * uniform(rng, size, 1, 1, 1)
        frame = torch.arange(self.frames, device=rng.device)
        straight = rotvec_to_rotmat(start + step * frame[:, None, None] * (stop - start))
        heading = random_headings(size, np.deg2rad(self.config.heading), rng)[:, None]
        chosen = uniform(rng, size) < CAPTURED
        window = torch.where(chosen[:, None, None, None, None], captured, straight)
        window[:, :, 0] = heading @ window[:, :, 0]
        return shapes, poses[0], window

    def _sample_poses(
        self, kinds: Float[Tensor, " B"], mix: tuple[float, ...], rng: torch.Generator
    ) -> Float[Tensor, "B J 3"]:
        """Draw joint rotation vectors; `kinds` are uniform numbers that choose among the kinds of pose of a mix."""
        size = len(kinds)
        # All kinds are drawn for everybody, so that a batch takes the same random numbers whatever it is made of.
        table, wide = random_between(self.usual, size, rng), random_between(self.limits, size, rng)
        frame = self.motion_frames[random_index(len(self.motion_frames), (size,), rng)]
        rest = self.resting * uniform(rng, size, 1, 1)
        rest = rest + REST_NOISE * normal(rng, size, *rest.shape[1:])
        if len(self.postures):
            posture = self._random_postures(size, rng)
            rest, table, frame = rest + posture, table + posture, frame + posture
        choice = torch.bucketize(kinds, torch.tensor(mix, device=self.device))
        return torch.stack([rest, table, wide, frame])[choice, torch.arange(size, device=self.device)]

    def _random_postures(self, size: int, rng: torch.Generator) -> Float[Tensor, "B J 3"]:
        share = uniform(rng, size, 1, 1)
        return share * self.postures[random_index(len(self.postures), (size,), rng)]


def random_index(count: int, shape: tuple[int, ...], rng: torch.Generator) -> Int[Tensor, "..."]:
    """Draw numbers from 0 to count - 1."""
    return torch.randint(count, shape, generator=rng, device=rng.device)


def random_between(bounds: Float[Tensor, "2 J 3"], size: int, rng: torch.Generator) -> Float[Tensor, "B J 3"]:
    """Draw rotation vectors between the lowest and the highest of each joint and axis."""
    part = uniform(rng, size, *bounds.shape[1:])
    return bounds[0] + part * (bounds[1] - bounds[0])


def mixed_people(people: Float[Tensor, "P K"], part: float, size: int, rng: torch.Generator) -> Float[Tensor, "2 B K"]:
    """Draw identities and driving people of a table, a part of them mixtures of all.

    A mixture is their mean plus normal multiples of what each departs from it, so that its mean and covariance are
    those of the people. New people are as hard as new poses: 16 do not span a body of as many shape components.
    """
    shapes = people[random_index(len(people), (2, size), rng)]
    if not part:
        return shapes
    mean = people.mean(0)
    mixtures = mean + normal(rng, 2, size, len(people)) @ (people - mean) / math.sqrt(len(people))
    some = uniform(rng, 2, size, 1) < part
    return torch.where(some, mixtures, shapes)


def limb_masks(body: RiggedBody) -> Bool[np.ndarray, "L J"]:
    """Tell which joints belong to head, arms and legs: those of each limb from its first joint on."""
    tops = [body.joint(top) for top in anatomy_of_joints(body.joint_names).regions.values()]
    joints = np.arange(len(body.joint_names))
    return np.stack([np.isin(joints, list(descendants([top], body.parents))) for top in tops])


def random_window(
    motions: Float[Tensor, "M T J 3 3"], size: int, frames: int, rng: torch.Generator
) -> Float[Tensor, "B W J 3 3"]:
    """Cut windows of some frames out of random motions."""
    which = random_index(len(motions), (size, 1), rng)
    first = random_index(motions.shape[1] - frames + 1, (size, 1), rng)
    return motions[which, first + torch.arange(frames, device=rng.device)]


def recombined(
    window: Float[Tensor, "B W J 3 3"],
    motions: Float[Tensor, "M T J 3 3"],
    limbs: Bool[Tensor, "L J"],
    part: float,
    rng: torch.Generator,
) -> Float[Tensor, "B W J 3 3"]:
    """Turn each limb of a part of the windows as in a random window of the motions.

    400 poses or 80 motions are too few to learn how any pose maps to any other: new ones have two to three times
    the error of these. Their limbs make far more.
    """
    if not part:
        return window
    size, frames = window.shape[:2]
    some = uniform(rng, size, 1) < part
    for limb in limbs:
        other = random_window(motions, size, frames, rng)
        window = torch.where((some & limb)[:, None, :, None, None], other, window)
    return window


def driving_mix(limits: float) -> tuple[float, float, float]:
    """Give the cumulative shares of driving meshes at rest, in Table 6 and within the joint limits."""
    rest, table, frames = DRIVING_SHARES
    scale = (1 - limits) / (rest + table + frames)
    return scale * rest, scale * (rest + table), scale * (rest + table) + limits


def random_headings(size: int, reach: float, rng: torch.Generator) -> Float[Tensor, "B 3 3"]:
    """Draw rotations about the vertical by up to `reach` radians to either side."""
    angle = reach * (2 * uniform(rng, size) - 1)
    zero = torch.zeros_like(angle)
    return rotvec_to_rotmat(torch.stack([zero, angle, zero], -1))


class PoseSources(NamedTuple):
    """Rotation vectors (radians) of J joints."""

    usual: Float[np.ndarray, "2 J 3"]
    """Lowest and highest of everyday poses: those of NPT's Table 6 for people."""
    limits: Float[np.ndarray, "2 J 3"]
    """Lowest and highest that joints allow."""
    frames: Float[np.ndarray, "N J 3"]
    """Frames of motions."""
    resting: Float[np.ndarray, "J 3"]
    """A pose that bodies are modelled in between rest and it: people with lowered arms, animals with a lowered head."""
    postures: Float[np.ndarray, "R J 3"]
    """Ways in which animals stand, of which a share of one is added to every pose but those within the joint limits;
    empty for people."""
    contact_shapes: Float[np.ndarray, "M K"]
    """Shape coefficients of bodies whose limbs touch each other."""
    contact_poses: Float[np.ndarray, "M J 3"]
    """Their poses; both are empty for bodies that have none."""
    folded: Float[np.ndarray, "F J 3"]
    """People with folded legs; empty for animals."""


def pose_sources(body: RiggedBody) -> PoseSources:
    """Load what poses of a shipped body are drawn from."""
    usual, limits = (limits_rotvec(body, table) for table in ranges_of(body))
    if body.name == "quadruped":
        no_shapes, none = np.zeros((0, len(body.components))), np.zeros((0, *body.joints.shape))
        frames, resting = quadruped_poses(body, "train"), quadruped.lowered_head(body)
        return PoseSources(usual, limits, frames, resting, quadruped.postures(body), no_shapes, none, none)
    no_postures, folded = np.zeros((0, *body.joints.shape)), folded_legs(body, FOLDED)
    return PoseSources(usual, limits, pose_bank("train"), lowered_arms(body), no_postures, *contact_bank(), folded)


def training_takes(body: RiggedBody) -> list[Float[np.ndarray, "T J 3"]]:
    """Load the motions that windows of a shipped body are cut from, 30 frames a second, as rotation vectors (radians).

    Of people they are the captures and their mirror images, of animals gaits and ways into postures and back.
    """
    if body.name == "quadruped":
        return quadruped_takes(body, "train", fps=30.0)
    takes = [motion for take in split_windows("train") for motion in (take, mirror(take))]
    return [rotmat_to_rotvec(motion.rotmat) for motion in takes]
