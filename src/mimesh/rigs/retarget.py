"""Motions of joints, and how a character follows one: rotations by role, root path, soles that stand.

A motion is that of a file's joints (`JointMotion.of_file`), or `mime` finds it on the surfaces of a clip
(`mime.model.Mime.capture`). Everything here is normalised; the two have normalisations of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..bodies import load_body
from ..bodies.anatomy import anatomy_of_joints, body_of_joints
from ..bodies.character_limbs import SIDES
from ..bodies.hands import straight_hands
from ..bodies.joint_names import ancestors, finger_joints
from ..core.foot_planting import (
    PosedJoints,
    ever_upright,
    has_path,
    height_of_soles,
    is_cyclic,
    keep_above_floor,
    level_soles,
    plant_feet,
    resting_lift,
    standing_track,
)
from ..core.frame_buffer import Progress, counted, each_frame, evenly_spread
from ..core.joint_tracks import JointTrack, root_path
from ..core.mesh import Clip, Mesh, check_size
from ..core.normalization import Normalization
from ..core.person_motion import KnownJoints, PersonMotion
from ..core.rig import Rig
from ..core.soles import Feet, LowParts, SolePoints, Soles, body_points, find_soles, floor_height, sole_height
from ..core.surface_points import SurfacePoints
from .character import Character, LinkedJoints, RestPose
from .confidence import Confidence

if TYPE_CHECKING:
    from .body_grid import BodyGrid
    from .contacts import Contacts

Pose = tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]
"""World rotation and position of every joint."""
Follow = Callable[[Float[np.ndarray, "U 3"]], Pose]
"""Finds the joints in a frame of a clip, which has these vertices."""
SurfaceMotion = Callable[[SurfacePoints], Float[np.ndarray, "T N 3"]]
"""Maps points of the driving's surface to their positions in frames of the whole clip, normalised."""
FLOOR_FRAMES = 120
"""Largest number of frames, evenly spread, in which the floor of a clip is looked for where its frames are made one by
one."""


@dataclass(frozen=True, eq=False)
class ScannedJoints(KnownJoints):
    """The joints of a clip of scans, which were found in each of them (`pipeline.read`)."""

    confidence: Confidence
    """How certainly; the median over the scans."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """The joints of a driving clip: known in all of its frames, or found in each from its vertices."""

    joints: tuple[str, ...]
    """Names of the shipped body's joints, the hips first."""
    follow: Follow | None
    """Finds the joints in a frame; None where they are known."""
    leg: float
    """Length of a leg."""
    surface: SurfacePoints
    """Points of the clip's surface."""
    soles: Soles
    """Contact points of the feet, then of the hands, as indices of these."""
    ankles: tuple[str, ...]
    """Joint that moves each of these feet."""
    track: JointTrack | None = None
    """The joints in all frames, where the file has them."""
    body: Int[np.ndarray, " B"] | None = None
    """Outermost points of the rest of the body, as indices of the same; None: not known."""
    rest: RestPose | None = None
    """The joints at rest, y up, +z front, where the file has them."""
    rest_floor: float | None = None
    """Height of the soles at rest, where the file has a rig whose hips move."""
    skin: tuple[Mesh, Rig] | None = None
    """The surface, or points of it, in some pose, and the joints in it but fingers; None where the file has none."""
    confidence: Confidence | None = None
    """How certainly the joints were found; None: they are those of a file."""
    played: bool = False
    """See `PersonMotion`."""

    @classmethod
    def of_file(cls, motion: PersonMotion, mesh: Mesh, fps: float, norm: Normalization) -> JointMotion:
        """Normalise the joints of a file; `mesh` is the clip's first frame, normalised already."""
        positions = norm.apply(motion.positions.reshape(-1, 3)).reshape(motion.positions.shape)
        track = JointTrack(norm.rotation @ motion.rotation, positions, fps)
        vertices = SurfacePoints.of_vertices(len(mesh.vertices))  # as of a character: a sole stands on its lowest ones
        rest = None
        if motion.rest is not None and motion.upright is not None:
            rest = (motion.upright @ motion.rest[0], motion.rest[1] @ motion.upright.T)
        soles: Soles = ()
        skin = None
        ankles: tuple[str, ...] = ()
        floor = body = None
        if motion.weights is not None:
            index = {name: k for k, name in enumerate(motion.joints)}
            anatomy = anatomy_of_joints(motion.joints)
            legs, arms = (
                tuple(tuple(index[name] for name in limb if name in index) for limb in limbs)
                for limbs in (anatomy.legs, anatomy.arms)
            )
            ankles = tuple(motion.joints[leg[-1]] if leg else "" for leg in legs)
            rig = Rig(track.rotation[0], track.positions[0], motion.weights)
            parents = body_parents(motion.joints)
            soles = find_soles(mesh.vertices, rig, legs, parents, arms)
            body = body_points(mesh.vertices, rig, legs + arms, parents)
            at_rest = None if motion.rest_vertices is None else norm.apply(motion.rest_vertices)
            if at_rest is not None and has_path(motion.positions[:, 0], motion.leg):
                floor = sole_height(at_rest, soles, len(legs))
            if motion.rest is not None and at_rest is not None:  # taking back a pose bends joints
                turned, places = motion.rest
                mesh = Mesh(at_rest, mesh.faces)
                rig = Rig(norm.rotation @ turned, norm.apply(places), motion.weights)
            skin = mesh, rig
        leg = motion.leg / norm.radius
        facts = track, body, rest, floor, skin
        return cls(motion.joints, None, leg, vertices, soles, ankles, *facts, played=motion.played)

    @property
    def grid(self) -> BodyGrid | None:
        """Points on the surface that correspond to those of other people."""
        from .body_grid import NEEDED, BodyGrid

        if self.skin is None or not NEEDED.issubset(self.joints) or body_of_joints(self.joints) != "human":
            return None
        joints = self.joints[: len(self.skin[1].joints)]  # fingers come last
        return BodyGrid.of_pose(*self.skin, joints, body_parents(joints))

    def floor(self, lowest: float) -> float:
        """Return the height of the floor; `lowest` is that of the clip's planted soles, or of its lowest ones."""
        return lowest if self.rest_floor is None else floor_height(self.rest_floor, lowest, self.leg)

    def over(
        self, clip: Clip, norm: Normalization, soles: SolePoints | None, progress: Progress | None = None
    ) -> JointTrack:
        """Return the joints and contact points in all frames of their clip, which `norm` normalises."""
        if self.track is None:
            frames = (norm.apply(vertices) for vertices in each_frame(clip.vertices))
            return self.tracked(counted(frames, len(clip), progress), clip.fps, clip.mesh.name, soles)
        # Of a surface whose joints are known, only the points of the soles are read.
        if soles is None:
            return self.track
        contacts, body = soles.in_frames(clip.vertices, norm, progress)
        return replace(self.track, soles=contacts, lowest=body[..., 1].min(axis=1) if soles.rest else None)

    def tracked(
        self, frames: Iterable[Float[np.ndarray, "U 3"]], fps: float, name: str, feet: SolePoints | None = None
    ) -> JointTrack:
        """Return the joints in all frames of the clip `name`, and the contact points of its feet, if there are any."""
        poses, soles, lowest = [], [], []
        for t, vertices in enumerate(check_size(frames, name)):
            poses.append(self.pose(t, vertices))
            if feet is not None:
                contacts, body = feet.in_frame(vertices)
                soles.append(contacts)
                lowest += [body[:, 1].min()] if feet.rest else []
        rotation, positions = (np.stack(arrays) for arrays in zip(*poses, strict=True))
        below = np.array(lowest) if lowest else None
        return JointTrack(rotation, positions, fps, np.stack(soles) if soles else None, below)

    def pose(self, t: int, vertices: Float[np.ndarray, "U 3"]) -> Pose:
        """Return the pose of the joints in frame t of the clip, which has these vertices."""
        if self.track is not None:
            return self.track.rotation[t], self.track.positions[t]
        assert self.follow is not None
        return self.follow(vertices)


def body_parents(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the parent of each joint among some of a shipped body's, the hips first: the nearest one above it."""
    body = load_body(body_of_joints(names))
    above = {
        name: [body.joint_names[j] for j in ancestors(body.parents, k)[1:]] for k, name in enumerate(body.joint_names)
    }
    for side in SIDES:
        hand = f"{side}Hand"
        fingers = finger_joints(side)
        for k, name in enumerate(fingers):
            chain = list(fingers[k - k % 3 : k])[::-1]
            above[name] = [*chain, hand, *above[hand]]
    index = {name: k for k, name in enumerate(names)}
    return tuple(
        next((index[name] for name in above[own] if name in index), -1 if k == 0 else 0) for k, own in enumerate(names)
    )


@dataclass(frozen=True, eq=False)
class Retarget:
    """A character that follows a motion."""

    character: Character
    motion: JointMotion
    links: LinkedJoints
    stride: float
    """The character's displacement over the driving's, each in its normalisation: the ratio of leg lengths."""
    feet: Feet | None
    """Contact points of the soles; None if there are none, and then nothing is planted."""

    @classmethod
    def of(cls, character: Character, motion: JointMotion) -> Retarget:
        """Let a character follow a motion: each joint the driving's of its role, steps as long as its legs."""
        links = character.linked(motion.joints, motion.rest)
        if body_of_joints(motion.joints) == "human" and (character.confidence is None) != (motion.confidence is None):
            # On surfaces hands are found as they rest, in files as straight ones where no knuckles show their palms.
            turns = straight_hands(list(character.roles), character.above)
            links = replace(links, standing=turns if character.confidence is None else turns.swapaxes(-1, -2))
        return cls(character, motion, links, character.leg / motion.leg, _feet(character, motion))

    def limited(self, influences: int) -> Retarget:
        """Keep only the largest weights of each vertex."""
        return replace(self, character=self.character.limited(influences))

    @property
    def driving_soles(self) -> SolePoints | None:
        """Contact points of the driving, if both have feet."""
        return None if self.feet is None else self.feet.driving

    @cached_property
    def contacts(self) -> Contacts | None:
        """What keeps contacts of arms with the own body; None for animals, and where joints or surfaces lack or are not
        found with certainty."""
        from .contacts import Contacts

        if any(of.confidence is not None and of.confidence.uncertainty > 1 for of in (self.character, self.motion)):
            return None
        driving = self.motion.grid
        identity = None if driving is None else self.character.grid
        return Contacts.of(driving, identity, self.character.skinned, self.character.arms)

    @cached_property
    def low_parts(self) -> LowParts | None:
        """Outermost points of what should not get below the floor; None of joints without a mesh."""
        own = self.character
        return LowParts.of(own.points, own.rig, own.skinned, (own.legs, own.arms), own.soles)

    def posed_joints(
        self, track: JointTrack, across: float | None, in_place: bool, ground: bool, contacts: bool
    ) -> PosedJoints:
        """Return the motion of the character's joints.

        Args:
            track: motion of the driving's joints.
            across: scale from the driving's displacement over the ground (x and z) to the character's, which is kept
                then; None is `stride`.
            in_place: no displacement over the ground.
            ground: correct root path and legs so that soles stand where the driving's do.
            contacts: correct arms so that hands touch the own body where the driving's do.
        """
        scale = (self.stride if across is None else across, self.stride)
        rotation = self.links.rotations(track.rotation, track.positions)
        posed = PosedJoints(rotation, root_path(track, *scale, in_place))
        if ground and self.feet is not None:
            # In place, feet slide as they should: only heights are corrected.
            free, skinned = across is None, self.character.skinned
            posed = plant_feet(posed, track, skinned, self.feet, scale, free, not in_place, self.motion.floor)
        if contacts and self.contacts is not None:
            posed = self.contacts.kept(posed, track, is_cyclic(track, self.motion.leg))
        if ground and self.feet is not None and self.low_parts is not None:
            posed = keep_above_floor(posed, track, self.low_parts, self.feet, self.stride, self.motion.floor)
        return posed

    def lift(self, posed: PosedJoints, track: JointTrack) -> float | None:
        """Return how far up a motion of the character's joints must go to stand on the floor that the character is on.

        Its soles are then as high over that floor as the driving's are over theirs, scaled. This is where the height of
        results is decided. Where nobody is upright knees, seat or back tell. None where nothing does.
        """
        own = self.character.floor
        if self.feet is None or own is None or track.soles is None:
            return None
        if self.motion.rest_floor is None and not ever_upright(track, self.feet):
            lift = resting_lift(posed, track, self.feet, self.stride)
            return None if lift is None else own + lift
        higher, lowest = height_of_soles(posed, track, self.feet, self.stride)
        return higher + own - self.stride * self.motion.floor(lowest)

    def lift_of_frames(self, clip: Clip, norm: Normalization) -> float | None:
        """Return the `lift` of frames that are made one by one, from at most FLOOR_FRAMES of the clip."""
        chosen = evenly_spread(len(clip), FLOOR_FRAMES)
        fps = clip.fps * len(chosen) / len(clip)
        known = self.motion.track
        motion = self.motion if known is None else replace(self.motion, track=known.at(chosen, fps))
        track = motion.over(Clip(clip.mesh, clip.vertices[chosen], fps), norm, self.driving_soles)
        return self.lift(self.posed_joints(track, None, False, False, False), track)

    def levelled(self, track: JointTrack) -> JointTrack:
        """Put the standing soles of a skeleton without a mesh on its floor; others stay as they are."""
        if self.feet is None or not self.motion.played:
            return track
        return level_soles(track, self.motion.leg, self.feet.hands, self.motion.floor)

    def standing(self, track: JointTrack) -> JointTrack:
        """Put the lowest sole of a driving without a path on the floor in every frame; others stay as they are."""
        if self.feet is None or track.soles is None:
            return track
        return standing_track(track, self.motion.leg)

    def frame(self, t: int, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
        """Make the character's vertices in frame t of the driving, which has these vertices; nothing is planted."""
        rotation, positions = self.motion.pose(t, vertices)
        linked = self.links.rotations(rotation[None], positions[None])[0]
        return self.character.posed(linked, self.stride * positions[0])


def _feet(character: Character, motion: JointMotion) -> Feet | None:
    lacking = any(of.confidence is not None and of.confidence.lacks_leg for of in (character, motion))
    legs, arms = character.legs, character.arms
    if lacking or len(legs + arms) != len(motion.soles):
        return None
    bodies = None
    if motion.body is not None and len(motion.body) and len(character.points):
        parents = character.parents
        bodies = body_points(character.points, character.rig, legs + arms, parents), motion.body
    soles = character.soles, character.skinned, motion.soles, motion.surface
    return Feet.of(legs, motion.leg, *soles, arms, bodies)
