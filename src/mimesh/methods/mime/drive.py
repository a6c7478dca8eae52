"""mime as an ONNX file, run by onnxruntime: both meshes are read once, and the shipped body is fitted to them from
there; then each frame is measured and skinned.

Inputs "points", "normals" (1, N, 3) of a surface and "vertices", "vertex_normals" (1, V, 3) of the same mesh; outputs
"rotation" (1, J, 3, 3) and "joints" (1, J, 3), and "scores" (1, V, J), whose softmax is the skinning weights. Any unit
and place will do; normals that are not known are zero. A frame is then linear blend skinning.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...core.canonical_order import canonical_faces, rank_vertices
from ...core.geometry import vertex_normals
from ...core.joint_tracks import Feet, Track, grounded, soles, straight
from ...core.mesh import Clip, Mesh
from ...core.rig import Rig, Skinned, leg_length
from ...core.surface_points import Samples
from ..npt import batch_of_one, generator
from ..root_motion import sized
from .body_fit import Cloud, figure, fitted
from .confidence import Doubt, turns_apart
from .denoise import Calm, outward
from .part_tracking import Parts, mean_rotation
from .weight_cleanup import without_islands

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

CHUNK = 16_384
"""Vertices that are weighed at a time."""
READINGS, WEIGHING = 8, 3
"""Of a mesh, each of other points of its surface, whose mean is taken; and how many of them weigh vertices too."""
FOLLOWED = 2
"""Every so many of the places that are read are followed through a clip."""
ASKED, DISAGREE = 4, 15.0
"""Further frames that may say which points are whose, where the readings turned back by the motion are so many degrees
from their mean (the median of them)."""
Pose = tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]
"""Rotation and place of every joint."""
Weighed = tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]
"""Points and normals of a mesh whose weights are wanted."""
Follow = Callable[[Float[np.ndarray, "U 3"]], Pose]
"""From vertices of a driving frame to its pose."""


@dataclass(frozen=True, eq=False)
class Puppet:
    """An identity that is ready to be driven: a `Drive` that can say what the joints do."""

    joints: tuple[str, ...]
    """Their names."""
    rig: Rig
    """Of all vertices, in the identity's Frame."""
    skinned: Skinned
    follow: Follow
    stride: float
    """How much farther than the driving it goes."""
    feet: Feet
    group: Int[np.ndarray, " V"]
    """Vertices at one place are moved as one."""
    name: str
    """Of the driving."""
    doubts: tuple[Doubt, Doubt]
    """Of the identity and of the driving."""

    def __call__(self, frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
        return (self.posed(rotation, self.stride * places[0]) for rotation, places in self._poses(frames))

    def track(self, frames: Iterable[Float[np.ndarray, "U 3"]], fps: float) -> Track:
        """What the driving's joints do in all frames."""
        rotation, places = (np.stack(arrays) for arrays in zip(*self._poses(frames), strict=True))
        return Track(rotation, places, fps)

    def path(self, track: Track, across: float | None, drop: bool, ground: bool) -> Float[np.ndarray, "T 3"]:
        """Where the identity's root joint goes: `across` times the driving's way (None: as far as its legs make it).

        Up and down it goes as its legs make it. With `drop` it stays where it is, but for up and down; with `ground`
        the feet stay where they stand.
        """
        path = straight(track, self.stride if across is None else across, self.stride, drop)
        if not ground:
            return path
        corrected = grounded(track, path, self.skinned, self.feet, self.stride)
        return np.where([drop, False, drop], path, corrected)

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """All vertices in a pose."""
        return self.skinned.posed(rotation, root)[self.group]

    def _poses(self, frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Pose]:
        return (self.follow(vertices) for vertices in sized(frames, self.name))


@dataclass(frozen=True, eq=False)
class Agreement:
    """What the glimpses of a clip say of its joints in one of them."""

    frame: int
    """Which."""
    points: Float[np.ndarray, "N 3"]
    """That are followed, in that frame."""
    mean: Rig
    """Weights are those of the points."""
    leg: float
    """Length of a leg."""
    doubt: Doubt


@dataclass(frozen=True, eq=False)
class Mime:
    """A loaded network, ready for any identity."""

    rough: ClassVar[bool] = False
    name: str
    session: InferenceSession
    joints: tuple[str, ...]
    """Their names."""
    parents: tuple[int, ...]
    legs: tuple[tuple[int, ...], ...]
    """Joints from hip to ankle."""
    points: int
    """That are read of a mesh."""
    fits: bool = True
    """Whether what is read is the start of a fit of the shipped body, where these are its joints."""
    seed: int = 0

    @property
    def fitting(self) -> bool:
        """Whether a fit starts from what is read."""
        return self.fits and self.joints == figure().names

    def prepare(self, identity: Mesh, driving: Clip) -> Puppet:
        """Read the identity and the driving's glimpses, once for all; every frame is then measured against those.

        The root joint goes the driving's way, shorter or longer as the legs are.
        """
        ranked = rank_vertices(identity.vertices)
        with ThreadPoolExecutor(1) as beside:
            own = beside.submit(self._rig, outward(identity))
            follow, agreed = self._follow(dataclasses.replace(driving, mesh=outward(driving.mesh)))
            rig, doubt = own.result()
        vertices = ranked.merge(identity.vertices)
        skinned = Skinned.of(vertices, rig, self.parents)
        stride = leg_length(rig.joints, self.legs) / agreed.leg
        every = dataclasses.replace(rig, weights=rig.weights[ranked.group])
        ankles = [leg[-1] for leg in self.legs]
        stand = tuple(j for j, parent in enumerate(self.parents) if j in ankles or parent in ankles)
        feet = Feet(stand, agreed.leg, soles(rig, vertices, stand), soles(agreed.mean, agreed.points, stand))
        # Vertices of a point cloud may be denser on one limb than on another, and sparse on all.
        pairs = ((doubt, identity), (agreed.doubt, driving.mesh))
        one, other = (d if len(mesh.faces) else dataclasses.replace(d, limbs={}, astray={}) for d, mesh in pairs)
        facts = (ranked.group, driving.mesh.name, (one, other))
        return Puppet(self.joints, every, skinned, follow, stride, feet, *facts)

    def glance(self, mesh: Mesh) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """How undecided the skinning weights of a mesh are in one reading, and how the root joint is turned."""
        mesh = outward(mesh)
        mesh = dataclasses.replace(mesh, vertices=Calm.of(mesh)(mesh.vertices))
        places = Samples.of(mesh, self.points, generator(self.seed, 0))
        rig = self._read(places, mesh.vertices, (places.points(mesh.vertices), places.normals(mesh.vertices)))
        return Doubt.of(0.0, rig.weights, self.joints, self.parents).undecided, rig.rotation[0]

    def _rig(self, mesh: Mesh) -> tuple[Rig, Doubt]:
        """Joints of a mesh and skinning weights of its distinct positions: the mean of several readings."""
        ranked = rank_vertices(mesh.vertices)
        vertices = ranked.merge(mesh.vertices)
        faces = ranked.group[canonical_faces(mesh.faces, ranked.group)]
        normals = vertex_normals(vertices, faces) if len(faces) else np.zeros_like(vertices)
        calm = Calm.of(mesh)(mesh.vertices)
        places = Samples.of(dataclasses.replace(mesh, vertices=calm), READINGS * self.points, generator(self.seed, 0))
        # Places are spread evenly, which vertices are not: what is doubtful is asked of them.
        even = places.part(0, READINGS)
        given = np.concatenate([vertices, even.points(calm)]), np.concatenate([normals, even.normals(calm)])
        which = [given if k < WEIGHING else None for k in range(READINGS)]
        rigs = [self._read(places.part(k, READINGS), calm, which[k]) for k in range(READINGS)]
        mean = _mean(rigs)
        weights, there = np.split(mean.weights, [len(vertices)])
        rig = dataclasses.replace(mean, weights=without_islands(weights, vertices, faces, self.parents))
        # Smoothing shrinks a surface: its normals are the better for it, its points are not.
        cloud = Cloud(places.points(mesh.vertices), places.normals(calm))
        return self._fitted(rig, self._doubt(rigs, mean, there), cloud)

    def _fitted(self, rig: Rig, doubt: Doubt, cloud: Cloud) -> tuple[Rig, Doubt]:
        """The rig with the joints of the body that fits the surface, where joints are the body's."""
        if not self.fitting:
            return rig, doubt
        fit = fitted(cloud, rig.rotation, rig.joints)
        rig = dataclasses.replace(rig, rotation=fit.rotation, joints=fit.joints)
        return rig, dataclasses.replace(doubt, astray=fit.astray, bare=fit.bare)

    def _doubt(self, rigs: list[Rig], mean: Rig, weights: Float[np.ndarray, "N J"]) -> Doubt:
        apart = float(np.median([turns_apart(rig, mean) for rig in rigs]))
        return Doubt.of(apart, weights, self.joints, self.parents)

    def _follow(self, glimpses: Clip) -> tuple[Follow, Agreement]:
        """How a clip turns the joints and takes them along, frame by frame.

        One glimpse says which points are whose; from there the others are tracked, and what is read of them is turned
        back by that motion. The robust mean holds for every frame, so no frame has errors of its own, and what stands
        still stays still. The first frame, whose facing is known, is asked first; others where glimpses then disagree.
        """
        calm, frames = Calm.of(glimpses.mesh), list(glimpses.vertices)
        seen = [calm(vertices) for vertices in frames]
        mesh = dataclasses.replace(glimpses.mesh, vertices=seen[0])
        places = Samples.of(mesh, READINGS * self.points, generator(self.seed, 1))
        followed = places.part(0, FOLLOWED)
        best = self._agreed(places, frames, seen, 0)
        for t in range(1, len(seen), max(1, len(seen) // ASKED)):
            if best.doubt.apart > DISAGREE:
                best = min(best, self._agreed(places, frames, seen, t), key=lambda found: found.doubt.apart)
        cloud = Cloud(places.points(frames[best.frame]), places.normals(seen[best.frame]))
        mean, doubt = self._fitted(best.mean, best.doubt, cloud)
        leg = leg_length(mean.joints, self.legs) if self.fitting else best.leg
        best = dataclasses.replace(best, mean=mean, leg=leg, doubt=doubt)
        parts = Parts.of(best.points, best.mean.weights, best.mean.joints, self.parents)

        def follow(vertices):
            rotation, joints = parts.follow(followed.points(vertices))
            return rotation @ best.mean.rotation, joints

        return follow, best

    def _agreed(self, places: Samples, frames: list[np.ndarray], seen: list[np.ndarray], t: int) -> Agreement:
        """What glimpses say if frame t is right about which points are whose: followed as they are, read as `seen`."""
        followed, count = places.part(0, FOLLOWED), READINGS if len(seen) == 1 else 2
        rigs = [self._turned_back(places, k, seen[t], np.eye(3)) for k in range(count)]
        mean = _mean(rigs)
        parts = Parts.of(followed.points(frames[t]), mean.weights, mean.joints, self.parents)
        for k, vertices in enumerate(frames):
            if k != t:
                turns = parts.follow(followed.points(vertices))[0]
                rig = self._turned_back(places, k, seen[k], turns[0])
                rigs.append(dataclasses.replace(rig, rotation=turns.swapaxes(-1, -2) @ turns[0] @ rig.rotation))
        joints = mean.joints
        mean = _mean(rigs)
        leg = float(np.median([leg_length(rig.joints, self.legs) for rig in rigs]))
        doubt = self._doubt(rigs, mean, mean.weights)
        return Agreement(t, followed.points(frames[t]), dataclasses.replace(mean, joints=joints), leg, doubt)

    def _turned_back(
        self, places: Samples, k: int, vertices: Float[np.ndarray, "U 3"], turn: Float[np.ndarray, "3 3"]
    ) -> Rig:
        """Reading k of a frame turned back as a whole; the first few weigh the places that are followed."""
        stood, followed = vertices @ turn, places.part(0, FOLLOWED)
        given = (followed.points(stood), followed.normals(stood)) if k < WEIGHING else None
        return self._read(places.part(k, READINGS), stood, given)

    def _read(self, places: Samples, vertices: Float[np.ndarray, "U 3"], given: Weighed | None) -> Rig:
        """Joints from places on a mesh, and skinning weights of what is given, some of it at a time."""
        inputs = {"points": batch_of_one(places.points(vertices)), "normals": batch_of_one(places.normals(vertices))}
        weighed, normals = given or np.zeros((2, 1, 3))  # the network wants one at least
        weights = []
        for start in range(0, len(weighed), CHUNK):
            few = slice(start, start + CHUNK)
            inputs |= {"vertices": batch_of_one(weighed[few]), "vertex_normals": batch_of_one(normals[few])}
            found = self.session.run(["rotation", "joints", "scores"], inputs)
            rotation, joints, scores = (np.asarray(array)[0].astype(np.float64) for array in found)
            weights.append(np.exp(scores - scores.max(axis=1, keepdims=True)))
            weights[-1] /= weights[-1].sum(axis=1, keepdims=True)
        return Rig(rotation, joints, np.concatenate(weights) if given else np.zeros((0, len(joints))))


def _mean(rigs: list[Rig]) -> Rig:
    """What several readings of a mesh agree on."""
    joints = np.mean([rig.joints for rig in rigs], axis=0)
    weights = np.mean([rig.weights for rig in rigs if len(rig.weights)], axis=0)
    return Rig(mean_rotation(np.stack([rig.rotation for rig in rigs])), joints, weights)
