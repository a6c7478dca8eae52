"""Plant the feet of a moved identity where the driving's soles stand: correct the root path, then the legs by IK.

First it is detected when the driving's contact points stand. What a sole of the identity is moved by is a sum: the
correction of the root, which moves the whole body, and that of its leg. All are found together by linear least squares
over the frames of a clip. Where the driving's sole stands, the identity's should not slide more than that one does,
scaled, and should be as high; the root's correction should be a smooth path, the legs' small and smooth. So the root
takes what is common and slow, such as a stride of another length, the legs take what is left, and corrections grow and
fade between contacts by themselves. A leg of two bones follows by inverse kinematics: bones keep their lengths. Hands
that stand on the floor are feet of arms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .geometry import factor, rotations_between, smooth_step, unit_vectors
from .joint_tracks import JointTrack
from .rig import descendants, leg_length
from .skinning import SkinnedMesh
from .soles import Feet, LowParts

STANDING_SPEED = (0.4, 1.2)
"""Leg lengths a second: a contact point slower than the first stands, one faster than the second does not. Captured
runs slide by up to 0.7 where the foot stands; the foot in the air moves at 4 to 12."""
STANDING_HEIGHT = (0.08, 0.18)
"""Leg lengths over the ground, of a point that stands and of one that does not. Captures are uneven by 0.05."""
NEAR_GROUND = (0.1, 0.35)
"""Leg lengths over the ground: the height of a foot is corrected fully below the first, and not above the second."""
HIPS_HEIGHT = (0.2, 0.35)
"""Leg lengths over the ground: with the hips below the first, nobody stands: people lie, roll or swim."""
HIPS_OVER_HANDS = (0.1, 0.2)
"""The same for hands, which stand in push-ups when the hips are at 0.25; those of people who lie are at 0.12."""
UPRIGHT = 0.7
"""Leg lengths of the hips over the lowest sole: in a clip that gets there somebody stands, not only sits or crawls."""
NO_PATH = 1e-4
"""Leg lengths: a root that moves less has no path in its file, so its height says nothing."""
GROUND_SHARE = 0.25
"""The ground is the height that the lowest point has, or is below, in this share of the frames in which it stands."""
NEVER_SLOW = 0.1
"""Share of the frames far below a ground, and mean weight of their slowness, from which and up to which it is none."""
SHORTEST_CONTACT = 0.05
"""Seconds: shorter contacts, and gaps between them, are noise. Feet of sprinters stand for 0.1 (Weyand et al. 2000)."""
FEWEST_FRAMES = 3
"""Frames below which contacts are not looked for."""
TREADMILL_SPEED = 0.4
"""Leg lengths a second from which on a ground that moves is looked for."""


@dataclass(frozen=True, eq=False)
class FootContacts:
    """Which contact points of F feet stand on the ground in T frames, from 0 (no) to 1 (yes)."""

    soles: Float[np.ndarray, "T F C 3"]
    """The contact points."""
    standing: Float[np.ndarray, "S F C"]
    """Between each frame and the next one (S = T - 1): low and slow."""
    near: Float[np.ndarray, "T F"]
    """In each frame: low."""
    ground_step: Float[np.ndarray, " 3"]
    """Displacement of the ground from frame to frame: zero, but for a person who walks or runs in place."""
    hands: int
    """How many of the feet, the last ones, are hands."""

    @property
    def planted(self) -> Bool[np.ndarray, "S F C"]:
        """Whether points stand, yes or no."""
        return self.standing > 0.5

    @property
    def height(self) -> float:
        """Height of the ground: quantile GROUND_SHARE of the lowest foot that stands, of hands where none does."""
        stand = np.any(self.standing > 0.5, axis=2)
        legs = stand.shape[1] - self.hands
        part = slice(legs) if stand[:, :legs].any() else slice(legs, None)
        heights = np.where(stand, self.soles[:-1, ..., 1].min(axis=2), np.inf)[:, part].min(axis=1)
        return float(np.quantile(heights[heights < np.inf], GROUND_SHARE))

    def intervals(self, fps: float) -> list[list[tuple[int, int]]]:
        """Return for each foot when it is on the ground: first frame, and the one after the last, of each time."""
        found, shortest = [], SHORTEST_CONTACT * fps
        for standing in np.any(self.planted, axis=2).T:
            change = np.diff(np.pad(standing, 1).astype(int))
            # A point that stands between two frames is on the ground in both.
            begin, end = np.flatnonzero(change > 0), np.flatnonzero(change < 0) + 1
            apart = begin[1:] - end[:-1] >= shortest
            begin, end = begin[np.append(True, apart)[: len(begin)]], end[np.append(apart, True)[: len(end)]]
            rows = zip(begin.tolist(), end.tolist(), strict=True)
            found.append([(first, stop) for first, stop in rows if stop - first >= shortest])
        return found


def find_contacts(track: JointTrack, leg: float, hands: int = 0) -> FootContacts | None:
    """Detect contacts from the paths of a clip's contact points and of its root joint; None if it has none.

    Args:
        track: the clip.
        leg: length of a leg.
        hands: how many of the feet, the last ones, are hands.
    """
    if track.soles is None or len(track.soles) < FEWEST_FRAMES:
        return None
    soles, root = track.soles / leg, track.positions[:, 0] / leg
    velocity = np.diff(soles, axis=0) * track.fps
    height = np.maximum(soles[1:, ..., 1], soles[:-1, ..., 1])
    ground = _ground(height, np.linalg.norm(velocity, axis=-1))
    low = falling(height - ground, STANDING_HEIGHT)
    is_hand = np.arange(soles.shape[1]) >= soles.shape[1] - hands
    above = root[:, 1:2] - ground
    upright = 1 - np.where(is_hand, falling(above, HIPS_OVER_HANDS), falling(above, HIPS_HEIGHT))
    moving = _ground_velocity(velocity, low, np.diff(root, axis=0) * track.fps)
    slow = falling(np.linalg.norm(velocity - moving, axis=-1), STANDING_SPEED)
    standing = low * slow * np.minimum(upright[1:], upright[:-1])[..., None]
    if not (standing > 0.5).any():
        return None
    # Hands that hang or swing low are where the arms are: only those on the floor are corrected.
    height = soles[..., 1].min(axis=2) - ground
    near = np.where(is_hand, falling(height, STANDING_HEIGHT), falling(height, NEAR_GROUND)) * upright
    return FootContacts(track.soles, standing, near, moving * leg / track.fps, hands)


def _ground(height: Float[np.ndarray, "S F C"], speed: Float[np.ndarray, "S F C"]) -> float:
    """Return the height of the ground: a low quantile of the lowest point's height in frames in which it is slow.

    Not the lowest height of all: feet of captures sink into the ground for moments. Soles of who runs in place are
    fast whenever they are on the ground, and slow where they turn in the air, far above.
    """
    count = len(height)
    lowest = height.reshape(count, -1).argmin(axis=1)
    height, speed = (array.reshape(count, -1)[np.arange(count), lowest] for array in (height, speed))
    # With a little weight for every frame, for clips in which feet never are slow (a treadmill).
    weight, order = falling(speed, STANDING_SPEED) + 1e-3, height.argsort(kind="stable")

    def low_height(weight: Float[np.ndarray, " S"]) -> float:
        share = np.cumsum(weight[order]) / weight.sum()
        return float(height[order][np.searchsorted(share, GROUND_SHARE)])

    ground = low_height(weight)
    below = height < ground - STANDING_HEIGHT[1]
    if below.mean() > NEVER_SLOW and weight[below].mean() < NEVER_SLOW:
        return low_height(np.ones(count))
    return ground


def _ground_velocity(
    velocity: Float[np.ndarray, "S F C 3"], low: Float[np.ndarray, "S F C"], root: Float[np.ndarray, "S 3"]
) -> Float[np.ndarray, " 3"]:
    """Return the velocity of the ground: zero, but for a person who walks or runs in place.

    Then low points have one common velocity most of the time, which is not that of the root.
    """
    still = np.zeros(3)
    if low.sum() == 0:
        return still

    def agreement(velocity_of_ground: Float[np.ndarray, " 3"]) -> float:
        """Share of the low points that move with this velocity."""
        return float(
            (low * falling(np.linalg.norm(velocity - velocity_of_ground, axis=-1), STANDING_SPEED)).sum() / low.sum()
        )

    common = np.median(velocity[low > 0.5], axis=0) if (low > 0.5).any() else still
    common[1] = 0
    size = np.linalg.norm(common)
    in_place = np.linalg.norm(root.mean(axis=0)[[0, 2]]) < 0.25 * size
    if size > TREADMILL_SPEED and in_place and agreement(common) > max(0.4, 2 * agreement(still)):
        return common
    return still


def falling(values: Float[np.ndarray, "*S"], limits: tuple[float, float]) -> Float[np.ndarray, "*S"]:
    """Map values to 1 below the first limit and 0 above the second, smoothly in between."""
    return 1 - smooth_step(values, limits)


RESTING = (0.02, 0.1)
"""Leg lengths of knees, seat or back over the ground: with them below the first, a person rests there; above the second
nobody does. Joints without a mesh play a body that is thinner or thicker than who was captured."""
KNEELING = (0.65, 0.8)
"""Leg lengths of the hips over the ground of who kneels, and of who stands, whose skirt may reach the ground."""
MISREAD_SPEED, MISREAD_HEIGHT = (1.5, 3.0), (0.2, 0.4)
"""Leg lengths a second and leg lengths: soles of the identity that slide or float by less are corrected, those that do
by more are not: the legs of one of the two meshes have not been recognised."""
LARGEST_STEP = 0.15
"""Leg lengths: largest correction of one leg."""
LONG_FOOT = 0.3
"""Leg lengths from heel to toes of people's feet: 0.1 to 0.32, of 60 characters. Those of monsters with short legs, up
to 0.77, tilt as far through the floor as they are longer. So what they are off by in some frames may be as much larger;
what they always are off by may not."""
CYCLE_ERROR = 0.06
"""Leg lengths: in the first and last frame of a cyclic clip the joints are at about the same places, relative to the
root. Cycles of captures are 0.035 apart; where corrections do not end as they begin, a seam of 1 % of the height
becomes one of 6 %."""
IN_PLACE = 0.1
"""Leg lengths: a cycle that gets less far than this is one in place."""
LOWERING = 0.1
"""Seconds before and after which the hips begin to go down, and are up again, where a leg is too short for its step."""
FLOATING = 0.01
"""Leg lengths that a standing leg may be too short by before the hips go down: legs that are almost straight bend a lot
when the hips go down a little."""
EVEN = 0.0075
"""Leg lengths: heights of soles that differ less from the driving's, scaled, are left as they are."""
UPWARD = np.array([0.0, 1.0, 0.0])
CLOSED, TINY = 1e6, 1e-9
"""Weight of the equations that close a cycle, and of those without influence; those of a standing sole have 1."""


@dataclass(frozen=True)
class Stiffness:
    """How far corrections are small and smooth, against the equations of standing soles (docs/log/rigs.md)."""

    leg_size: float
    """Seconds: slides that last longer than this are left to the root."""
    leg_bend: float
    """Seconds over which the correction of a leg begins and ends."""
    root_speed: float
    """Share of a slide that is rather left than corrected by the root."""
    root_bend: float
    """Seconds over which the root changes its speed."""
    root_hold: float
    """Weight against changes of the root's correction where no foot says how it should move: a trend while feet stand
    would go on before and after that."""


HEIGHT_SECONDS = 1 / 30
"""A height counts as much as a slide over the same distance in this time."""
SLIDES = Stiffness(leg_size=1.0, leg_bend=0.01, root_speed=0.02, root_bend=0.05, root_hold=0.0)
BLOCKS_BEND = 0.03
"""Seconds over which the root of a figure of blocks changes its speed: its legs cannot bend. A yeti jolts at up to 16
heights/s^2, its driving at 9; with 0.02 s at 23, and with 0.04 s soles of stiff legs are 3 % of a leg off."""
HEIGHTS = Stiffness(leg_size=0.1, leg_bend=0.02, root_speed=0.02, root_bend=0.1, root_hold=100.0)


@dataclass(frozen=True, eq=False)
class PosedJoints:
    """Pose of an identity in T frames."""

    rotation: Float[np.ndarray, "T J 3 3"]
    """World rotation of every joint."""
    root: Float[np.ndarray, "T 3"]
    """Position of the root joint."""


def plant_feet(
    posed: PosedJoints,
    track: JointTrack,
    skinned: SkinnedMesh,
    feet: Feet,
    scale: tuple[float, float],
    free_root: bool = True,
    slides: bool = True,
    floor: Callable[[float], float] = float,
) -> PosedJoints:
    """Correct a motion so that soles stand where the driving's do; nothing changes if those never stand.

    A leg of the identity without knee or ankle cannot bend: the root alone takes its sole to the ground.

    Args:
        posed: the motion of the identity.
        track: the motion of the driving.
        skinned: the identity.
        feet: contact points of both.
        scale: the identity's displacements over the driving's, over the ground and vertically.
        free_root: whether the path of the root over the ground may change; where the driving walks in place it never
            does.
        slides: whether to correct slides, or heights only.
        floor: height of the driving's floor from that of its planted soles.
    """
    contacts = find_contacts(track, feet.driving_leg, feet.hands)
    if contacts is None:
        return posed
    if feet.hands and not contacts.near[:, -feet.hands :].any():
        return plant_feet(
            posed, track.without_hands(feet.hands), skinned, feet.without_hands(), scale, free_root, slides, floor
        )
    leg, cyclic = feet.driving_leg * scale[1], is_cyclic(track, feet.driving_leg)
    soles, stiff = feet.identity_soles(posed.rotation, posed.root), feet.stiff
    blocks = bool(stiff.all())
    found = np.zeros((1 + len(feet.legs), *posed.root.shape))
    if slides:
        # Where the driving walks in place, a corrected root would drift.
        free_root = free_root and not contacts.ground_step.any()
        weight, error = _slides(soles, contacts, scale[0], track.fps, leg)
        for axis, closed_root in _ground_axes(track.positions[-1, 0] - track.positions[0, 0], feet.driving_leg):
            closed = (cyclic, cyclic and closed_root)
            along = _solve(weight, error @ axis, len(soles), track.fps, SLIDES, closed, stiff, free_root)
            found += along[..., None] * axis
    heights = soles[..., 1].min(axis=2)
    resting = _resting(track, floor(contacts.height), feet.driving_leg) if feet.body is not None else None
    raised = 0.0 if resting is None else resting.sunk
    feet_long = np.linalg.norm(soles[..., -1, :] - soles[..., 0, :], axis=-1).max(axis=0)
    reach = np.maximum(leg, feet_long / LONG_FOOT)
    weight, error, apart = _heights(heights, contacts, raised, scale[1], track.fps, leg, reach, blocks)
    if resting is not None:  # one more foot, on a leg that stays as it is
        lift = scale[1] * resting.height - apart - feet.identity_lowest(posed.rotation, posed.root, with_soles=blocks)
        feet_too = np.arange(weight.shape[1]) < weight.shape[1] - feet.hands
        if blocks:  # what is lowest rests, be it a foot: the others cannot reach the floor
            weight, feet_too = weight * (1 - resting.weight[:, None]), np.zeros_like(feet_too)
        also = np.c_[resting.feet * feet_too, resting.weight]
        weight = np.maximum(np.c_[weight, np.zeros(len(weight))], also / (HEIGHT_SECONDS * track.fps) ** 2)
        error, stiff = np.c_[error, lift], np.append(stiff, True)
    stiffness = replace(HEIGHTS, root_bend=BLOCKS_BEND) if blocks else HEIGHTS
    found[..., 1] = _solve(weight, error, len(soles), track.fps, stiffness, (cyclic, cyclic), stiff)[: len(found)]
    root, steps = found[0], found[1:]
    steps *= np.minimum(1, LARGEST_STEP * reach[:, None] / np.maximum(np.linalg.norm(steps, axis=-1), 1e-9))[..., None]
    positions = skinned.joint_positions(posed.rotation, posed.root)
    bends = [1.0] * (len(steps) - feet.hands) + [-1.0] * feet.hands  # knees to the front, elbows to the back
    legs = [limb for limb in zip(feet.legs, steps, bends, strict=True) if len(limb[0]) == 3]
    lowered = _lowered_hips(positions, legs, FLOATING * leg, track.fps, cyclic)[:, None] * UPWARD
    rotation = posed.rotation
    for joints, step, bend in legs:
        rotation = move_ankle(rotation, positions, joints, step + lowered, skinned.parents, bend)
    return PosedJoints(rotation, posed.root + root - lowered)


def level_soles(track: JointTrack, leg: float, hands: int, floor: Callable[[float], float]) -> JointTrack:
    """Put the soles of a motion on its floor where they stand; those that never do stay as they are.

    For skeletons without a mesh. The shipped body plays them: its feet are as high as theirs, but not as long, and tilt
    through the floor or over it where theirs stand.

    Args:
        track: the motion, with contact points.
        leg, hands: see `find_contacts`.
        floor: see `plant_feet`.
    """
    contacts = find_contacts(track, leg, hands)
    if contacts is None or track.soles is None:
        return track
    standing = np.maximum(2 * contacts.standing.max(axis=2) - 1, 0)  # what comes down is left in the air
    stands = np.maximum(np.pad(standing, ((1, 0), (0, 0))), np.pad(standing, ((0, 1), (0, 0))))
    rise = stands * (floor(contacts.height) - track.soles[..., 1].min(axis=2))
    return replace(track, soles=track.soles + rise[..., None, None] * UPWARD)


def keep_above_floor(
    posed: PosedJoints,
    track: JointTrack,
    parts: LowParts,
    feet: Feet,
    scale: float,
    floor: Callable[[float], float] = float,
) -> PosedJoints:
    """Lift what is deeper in the floor than the driving: trunks of who sits, kneels or lies, and arms.

    Trunks may be lower below the hips than the driving's, heads larger, and arms longer. Feet stay where they are. Who
    stands is not lifted: what hangs below the hips is a skirt, a tail or a cape.

    Args:
        posed: a motion of the identity whose feet are planted.
        parts: outermost points of the identity.
        scale: the identity's heights over the driving's.
        The others are those of `plant_feet`.
    """
    contacts = find_contacts(track, feet.driving_leg, feet.hands)
    legs = len(feet.legs) - feet.hands
    if contacts is None or not (near := contacts.near[:, :legs] > 0.5).any():
        return posed
    ground, leg, cyclic = floor(contacts.height), feet.driving_leg * scale, is_cyclic(track, feet.driving_leg)
    theirs = contacts.soles[..., 1].min(axis=2)
    mine = feet.identity_soles(posed.rotation, posed.root)[..., 1].min(axis=2)
    if has_path(track.positions[:, 0], feet.driving_leg):
        own_ground = np.median((mine - scale * (theirs - ground))[:, :legs][near])
    else:  # whose hips stay in place while the body goes up and down: the floor is below the lowest sole
        own_ground = mine.min(axis=1)
    lowest = theirs.min(axis=1) if track.lowest is None else np.minimum(theirs.min(axis=1), track.lowest)
    allowed = own_ground + scale * np.minimum(lowest - ground, 0) - EVEN * leg

    def too_deep(part: SkinnedMesh, size: float) -> Float[np.ndarray, " T"]:
        """Return how far a part is too deep; one that is far deeper than its size allows has not been recognised."""
        heights = part.posed_frames(posed.rotation, np.zeros_like(posed.root))[..., 1].min(axis=1) + posed.root[:, 1]
        deep = np.maximum(allowed - heights, 0)
        return deep * falling(deep / size, MISREAD_HEIGHT)

    low = falling((track.positions[:, 0, 1] - ground) / feet.driving_leg, KNEELING)
    up = _envelope(too_deep(parts.trunk, leg) * low, track.fps, cyclic) if low.any() else low
    ways: list[tuple[tuple[int, ...], np.ndarray, float]] = [
        (limb, -up, 1.0) for limb in feet.legs[:legs] if len(limb) == 3
    ]
    lifted = posed.root + up[:, None] * UPWARD
    rotation, positions = posed.rotation, parts.trunk.joint_positions(posed.rotation, lifted)
    for arm, part in parts.arms:
        deep = _envelope(too_deep(part, leg_length(positions[0], (arm,))), track.fps, cyclic)
        stands = contacts.near[:, feet.legs.index(arm)] if arm in feet.legs else 0.0
        ways.append((arm, deep - np.maximum(stands * up, np.minimum(up, deep)), -1.0))
    for limb, way, bend in ways:
        if way.any():
            rotation = move_ankle(rotation, positions, limb, way[:, None] * UPWARD, parts.trunk.parents, bend)
    return PosedJoints(rotation, lifted)


def _lowered_hips(
    positions: Float[np.ndarray, "T J 3"],
    legs: list[tuple[tuple[int, ...], Float[np.ndarray, "T 3"], float]],
    tolerance: float,
    fps: float,
    cyclic: bool,
) -> Float[np.ndarray, " T"]:
    """Compute by how much the hips have to be lower for all legs to reach their steps, up to a tolerance; smooth."""
    missing = np.zeros(len(positions))
    for joints, step, _ in legs:
        line = positions[:, joints[2]] - positions[:, joints[0]] + step
        distance = np.linalg.norm(line, axis=1)
        # Lowering the hips shortens a leg that is not vertical by less.
        steep = np.maximum(-line[:, 1] / distance, 0.5)
        short = distance - longest_reach(positions, joints)[:, 0] - tolerance
        missing = np.maximum(missing, short / steep)
    return _envelope(missing, fps, cyclic)


def _envelope(heights: Float[np.ndarray, " T"], fps: float, cyclic: bool) -> Float[np.ndarray, " T"]:
    """Smooth heights so that they are hardly lower anywhere, and begin and end LOWERING seconds around."""
    from scipy.ndimage import gaussian_filter1d, maximum_filter1d

    mode, around = "wrap" if cyclic else "nearest", LOWERING * fps
    period = slice(None, -1) if cyclic else slice(None)  # the last frame of a cycle is the first one
    envelope = maximum_filter1d(heights[period], 2 * round(around) + 1, mode=mode)
    smooth = gaussian_filter1d(envelope, around / 2, mode=mode)
    return np.append(smooth, smooth[0]) if cyclic else smooth


def foot_skate(
    posed: PosedJoints, track: JointTrack, feet: Feet | None, scale: tuple[float, float]
) -> tuple[float, float] | None:
    """Measure the mean speed (per second) over the ground of the identity's soles while the driving's stand.

    The second figure is that of the driving's soles, times the scale. None if they never stand.
    """
    contacts = None if feet is None else find_contacts(track, feet.driving_leg, feet.hands)
    if feet is None or contacts is None or not contacts.planted.any():
        return None
    soles = feet.identity_soles(posed.rotation, posed.root)
    mine, driving = _steps(soles, contacts), scale[0] * _steps(contacts.soles, contacts)
    speeds = [float(np.linalg.norm(s, axis=-1)[contacts.planted].mean() * track.fps) for s in (mine, driving)]
    return speeds[0], speeds[1]


def is_cyclic(track: JointTrack, leg: float) -> bool:
    """Whether a clip ends as it begins, but for where on the ground: its last frame is its first one again."""
    around = track.positions - track.positions[:, :1]
    height = abs(track.positions[-1, 0, 1] - track.positions[0, 0, 1])
    apart = np.linalg.norm(around[-1] - around[0], axis=-1).max()
    return len(around) > 2 and bool(max(height, apart) < CYCLE_ERROR * leg)


def _ground_axes(displacement: Float[np.ndarray, " 3"], leg: float) -> list[tuple[Float[np.ndarray, " 3"], bool]]:
    """Return two horizontal axes, along a clip's displacement and across it, and whether the root ends as it begins.

    That is of cycles: the length of a step may change, but nobody drifts to the side, nor at all in place.
    """
    far = float(np.linalg.norm(displacement[[0, 2]]))
    x, z = displacement[[0, 2]] / far if far > IN_PLACE * leg else (1.0, 0.0)
    return [(np.array([x, 0, z]), far <= IN_PLACE * leg), (np.array([z, 0, -x]), True)]


def _steps(soles: Float[np.ndarray, "T F C 3"], contacts: FootContacts) -> Float[np.ndarray, "S F C 3"]:
    """Return the displacement of soles over the ground in each interval.

    The ground of who walks in place moves as these soles do while they stand: feet that are long for their legs roll
    half a step, which those of others could only make by lunging.
    """
    steps = np.diff(soles, axis=0) * [1, 0, 1]
    if contacts.ground_step.any():
        steps = steps - np.average(
            steps, axis=(0, 1, 2), weights=np.broadcast_to(contacts.standing[..., None], steps.shape)
        )
    return steps


def _slides(
    soles: Float[np.ndarray, "T F C 3"], contacts: FootContacts, scale: float, fps: float, leg: float
) -> tuple[Float[np.ndarray, "S F"], Float[np.ndarray, "S F 3"]]:
    """Compute the weight of each foot in each interval, and the displacement that removes what it slides too far.

    A sole may slide as far as the driving's does, scaled, in any direction: less is not made more.
    """
    mine = _steps(soles, contacts)
    size, allowed = (np.linalg.norm(steps, axis=-1) for steps in (mine, scale * _steps(contacts.soles, contacts)))
    weight = contacts.standing * falling(size * fps / leg, MISREAD_SPEED)
    excess = 1 - np.minimum(1, allowed / np.maximum(size, 1e-9))
    error = -((weight * excess)[..., None] * mine).sum(axis=2) / np.maximum(weight.sum(axis=2), 1e-9)[..., None]
    return weight.max(axis=2), error


def _heights(
    mine: Float[np.ndarray, "T F"],
    contacts: FootContacts,
    raised: Float[np.ndarray, " T"] | float,
    scale: float,
    fps: float,
    leg: float,
    reach: Float[np.ndarray, " F"],
    lowest: bool,
) -> tuple[Float[np.ndarray, "T F"], Float[np.ndarray, "T F"], float]:
    """Compute the weight of each foot in each frame, and how far it has to be lifted to be as high as the driving's.

    The last value is how far all of the identity is below the driving, scaled.

    Args:
        raised: how far the driving is lifted.
        reach: length of a leg, or more of one with a long foot (LONG_FOOT).
        lowest: compare the lowest soles of each frame: stiff legs swing through the ground, where the driving's bend.
    """
    standing, theirs = contacts.near, (contacts.soles[..., 1].min(axis=2).T + raised).T
    if lowest:
        standing = np.broadcast_to(standing.max(axis=1, keepdims=True), standing.shape)
        theirs, mine = (np.broadcast_to(of.min(axis=1, keepdims=True), of.shape) for of in (theirs, mine))
    error = scale * theirs - mine
    # Where the ground is does not matter: it is the same for all frames.
    near, legs = standing > 0.5, error.shape[1] - contacts.hands
    part = slice(legs) if near[:, :legs].any() else slice(legs, None)  # feet tell it where any is on the ground
    apart = float(np.median(error[:, part][near[:, part]])) if near.any() else 0.0
    error = error - apart
    off = np.abs(error)
    always = np.where(near, off, off.max()).min(axis=0)
    weight = standing * falling(always / leg + np.maximum(off - always, 0) / reach, MISREAD_HEIGHT)
    # Divided by the frame rate, as slides are, so that the rate has no influence on the balance with the penalties.
    weight = weight / (HEIGHT_SECONDS * fps) ** 2
    return weight, np.sign(error) * np.maximum(np.abs(error) - EVEN * leg, 0), apart


class Resting(NamedTuple):
    """How a driving rests on knees, seat or back in each frame."""

    weight: Float[np.ndarray, " T"]
    """How far it does, from 0 (no) to 1."""
    height: Float[np.ndarray, " T"]
    """Height of these when they are on the floor, or as far above as they are."""
    sunk: Float[np.ndarray, " T"]
    """How far it is in the floor, where it rests there."""
    feet: Float[np.ndarray, "T F"]
    """How far each foot is on the floor while it rests: of who sits or lies none stands (`HIPS_HEIGHT`)."""


def _resting(track: JointTrack, floor: float, leg: float) -> Resting | None:
    """Compute how a driving rests on its floor; None where its surface is not known."""
    if track.lowest is None:
        return None
    above, hips = (track.lowest - floor) / leg, (track.positions[:, 0, 1] - floor) / leg
    weight = falling(above, RESTING) * falling(hips, KNEELING)
    height = floor + leg * np.maximum(above - RESTING[0], 0)
    sunk = weight * leg * np.maximum(-above, 0)
    assert track.soles is not None
    soles = (track.soles[..., 1].min(axis=2) + sunk[:, None] - floor) / leg
    return Resting(weight, height, sunk, weight[:, None] * falling(soles, STANDING_HEIGHT))


def resting_lift(posed: PosedJoints, track: JointTrack, feet: Feet, scale: float) -> float | None:
    """Measure how far an identity has to be lifted to rest on y = 0 where a driving rests on its floor, in the median.

    For clips in which nobody is upright; None where nobody rests on knees, seat or back.
    """
    if feet.body is None or track.lowest is None:
        return None
    contacts = find_contacts(track, feet.driving_leg, feet.hands)
    floor = float(np.quantile(track.lowest, GROUND_SHARE)) if contacts is None else contacts.height
    resting = _resting(track, floor, feet.driving_leg)
    if resting is None or not (rests := resting.weight > 0.5).any():
        return None
    lowest = feet.identity_lowest(posed.rotation, posed.root, with_soles=True)
    return float(np.median((scale * (resting.height - floor) - lowest)[rests]))


def _lifted(track: JointTrack, lift: Float[np.ndarray, " T"]) -> JointTrack:
    assert track.soles is not None
    way = np.multiply.outer(lift, UPWARD)[:, None]
    below = None if track.lowest is None else track.lowest + lift
    return replace(track, positions=track.positions + way, soles=track.soles + way[:, None], lowest=below)


def ever_upright(track: JointTrack, feet: Feet) -> bool:
    """Whether a driving stands on its feet in any frame; else it sits, crawls, lies or stands on its hands."""
    assert track.soles is not None
    lowest = track.soles[:, : len(feet.legs) - feet.hands, :, 1].min(axis=(1, 2))
    return bool((track.positions[:, 0, 1] - lowest > UPRIGHT * feet.driving_leg).any())


def height_of_soles(posed: PosedJoints, track: JointTrack, feet: Feet, scale: float) -> tuple[float, float]:
    """Measure how far an identity has to be lifted for its lowest sole to be as high as the driving's, scaled.

    That is the median over the frames in which feet are on the ground (hands, where feet never are), or in which they
    are lowest, in a clip in which nobody stands. The second figure is the height of the driving's planted soles, or of
    its lowest ones.
    """
    assert track.soles is not None
    theirs, mine = track.soles[..., 1].min(axis=2), feet.identity_soles(posed.rotation, posed.root)[..., 1].min(axis=2)
    contacts, legs = find_contacts(track, feet.driving_leg, feet.hands), len(feet.legs) - feet.hands
    part = slice(legs)
    if contacts is None:
        height = theirs[:, part].min(axis=1)
        frames = height <= height.min() + NEAR_GROUND[0] * feet.driving_leg
    else:
        part = part if (contacts.near[:, :legs] > 0.5).any() else slice(legs, None)
        frames = (contacts.near[:, part] > 0.5).any(axis=1)
    lowest = theirs[frames, part].min(axis=1)
    moves = has_path(track.positions[:, 0], feet.driving_leg)  # without a path feet that spread are in the air
    planted = float(lowest.min()) if contacts is None or not moves else contacts.height
    return float(np.median(scale * lowest - mine[frames, part].min(axis=1))), planted


def has_path(root: Float[np.ndarray, "T 3"], leg: float) -> bool:
    """Whether a root moves; where there is one frame, that is not known."""
    return len(root) == 1 or bool(np.ptp(root, axis=0).max() > NO_PATH * leg)


def standing_track(track: JointTrack, leg: float) -> JointTrack:
    """Put the lowest sole of a motion that has no path at one height in every frame; other motions stay as they are.

    Without a path the hips stay where they are while the legs spread or bend. People who sit are left there.

    Args:
        track: the motion, with contact points.
        leg: length of a leg.
    """
    assert track.soles is not None
    root, lowest = track.positions[:, 0], track.soles[..., 1].min(axis=(1, 2))
    if has_path(root, leg) or np.ptp(lowest) <= EVEN * leg or (root[:, 1] - lowest).max() < UPRIGHT * leg:
        return track
    return _lifted(track, lowest.min() - lowest)


def _solve(
    weight: Float[np.ndarray, "S F"],
    error: Float[np.ndarray, "S F"],
    frames: int,
    fps: float,
    stiffness: Stiffness,
    closed: tuple[bool, bool],
    stiff: Bool[np.ndarray, " F"],
    free_root: bool = True,
) -> Float[np.ndarray, "G T"]:
    """Solve for the corrections of the root and of the F legs (G = 1 + F) along one axis.

    Minimises the sum over feet f of weight_f (K (root + leg_f) - error_f)^2, where K is the difference between frames
    (slides) or the identity (heights), plus quadratic penalties of size, speed and bending of each correction.

    Args:
        weight: of each foot in each interval (S = T - 1: slides) or frame (S = T: heights).
        error: what the corrections of root and leg together should change in it, or be.
        frames: T.
        fps: frames a second.
        stiffness: weights of the penalties.
        closed: whether the legs' corrections, and the root's, end as they begin.
        stiff: whether a leg stays as it is.
        free_root: whether the root is corrected.
    """
    from scipy import sparse

    unit = sparse.csr_array(sparse.eye_array(frames))
    step = unit[1:] - unit[:-1]
    cyclic = any(closed)
    bend = step[1:] - step[:-1]
    if cyclic:  # the last step is followed by the first one
        bend = sparse.csr_array(sparse.vstack([bend, step[:1] - step[-1:]]))
    gap = CLOSED * (unit[-1:] - unit[:1]).T @ (unit[-1:] - unit[:1])
    smooth = bend.T @ bend
    leg = unit / (stiffness.leg_size * fps) ** 2 + (stiffness.leg_bend * fps) ** 2 * smooth + closed[0] * gap
    standing = np.minimum(weight.sum(axis=1), 1)
    standing = np.minimum(standing[1:], standing[:-1]) if len(standing) == frames else standing
    speed = sparse.diags_array(stiffness.root_speed + stiffness.root_hold * (1 - standing))
    root = step.T @ speed @ step + (stiffness.root_bend * fps) ** 2 * smooth + closed[1] * gap
    # A root whose correction costs too much stays; else a tiny cost fixes what has no influence: where all of it is.
    root = root + (TINY if free_root else 1 / TINY) * unit
    measure = unit if len(weight) == frames else step
    equations = [measure.T @ sparse.diags_array(w) @ measure for w in weight.T]
    blocks: list[list] = [[root + sum(equations), *equations]]
    for f, equation in enumerate(equations):
        own = equation + (unit / TINY if stiff[f] else leg)
        blocks.append([equation, *([None] * f), own, *([None] * (len(equations) - f - 1))])
    sides = [measure.T @ (w * e) for w, e in zip(weight.T, error.T, strict=True)]
    side = np.concatenate([np.sum(sides, axis=0), *sides])
    return factor(sparse.csr_array(sparse.block_array(blocks))).solve(side).reshape(-1, frames)


LONGEST = 0.995
"""Largest distance of hip and ankle over the length of the leg, unless it was larger before."""
STRAIGHT = (0.02, 0.08)
"""Distance of the knee from the line of hip and ankle (thigh lengths): below the first the leg counts as straight and
bends to the front of the thigh, from the second on it bends where it does already."""


def move_ankle(
    rotation: Float[np.ndarray, "T J 3 3"],
    positions: Float[np.ndarray, "T J 3"],
    leg: tuple[int, ...],
    offset: Float[np.ndarray, "T 3"],
    parents: tuple[int, ...],
    bend: float = 1.0,
) -> Float[np.ndarray, "T J 3 3"]:
    """Turn thigh and shin so that the ankle moves by `offset`, as far as the leg reaches.

    The foot keeps its world rotation, and the knee stays in the plane of the leg, which turns with the line from hip to
    ankle.

    Args:
        rotation: world rotation of all joints; z axes point to the front.
        positions: their positions.
        leg: hip, knee and ankle.
        offset: displacement of the ankle.
        parents: parent of each joint.
        bend: -1 for elbows, which bend to the back.

    Returns:
        World rotations of all joints.
    """
    hip, knee, ankle = leg
    thigh, shin = positions[:, knee] - positions[:, hip], positions[:, ankle] - positions[:, knee]
    upper, lower = _length(thigh), _length(shin)
    before, after = thigh + shin, thigh + shin + offset
    shortest = np.abs(upper - lower) + 1e-3 * upper
    distance = np.clip(_length(after), shortest, longest_reach(positions, leg))
    swing = rotations_between(before, after)
    line, sideways = unit_vectors(before), _knee_direction(thigh, before, bend * rotation[:, hip, :, 2])
    # Law of cosines: where the knee is along the line from hip to ankle, and how far from it.
    along = (distance**2 + upper**2 - lower**2) / (2 * distance)
    across = np.sqrt(np.maximum(upper**2 - along**2, 0))
    new_thigh = _turn(swing, along * line + across * sideways)
    new_shin = _turn(swing, distance * line) - new_thigh
    thigh_turn = rotations_between(_turn(swing, thigh), new_thigh) @ swing
    shin_turn = rotations_between(_turn(swing, shin), new_shin) @ swing
    turned = rotation.copy()
    below_hip, below_knee, foot = (descendants([joint], parents) for joint in leg)
    turned[:, below_hip] = thigh_turn[:, None] @ rotation[:, below_hip]
    turned[:, below_knee] = shin_turn[:, None] @ rotation[:, below_knee]
    turned[:, foot] = rotation[:, foot]
    return turned


def longest_reach(positions: Float[np.ndarray, "T J 3"], leg: tuple[int, ...]) -> Float[np.ndarray, "T 1"]:
    """Return the largest distance of hip and ankle that is allowed: almost straight, or as straight as the leg is."""
    hip, knee, ankle = (positions[:, j] for j in leg)
    return np.maximum(LONGEST * (_length(knee - hip) + _length(ankle - knee)), _length(ankle - hip))


def _knee_direction(
    thigh: Float[np.ndarray, "T 3"], line: Float[np.ndarray, "T 3"], front: Float[np.ndarray, "T 3"]
) -> Float[np.ndarray, "T 3"]:
    """Return the direction, perpendicular to the line from hip to ankle, in which the knee is or should be."""
    axis = unit_vectors(line)
    bend = thigh - (thigh * axis).sum(axis=-1, keepdims=True) * axis
    front = unit_vectors(front - (front * axis).sum(axis=-1, keepdims=True) * axis)
    size = _length(bend)
    bent = smooth_step(size / _length(thigh), STRAIGHT)
    mixed = bent * bend / np.maximum(size, 1e-12) + (1 - bent) * front
    # A knee bent exactly to the back would cancel out half-way: it keeps its side.
    return np.where(_length(mixed) > 1e-3, unit_vectors(mixed), front)


def _turn(rotation: Float[np.ndarray, "T 3 3"], vectors: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    return (rotation @ vectors[..., None])[..., 0]


def _length(vectors: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 1"]:
    return np.linalg.norm(vectors, axis=-1, keepdims=True)
