"""Skeletons whose rest pose is no pose: how their joints lie on ours, measured from where the joints go in the motion.

M_j is constant, so every frame tells it: where the joints are says how our joint would be turned, D_j(t), and
M_j is the rotation nearest to the sum of G_j(t)^T D_j(t). Knees and elbows are hinges, and how they bend tells how
thigh and shin, upper arm and forearm are rolled; little-bent ones count little. The trunk looks where hips and
shoulders say, hands follow their forearms, and a head is level and looks ahead on average.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..core.geometry import nearest_rotation, rotate_between, unit_vectors

MEASURED = 400
"""Frames that are looked at, at most."""
UNBENT = 0.01
"""Weight of the roll that a limb has when it goes the shortest way from the T-pose; a right-angled hinge counts 1."""
HINGES = (("UpLeg", "Leg", "Foot", (0.0, 0.0, -1.0)), ("Arm", "ForeArm", "Hand", (0.0, 0.5, 0.866)))
"""Two bones, the end of the second one, and which way it goes from the T-pose when the hinge bends.

Palms of our T-pose look down, so elbows bend to the front and up: 30 degrees, as in the shipped takes.
"""
LEAN = (0.0, 0.97, 0.22)
"""Way from hips to shoulders in the frame of the hips of who stands upright (mean of the shipped takes)."""
UPRIGHT = 16
"""Power of the cosine between trunk and legs by which a frame counts for the hips: bent trunks say little."""


def axes_from_motion(place: Float[np.ndarray, "T J 3"], index: dict[str, int]) -> Float[np.ndarray, "3 3"]:
    """Axis rotation that takes the world of a motion to y up: shoulders are above feet most of the time.

    The heading stays as it is, along one of the axes.
    """
    above = _middle(place, index, "Arm") - _middle(place, index, "Foot")
    mean = unit_vectors(above).mean(axis=0)
    up = np.zeros(3)
    largest = int(np.abs(mean).argmax())
    up[largest] = np.sign(mean[largest])
    return np.round(turn_between(up, np.array([0.0, 1.0, 0.0])))


def measured(
    rotation: Float[np.ndarray, "T J 3 3"],
    place: Float[np.ndarray, "T J 3"],
    rest: Float[np.ndarray, "J 3"],
    index: dict[str, int],
    body: RiggedBody,
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """M_j of each of our joints in `index`, from world rotations and positions with y up.

    Limb bones, given by `rest` in the frames of the source's joints, are matched exactly.
    """
    some = slice(None, None, max(len(place) // MEASURED, 1))
    rotation, place = rotation[some], place[some]
    ours = body.joints[None]
    own = {joint: body.joint(joint) for joint in index}
    turns = _trunk_turns(place, index, ours, own)
    for side in ("Left", "Right"):
        for upper, lower, end, way in HINGES:
            turns |= _hinge_turns(place, index, ours, own, (f"{side}{upper}", f"{side}{lower}", f"{side}{end}"), way,
                                  turns["Hips" if upper == "UpLeg" else "Spine1"][0])  # fmt: skip
        turns[f"{side}Hand"] = turns[f"{side}ForeArm"]
        turns |= _foot_turns(place, index, ours, own, side, turns[f"{side}Leg"])
    between = {}
    for joint, j in index.items():
        turn, weight = turns.get(joint, turns["Spine1"])
        between[joint] = nearest_rotation((weight[:, None, None] * np.swapaxes(rotation[:, j], -1, -2) @ turn).sum(0))
    return {joint: _exact(joint, found, rest, index, ours[0], own) for joint, found in between.items()}


def turn_between(old: Float[np.ndarray, " 3"], new: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Smallest rotation matrix that turns direction `old` to `new`."""
    return turns_between(old, new[None])[0]


def turns_between(old: Float[np.ndarray, " 3"], new: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3 3"]:
    """Smallest rotations that turn direction `old` to each of the directions `new`."""
    olds, news = np.tile(old / np.linalg.norm(old), (3 * len(new), 1)), np.repeat(unit_vectors(new), 3, axis=0)
    turned = rotate_between(olds, news, np.tile(np.eye(3), (len(new), 1)))
    return np.swapaxes(turned.reshape(-1, 3, 3), -1, -2)


def _middle(place, index, part):
    return (place[:, index[f"Left{part}"]] + place[:, index[f"Right{part}"]]) / 2


def _seen(first, second):
    """Frames (T, 3, 3) whose first column goes along a vector and whose second lies in the plane of both."""
    one = unit_vectors(first)
    two = unit_vectors(second - (second * one).sum(axis=-1, keepdims=True) * one)
    return np.stack([one, two, np.cross(one, two)], axis=-1)


def _turned(ours, theirs):
    """Rotations that take the frame of two vectors of ours to that of theirs."""
    return _seen(*theirs) @ np.swapaxes(_seen(*ours), -1, -2)


def _trunk_turns(place, index, ours, own):
    """How hips, chest and head are turned in each frame, and how much it counts; other joints go with the chest."""
    across, trunk = {}, {}
    for points, names in ((ours, own), (place, index)):
        mine = points is ours
        across[mine] = {part: np.subtract(*(points[:, names[f"{side}{part}"]] for side in ("Left", "Right")))
                        for part in ("UpLeg", "Arm")}  # fmt: skip
        trunk[mine] = _middle(points, names, "Arm") - _middle(points, names, "UpLeg")
    legs = _middle(place, index, "UpLeg") - _middle(place, index, "Foot")
    cosine = (unit_vectors(trunk[False]) * unit_vectors(legs)).sum(axis=-1)
    upright, always = np.maximum(cosine, UNBENT) ** UPRIGHT, np.ones(len(place))
    above = np.array([[0.0, 1.0, 0.0]])
    hips = _turned((across[True]["UpLeg"], np.array([LEAN])), (across[False]["UpLeg"], trunk[False]))
    chest = _turned((across[True]["Arm"], trunk[True]), (across[False]["Arm"], trunk[False]))
    head = _turned((above, across[True]["Arm"]), (np.tile(above, (len(place), 1)), across[False]["Arm"]))
    return {"Hips": (hips, upright), "Spine1": (chest, always), "Head": (head, upright)}


def _hinge_turns(place, index, ours, own, chain, way, trunk):
    """How the two bones beside a knee or an elbow are turned, and how much each frame counts."""
    top, hinge, end = chain
    (first, second), (one, two) = (
        (points[:, names[hinge]] - points[:, names[top]], points[:, names[end]] - points[:, names[hinge]])
        for points, names in ((ours, own), (place, index))
    )
    bend = np.square(np.linalg.norm(np.cross(unit_vectors(one), unit_vectors(two)), axis=-1))
    front = np.array([way])
    found = {}
    for joint, bone, rest, other, hint in ((top, one, first, two, front), (hinge, two, second, one, -front)):
        bent = _turned((rest, hint), (bone, other))
        straight = trunk @ turns_between(rest[0], (np.swapaxes(trunk, -1, -2) @ bone[..., None])[..., 0])
        # Both are one rotation in the end; mixing them frame by frame keeps the weights with their frames.
        mixed = nearest_rotation(bend[:, None, None] * bent + UNBENT * straight)
        found[joint] = (mixed, bend + UNBENT)
    return found


def _foot_turns(place, index, ours, own, side, shin):
    """How foot and toes are turned: the foot's bone and the shin's; as the shin where there are no toes."""
    foot, toes, knee = f"{side}Foot", f"{side}ToeBase", f"{side}Leg"
    if toes not in index:
        return {foot: shin}
    pairs = [
        (points[:, names[toes]] - points[:, names[foot]], points[:, names[knee]] - points[:, names[foot]])
        for points, names in ((ours, own), (place, index))
    ]
    turn = (_turned(*pairs), np.ones(len(place)))
    return {foot: turn, toes: turn}


def _exact(joint, found, rest, index, ours, own):
    """Turn M_j the smallest way so that the limb bone of this joint lies on the source's."""
    tails = {f"{s}{a}": f"{s}{b}" for s in ("Left", "Right") for h in HINGES for a, b in (h[:2], h[1:3])}
    if joint not in tails:
        return found
    bone = ours[own[tails[joint]]] - ours[own[joint]]
    return turn_between(found @ bone, rest[index[tails[joint]]] - rest[index[joint]]) @ found
