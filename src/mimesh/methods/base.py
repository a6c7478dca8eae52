"""Interfaces of methods: `Method`, and what its `prepare` takes and returns.

Methods work on normalised meshes only: y up, +z front, bounding box centred, largest distance from its centre 1.
The identity has a normalisation of its own; all frames of the driving have that of its first frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from ..bodies.joint_names import ancestors
from ..core.errors import InputError
from ..core.foot_planting import PosedJoints, plant_feet
from ..core.geometry import rotate_between, unit_vectors
from ..core.joint_tracks import JointTrack, root_path
from ..core.mesh import Clip, Mesh
from ..core.normalization import bbox_centre, radius
from ..core.rig import Rig
from ..core.skinning import SkinnedMesh
from ..core.soles import Feet, Soles, find_soles
from ..core.surface_points import SurfacePoints
from .confidence import Confidence

Drive = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Maps driving frames to the identity's vertices, one frame at a time, so that memory does not grow with the clip."""
Shapes = Callable[[Iterable[Float[np.ndarray, "U 3"]]], Iterator[Float[np.ndarray, "V 3"]]]
"""Maps driving frames to the identity's vertices in these poses, each at any position."""
Pose = tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]
"""World rotation and position of every joint."""
RestPose = tuple[Float[np.ndarray, "D 3 3"], Float[np.ndarray, "D 3"]]
"""The same of the joints of a driving at rest."""
SurfaceMotion = Callable[[SurfacePoints], Float[np.ndarray, "T N 3"]]
"""Maps points of the driving's surface to their positions in frames of the whole clip, normalised."""


@runtime_checkable
class Method(Protocol):
    """A way to give an identity the motion of a driving mesh."""

    rough: ClassVar[bool]
    """Whether results have an uneven surface and are refined by default (see `pipeline.refine`)."""

    @property
    def name(self) -> str:
        """Name of the method in messages and reports."""
        ...

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Do all work that is done once, and return the function that moves the identity.

        Args:
            identity: the mesh to move, normalised.
            driving: keyframes of the driving clip, normalised: a few frames, evenly spread, the clip's first one first.
                Its `mesh` has the vertices of that first frame.
        """
        ...


@runtime_checkable
class ShapeMethod(Method, Protocol):
    """A network of the papers, trained on centred meshes: its results have no place, and some have no size."""

    @property
    def target_scale(self) -> str:
        """Unit of the shapes: "truth", the radius of the true result; else the identity's."""
        ...

    def shapes(self, identity: Mesh, driving: Clip) -> Shapes:
        """As `Method.prepare`; the function that is returned gives the network's own results.

        The origin is where the training had the centre of the true result's bounding box.
        """
        ...


@runtime_checkable
class SkinnedMethod(Method, Protocol):
    """A method that moves joints. Only these support `--skinned`, `--root`, `--ground` and `--smooth`."""

    skinned: ClassVar[bool]
    """True. Methods without joints do not have this attribute."""

    def prepare(self, identity: Mesh, driving: Clip) -> SkinnedDrive:
        """As `Method.prepare`; the function that is returned also gives the motion of the joints."""
        ...


@runtime_checkable
class QuickPredictor(Protocol):
    """A method with a cheap prediction, which corrects wrongly detected axes (see `pipeline.orientation.reorient`)."""

    def quick_predict(self, mesh: Mesh) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Predict mean entropy (nats) of a normalised mesh's skinning weights, and world rotation of its root joint."""
        ...


@runtime_checkable
class MotionMethod(Method, Protocol):
    """A method that looks at more frames of a clip than its keyframes, at a few points of the surface."""

    def with_motion(self, motion: SurfaceMotion) -> Method:
        """Return this method with the motion of the surface of the driving that it is prepared for."""
        ...


@runtime_checkable
class SizedMethod(ShapeMethod, Protocol):
    """A network that may need the sizes of the meshes, which normalised ones do not have."""

    def with_sizes(self, identity: tuple[str, float], driving: tuple[str, float]) -> SizedMethod:
        """Return this method for two meshes, given by name and radius in the unit of the files."""
        ...


def linked_to_body(joints: tuple[str, ...], parents: tuple[int, ...], driving: tuple[str, ...]) -> LinkedJoints:
    """Find the joint of a driving that each joint of a person follows."""
    index = {name: k for k, name in enumerate(driving)}
    above = tuple(tuple(joints[k] for k in ancestors(parents, j)) for j in range(len(joints)))
    return LinkedJoints(driving, _nearest_known(above, index), {}, {name: j for j, name in enumerate(joints)})


def _nearest_known(above: Iterable[tuple[str, ...]], index: Mapping[str, int]) -> Int[np.ndarray, " J"]:
    """Return the index of the first known name of each row; that of the root, which comes first, if there is none."""
    return np.array([next((index[name] for name in names if name in index), 0) for names in above])


@dataclass(frozen=True, eq=False)
class KnownIdentity:
    """An identity whose file has joints and skinning weights, normalised."""

    joints: tuple[str, ...]
    """Names of the joints that move with the hips, the hips first."""
    parents: tuple[int, ...]
    rig: Rig
    """The rotations are those from the T-pose to rest of the person's joint that each joint is, or belongs to."""
    skinned: SkinnedMesh
    legs: tuple[tuple[int, ...], ...]
    """Of each leg hip, knee and ankle, those of them that it has."""
    leg: float
    """Length of a leg."""
    person: Mapping[str, int]
    """Joints that are those of a person: name -> index."""
    above: tuple[tuple[str, ...], ...]
    """For each joint, the person's joints that it is or is below, the nearest first."""
    whole: Mapping[str, str]
    """Person's joints that move a whole limb, and the one at the other end of the limb."""
    directions: Mapping[str, Float[np.ndarray, " 3"]]
    """Direction of these limbs in a T-pose."""
    standing: Mapping[str, Float[np.ndarray, "3 3"]] = field(default_factory=dict)
    """Rotations at rest (y up, +z front) of the person's joints that keep how they stand: they are turned from there by
    as much as the driving's from its own rest."""

    def linked(self, driving: tuple[str, ...], rest: RestPose | None = None) -> LinkedJoints:
        """Find the joint of a driving that each joint follows; `rest` is the driving at rest (y up, +z front)."""
        index = {name: k for k, name in enumerate(driving)}
        follows = _nearest_known(self.above, index)
        whole = {
            self.person[name]: (index[end], self.directions[name])
            for name, end in self.whole.items()
            if name in index and end in index
        }
        linked = LinkedJoints(driving, follows, whole, self.person)
        return linked if rest is None or not self.standing else replace(linked, standing=self._standing(linked, rest))

    def _standing(self, linked: LinkedJoints, rest: RestPose) -> Float[np.ndarray, "J 3 3"]:
        """Compute the rotations from the driving's rest to that of each joint which keeps how it stands."""
        at_rest = linked.rotations(*(array[None] for array in rest))[0]
        turned = np.tile(np.eye(3), (len(self.joints), 1, 1))
        for j, names in enumerate(self.above):
            if names and names[0] in self.standing:
                turned[j] = at_rest[j].T @ self.standing[names[0]]
        return turned


@dataclass(frozen=True, eq=False)
class KnownDriving:
    """A driving clip whose file has joints, normalised."""

    joints: tuple[str, ...]
    """Names of the person's joints, the hips first."""
    track: JointTrack
    leg: float
    weights: Float[np.ndarray, "U J"] | None
    """Skinning weights of the clip's vertices."""
    legs: tuple[tuple[int, ...], ...]
    """Of each leg hip, knee and ankle, those of them that it has."""
    parents: tuple[int, ...]
    rest: RestPose | None = None
    """Rotations and positions of the joints at rest, y up, +z front; None: not known."""

    def soles(self, samples: SurfacePoints, vertices: Float[np.ndarray, "U 3"]) -> Soles:
        """Find the contact points of the feet among samples of the surface, in the first frame."""
        if self.weights is None:
            return ()
        weights = (samples.barycentric[..., None] * self.weights[samples.corners]).sum(axis=1)
        rig = Rig(self.track.rotation[0], self.track.positions[0], weights)
        return find_soles(samples.points(vertices), rig, self.legs, self.parents)


@runtime_checkable
class RigMethod(SkinnedMethod, Protocol):
    """A method with joints that takes those of the files, where these have them. Only these support `--rig own`."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that it predicts."""
        ...

    def with_rigs(self, identity: KnownIdentity | None, driving: KnownDriving | None) -> Method:
        """Return this method with the known joints of the identity, of the driving, or of both."""
        ...

    def predict_rig(self, mesh: Mesh) -> tuple[Rig, Confidence]:
        """Predict the joints of a normalised mesh, whatever its file has, and their weights of its vertices."""
        ...


@runtime_checkable
class BodyMethod(QuickPredictor, Method, Protocol):
    """A method that looks for the joints of one shipped body, and may have others for other bodies."""

    @property
    def body(self) -> str:
        """Name of the body."""
        ...

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of all bodies that there are methods for, this one's first."""
        ...

    def of_body(self, body: str) -> BodyMethod:
        """Return the method for one of `bodies`, with the options of this one."""
        ...


@runtime_checkable
class CorrectableMethod(SkinnedMethod, Protocol):
    """A method with joints that takes known positions of some of them. Only these support `--joints`."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        ...

    def with_joints(
        self, identity: Mapping[str, Float[np.ndarray, " 3"]], driving: Mapping[str, Float[np.ndarray, " 3"]]
    ) -> Method:
        """Return this method with known joints of the identity, and of the driving in its last keyframe, normalised."""
        ...


@dataclass(frozen=True, eq=False)
class LinkedJoints:
    """The joint of the driving that each joint of an identity with other joints follows."""

    driving: tuple[str, ...]
    """Names of the D joints of the driving."""
    follows: Int[np.ndarray, " J"]
    """Index of that joint. An identity's joint without a counterpart follows that of the nearest joint above it."""
    whole: Mapping[int, tuple[int, Float[np.ndarray, " 3"]]]
    """Joints of the identity that move a whole limb: index of the driving's joint at the other end of the limb, and
    direction of the limb in a T-pose."""
    person: Mapping[str, int]
    """Index of each joint of the identity that is known to be a person's."""
    standing: Float[np.ndarray, "J 3 3"] | None = None
    """Rotation before that of each joint, in the frame of the joint; None: none."""

    def rotations(
        self, rotation: Float[np.ndarray, "T D 3 3"], positions: Float[np.ndarray, "T D 3"]
    ) -> Float[np.ndarray, "T J 3 3"]:
        """Return the rotations of the identity's joints; a whole limb points from the driving's first joint to its end.

        So an arm of one joint has the direction from shoulder to hand when the driving bends its elbow.
        """
        linked = rotation[:, self.follows]
        for joint, (end, direction) in self.whole.items():
            start = self.follows[joint]
            old = unit_vectors(rotation[:, start] @ direction)
            new = unit_vectors(positions[:, end] - positions[:, start])
            columns = (rotate_between(old, new, rotation[:, start, :, k]) for k in range(3))
            linked[:, joint] = np.stack(list(columns), axis=-1)
        return linked if self.standing is None else linked @ self.standing


@dataclass(frozen=True, eq=False)
class SkinnedDrive:
    """An identity with joints, ready to be driven: a `Drive` that also gives the motion of its joints."""

    joints: tuple[str, ...]
    """Names of the identity's joints."""
    rig: Rig
    """Joints, and skinning weights of all V vertices, in the identity's normalisation."""
    skinned: SkinnedMesh
    """The identity's distinct positions (W <= V), skinned."""
    follow: Callable[[Float[np.ndarray, "U 3"]], Pose]
    """Maps the vertices of a driving frame to the pose of the driving's joints; not used where these are known."""
    stride: float
    """The identity's displacement over the driving's, each in its normalisation: the ratio of leg lengths."""
    feet: Feet | None
    """Contact points of the soles; None if there are none, and then nothing is planted."""
    group: Int[np.ndarray, " V"]
    """Index of each vertex among the distinct positions."""
    name: str
    """Name of the driving, for error messages."""
    confidence: tuple[Confidence | None, Confidence | None] | None = None
    """Confidence of the predictions for the identity and for the driving; None where there were none."""
    known: JointTrack | None = None
    """Motion of the driving's joints over the whole clip, where its file has it."""
    linked: LinkedJoints | None = None
    """Which joint of the driving each joint of the identity follows; None: the one at its own place."""

    def __call__(self, frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the identity's vertices for every driving frame; of a known motion, for all frames from its first."""
        for t, vertices in enumerate(check_size(frames, self.name)):
            rotation, positions = self.driving_pose(t, vertices)
            yield self.posed(self._linked(rotation[None], positions[None])[0], self.stride * positions[0])

    def at(self, frames: list[int]) -> SkinnedDrive:
        """Return the drive for some frames of the clip; only a known motion depends on which these are."""
        if self.known is None:
            return self
        known = replace(self.known, rotation=self.known.rotation[frames], positions=self.known.positions[frames])
        return replace(self, known=known)

    def limited(self, vertices: Float[np.ndarray, "V 3"], influences: int) -> SkinnedDrive:
        """Return this drive with only the largest weights of each vertex; `vertices` is the identity, normalised."""
        _, first = np.unique(self.group, return_index=True)
        rig = self.rig.limited(influences)
        distinct = replace(rig, weights=rig.weights[first])
        return replace(self, rig=rig, skinned=SkinnedMesh.of(vertices[first], distinct, self.skinned.parents))

    def track(self, frames: Iterable[Float[np.ndarray, "U 3"]], fps: float) -> JointTrack:
        """Return the motion of the driving's joints and soles over all frames."""
        poses, soles = [], []
        for t, vertices in enumerate(check_size(frames, self.name)):
            poses.append(self.driving_pose(t, vertices))
            if self.feet is not None:
                soles.append(self.feet.driving_soles(vertices))
        rotation, positions = (np.stack(arrays) for arrays in zip(*poses, strict=True))
        return JointTrack(rotation, positions, fps, np.stack(soles) if soles else None)

    def motion(self, track: JointTrack, across: float | None, in_place: bool, ground: bool) -> PosedJoints:
        """Return the motion of the identity's joints.

        Args:
            track: motion of the driving's joints.
            across: scale from the driving's displacement over the ground (x and z) to the identity's, which is kept
                then; None is `stride`.
            in_place: no displacement over the ground.
            ground: correct root path and legs so that soles stand where the driving's do.
        """
        scale = (self.stride if across is None else across, self.stride)
        rotation = self._linked(track.rotation, track.positions)
        posed = PosedJoints(rotation, root_path(track, *scale, in_place))
        if not ground or self.feet is None:
            return posed
        # In place, feet slide as they should: only heights are corrected.
        return plant_feet(posed, track, self.skinned, self.feet, scale, across is None, not in_place)

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Return the identity's vertices for world rotations of the joints and a position of the root joint."""
        return self.skinned.posed(rotation, root).take(self.group, axis=0)

    def driving_pose(self, t: int, vertices: Float[np.ndarray, "U 3"]) -> Pose:
        """Return the pose of the driving's joints in frame t of the clip, which has these vertices."""
        if self.known is None:
            return self.follow(vertices)
        return self.known.rotation[t], self.known.positions[t]

    @property
    def person(self) -> Mapping[str, int]:
        """Index of each joint of the identity that is known to be a person's, by our name."""
        return {name: j for j, name in enumerate(self.joints)} if self.linked is None else self.linked.person

    @property
    def driving_joints(self) -> tuple[str, ...]:
        """Names of the driving's joints."""
        return self.joints if self.linked is None else self.linked.driving

    def _linked(
        self, rotation: Float[np.ndarray, "T D 3 3"], positions: Float[np.ndarray, "T D 3"]
    ) -> Float[np.ndarray, "T J 3 3"]:
        return rotation if self.linked is None else self.linked.rotations(rotation, positions)


def with_root_motion(
    frames: Iterable[Float[np.ndarray, "U 3"]], shapes: Shapes, name: str
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Move the centre of each shape's bounding box to that of the driving frame, scaled.

    Driving frames are in the driving's normalisation, where its first frame has radius 1. The scale is the radius of
    the first result, so that a large identity moves as far as a small one in multiples of its own size.

    Raises:
        InputError: all vertices of a frame of the clip `name` are at one point.
    """
    scale = None
    # Shapes may be made of windows, which read ahead; `tee` keeps the frames between the two.
    given, ahead = itertools.tee(check_size(frames, name))
    for vertices, shape in zip(given, shapes(ahead), strict=True):
        result = shape - bbox_centre(shape)
        scale = radius(result) if scale is None else scale  # of the first frame: a size that does not change over time
        yield result + bbox_centre(vertices) * scale


def check_size(frames: Iterable[Float[np.ndarray, "U 3"]], name: str) -> Iterator[Float[np.ndarray, "U 3"]]:
    """Yield the frames of the clip `name`, checking that they have a size.

    Raises:
        InputError: all vertices of a frame are at one point.
    """
    for t, vertices in enumerate(frames):
        if not (vertices != vertices[0]).any():
            raise InputError(
                f"{name}: expected some size in frame {t} of those taken, found all vertices at one point; "
                "repair that frame, or end the clip before it with --stop"
            )
        yield vertices
