"""Move an identity by values of its file's nodes: copied from the same skeleton, or following matched joints.

The rig of any creature or thing can follow that of another one: a bat a dragon's flight, a fish a fish.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from jaxtyping import Float

from ..bodies.rig_matching import Creature, CreatureMotion, RigMatch, match_rigs, moved_creature, named_front
from ..core.errors import InputError, option
from ..core.frame_buffer import LazyFrames, Progress
from ..core.mesh import Clip, Mesh
from ..core.normalization import ORIENTATIONS, ROTATIONS, Normalization, parse_axis
from ..core.options import MotionOptions
from ..io.beside import missing_images, missing_images_notes
from ..io.gltf.animation import AnimatedValues, sample_joints
from ..io.gltf.edit import GltfSource
from ..io.gltf.own_animation import OwnAnimation
from ..io.gltf.own_rig import FileRig, GltfJoints, has_rig, read_file_rig
from ..mime.model import Mime
from .file_rigs import Rigs, read_rigs
from .known import Axes, Known
from .look import KINDS, OTHER, finds_joints, joint_finder, looks_like
from .placed import Moved, first_frame, surface_report
from .report import MatchReport, TransferReport, facing, torn_note
from .result import Precision, Timer


@dataclass(frozen=True, eq=False)
class NodeRoute:
    """An identity whose nodes get values from the driving's, and a clip."""

    identity: Mesh
    clip: Clip
    axes: Axes
    """Up and front of both, for the report, from which pictures are drawn."""
    rigs: Rigs
    """With the values that are copied, where no joints are matched."""
    matched: MatchedCreatures | None

    def with_refinement(self, refine: bool | None) -> NodeRoute:
        """Return this route: results of nodes are not refined."""
        return self

    def frame(self, t: int) -> Float[np.ndarray, "V 3"]:
        """Make the identity's vertices in frame t only, without MotionOptions."""
        return next(self._unchanged.vertices(np.array([t])))

    def joints(self, t: int) -> None:
        """Return the joints of both meshes: none that have roles."""

    def play(
        self, timer: Timer, options: MotionOptions, progress: Progress | None = None, dtype: Precision = np.float64
    ) -> Moved:
        """Animate the nodes of the identity's file, and report; nothing is planted."""
        identity, clip = self.identity, self.clip
        with timer.step("drive"):
            own = self._animation(options.root)
            if progress is not None:
                progress(len(clip), len(clip))
            moved = LazyFrames((own.frames, len(identity.vertices)), own.vertices, np.dtype(dtype))
            norms = Normalization.fit(identity, *self.axes[:2]), Normalization.fit(first_frame(clip), *self.axes[2:])
            report = surface_report(identity, moved, (facing(norms[0]), facing(norms[1])))
        facts = {"copied": True} if self.matched is None else {"copied": False, "match": self.matched.facts()}
        report |= {"rig": "own", **facts, "fingers": [], "foot_skate": None, "foot_skate_driving": None}
        notes = () if self.matched is None else self.matched.notes
        notes += torn_note(report, identity.name, found=False) + missing_images_notes(missing_images(identity))
        return Moved(moved, None, own, cast(TransferReport, report), notes)

    def _animation(self, root: str = "scale") -> OwnAnimation:
        """Compute the values of the identity's nodes in all frames; `root` is for matched joints (`MotionOptions`)."""
        source, name, length = self.identity.source, self.clip.mesh.name, len(self.clip)
        assert isinstance(source, GltfSource)
        if self.matched is not None:
            return OwnAnimation(source, name, self.matched.tracks(root), self.clip.fps, length, {})
        assert self.rigs.copied is not None
        person = {} if self.rigs.identity is None else self.rigs.identity.person
        return OwnAnimation(source, name, self.rigs.copied.tracks, self.clip.fps, length, person)

    @cached_property
    def _unchanged(self) -> OwnAnimation:
        """The animation with the path scaled, which single frames are made of."""
        return self._animation()


SURE, SURE_ACROSS = 0.45, 0.6
"""Confidence below which a match is refused: of two creatures, and of a creature with a person or a four-legged animal.
Chosen by eye on pairs of a pool's characters (docs/log/animals.md)."""


@dataclass(frozen=True, eq=False)
class MatchedCreatures:
    """The rigs of both files, whose joints are matched."""

    identity: FileRig
    driving: FileRig
    joints: GltfJoints
    """Of the driving."""
    axes: Axes
    """Up and front of both files."""
    turns: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]
    """Rotations of both files' axes to y up, +z front."""
    creatures: tuple[Creature, Creature]
    match: RigMatch
    notes: tuple[str, ...]

    def facts(self) -> MatchReport:
        """Return the figures of the match for the report."""
        match, (mine, theirs) = self.match, (creature.rig.joint_names for creature in self.creatures)
        return {
            "confidence": round(match.confidence, 3),
            "covered": [round(share, 3) for share in match.covered],
            "chains": round(match.chain_agreement, 3),
            "names": None if match.name_agreement is None else round(match.name_agreement, 3),
            "joints": {
                name: theirs[int(row.argmax())] for name, row in zip(mine, match.follows, strict=True) if row.any()
            },
        }

    def tracks(self, root: str) -> AnimatedValues:
        """Compute the animated values of the identity's nodes in all frames of the driving."""
        document, nodes = self.joints.document, self.driving.nodes
        world = sample_joints(document, self.joints.channels, self.joints.times, nodes)
        if not np.isfinite(world).all():
            raise InputError(f"{document.path}: expected finite joints, found NaN or infinity; export it again")
        rest = self.driving.scene.T_world_node[nodes]
        mine, theirs = self.turns
        linear = theirs @ world[..., :3, :3] @ np.linalg.pinv(rest[:, :3, :3]) @ theirs.T
        motion = CreatureMotion(linear, world[..., :3, 3] @ theirs.T)
        moved = moved_creature(*self.creatures, self.match, motion, root)
        back = CreatureMotion(mine.T @ moved.linear @ mine, moved.positions @ mine)
        joints = np.flatnonzero(self.creatures[0].moving).tolist()
        return self.identity.tracks(joints, back.transforms(self.identity.character.joints)[:, joints])


def matched_creatures(
    identity: Mesh, clip: Clip, rigs: Rigs, mime: Mime | None, known: Known
) -> MatchedCreatures | None:
    """Match the rigs of both files with each other, if these are of other creatures; None: the model moves the mesh.

    Args:
        rigs: as they are read by the names of their joints.

    Raises:
        InputError: the rigs are of other creatures, and are not matched with certainty.
    """
    asked = OTHER if rigs.only_copied else known.body
    if asked not in ("auto", OTHER) or (asked == "auto" and not any(rigs.unnamed)):
        return None
    try:
        matched = match_creatures(identity, clip, known.axes)
    except InputError:
        if asked == OTHER:
            raise
        return None  # the note of `rigs` says what is wrong with it
    if matched is None or asked == OTHER:
        return matched if matched is None else sure_match(matched, SURE)
    if mime is None or not finds_joints(mime):
        return None
    of_meshes = known.axes[:2], known.axes[2:]
    find = joint_finder(mime, of_meshes[0]), joint_finder(mime, of_meshes[1])
    by_surface = read_rigs(identity, clip, known, find=find)
    if None not in by_surface.bodies:
        return None
    mixed = any(body is not None for body in rigs.bodies)
    least, advice = SURE_ACROSS if mixed else SURE, ""
    if matched.match.confidence < least:
        shown = [
            {own} if own is not None else set(looks_like(mime, mesh, axes))
            for own, mesh, axes in zip(rigs.bodies, (identity, clip.mesh), of_meshes, strict=True)
        ]
        if shown[0] & shown[1]:  # the joints are found on the surface, and a note says why
            return None
        advice = _surface_advice(shown, (identity.name, clip.mesh.name))
    return sure_match(matched, least, advice)


def _surface_advice(shown: list[set[str]], names: tuple[str, str]) -> str:
    """Say how to move two meshes of which only one is known to be a person or an animal, if the other is one, too."""
    for k in (0, 1):
        if shown[k] and not shown[1 - k]:
            body = min(shown[k])
            found = f"{option('rig', 'mimesh')} {option('body', body)} finds joints on the surfaces"
            return f"; if {names[1 - k]} is {KINDS[body]}, too, {found}"
    return ""


def match_creatures(identity: Mesh, clip: Clip, axes: Axes) -> MatchedCreatures | None:
    """Match the rigs of two files; None where one of them has none."""
    joints = clip.skeleton
    if not isinstance(joints, GltfJoints) or joints.mesh is None or not has_rig(joints.mesh) or not has_rig(identity):
        return None
    rigs = read_file_rig(identity), read_file_rig(joints.mesh)
    up, front, note = _axes(rigs[0], *axes[:2], (option("up"), option("front")))
    driving_up, driving_front, more = _axes(rigs[1], *axes[2:], (option("driving_up"), option("driving_front")))
    known = up, front, driving_up, driving_front
    turn, driving_turn = (ROTATIONS[ORIENTATIONS.index(pair)] for pair in (known[:2], known[2:]))
    creatures = Creature(rigs[0].character.turned(turn)), Creature(rigs[1].character.turned(driving_turn))
    notes = tuple(line for line in (note, more) if line is not None)
    return MatchedCreatures(*rigs, joints, known, (turn, driving_turn), creatures, match_rigs(*creatures), notes)


def sure_match(matched: MatchedCreatures, least: float, else_: str = "") -> MatchedCreatures:
    """Return a match, with a note that says how sure it is.

    Args:
        else_: further advice for the message of the error.

    Raises:
        InputError: its confidence is less than `least`.
    """
    match, names = matched.match, [rig.source.document.path.name for rig in (matched.identity, matched.driving)]
    if match.confidence < least:
        raise InputError(
            f"{names[0]}, {names[1]}: expected two people, two four-legged animals, or rigs whose joints correspond, "
            f"found a match with a confidence of {match.confidence:.2f} (needed: {least}): matched joints carry "
            f"{match.covered[0]:.0%} of the one and {match.covered[1]:.0%} of the other; give a driving with limbs of "
            f"the same kind, or name corresponding joints alike (Wing1.L, Tail2){else_}"
        )
    count = int(match.follows.any(axis=1).sum())
    note = (
        f"{names[0]} is moved as a creature with limbs of its own: {count} joints follow those of {names[1]}, matched "
        f"by names and places (confidence {match.confidence:.2f})"
    )
    return dataclasses.replace(matched, notes=(note, *matched.notes))


def _axes(rig: FileRig, up: str | None, front: str | None, options: tuple[str, str]) -> tuple[str, str, str | None]:
    """Return up and front of a file, with a note if the front is only assumed."""
    up, front = parse_axis(up, options[0]) or "+y", parse_axis(front, options[1])
    known = front or (named_front(rig.character) if up == "+y" else None)
    if known is not None:
        return up, known, None
    assumed = next(axes[1] for axes in ORIENTATIONS if axes[0] == up and axes[1] in ("+z", "+y"))
    name = rig.source.document.path.name
    return up, assumed, f"{name} is taken to face {assumed}: no joint is called left, head or tail; {options[1]} tells"
