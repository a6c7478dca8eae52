"""Poses of the shipped quadruped: ranges of its joints.

Triples of degrees are rotation vectors from standing, about the axis to the animal's left, up, and to the front:
positive ones about the first turn what hangs down backwards, and what points forwards down.
"""

from __future__ import annotations

from .sampling import Range, mirror_ranges

Ranges = dict[str, tuple[Range, Range, Range]]

_CENTRE: Ranges = {
    "Hips": ((-40, 25), (0, 0), (-12, 12)),
    **{f"Spine{i}": ((-10, 10), (-10, 10), (-6, 6)) for i in range(1, 5)},
    "Chest": ((-10, 15), (-12, 12), (-6, 6)),
    "Neck1": ((-35, 60), (-35, 35), (-12, 12)),
    "Neck2": ((-20, 30), (-25, 25), (-10, 10)),
    "Neck3": ((-20, 25), (-25, 25), (-15, 15)),
    "Head": ((-35, 35), (-35, 35), (-20, 20)),
    "Jaw": ((-5, 35), (0, 0), (0, 0)),
    "Tail1": ((-60, 70), (-40, 40), (0, 0)),
    **{f"Tail{i}": ((-30, 30), (-35, 35), (0, 0)) for i in range(2, 7)},
}
_LEFT: Ranges = {
    "Ear": ((-30, 30), (-30, 30), (-40, 40)),
    "Scapula": ((-20, 20), (-4, 4), (-6, 6)),
    "UpperArm": ((-45, 50), (-8, 8), (-10, 20)),
    "Forearm": ((-130, 12), (-8, 8), (-5, 5)),
    "Hand": ((-12, 90), (-8, 8), (-8, 8)),
    "Fingers": ((-35, 60), (0, 0), (0, 0)),
    "Thigh": ((-70, 45), (-15, 15), (-12, 30)),
    "Shin": ((-25, 118), (-6, 6), (-4, 4)),
    "Foot": ((-85, 30), (-6, 6), (-6, 6)),
    "Toes": ((-35, 60), (0, 0), (0, 0)),
}
_USUAL_CENTRE: Ranges = {
    "Hips": ((-3, 3), (-2, 2), (-2, 2)),
    **{f"Spine{i}": ((-2, 2), (-3, 3), (-2, 2)) for i in range(1, 5)},
    "Neck1": ((-15, 30), (-15, 15), (-4, 4)),
    "Neck2": ((-8, 15), (-10, 10), (-4, 4)),
    "Head": ((-15, 15), (-15, 15), (-8, 8)),
    "Jaw": ((-2, 15), (0, 0), (0, 0)),
    "Tail1": ((-30, 40), (-20, 20), (0, 0)),
    **{f"Tail{i}": ((-12, 12), (-15, 15), (0, 0)) for i in range(2, 7)},
}
_USUAL_LEFT: Ranges = {
    "Ear": ((-10, 10), (-10, 10), (-15, 15)),
    "Scapula": ((-8, 8), (-2, 2), (-2, 2)),
    "UpperArm": ((-25, 25), (-4, 4), (-4, 6)),
    "Forearm": ((-60, 0), (-2, 2), (-2, 2)),
    "Hand": ((0, 50), (-4, 4), (-4, 4)),
    "Fingers": ((-15, 30), (0, 0), (0, 0)),
    "Thigh": ((-30, 25), (-4, 4), (-4, 8)),
    "Shin": ((0, 50), (-2, 2), (-2, 2)),
    "Foot": ((-40, 5), (-2, 2), (-2, 2)),
    "Toes": ((-15, 30), (0, 0), (0, 0)),
}


def _both_sides(centre: Ranges, left: Ranges) -> Ranges:
    return {
        **centre,
        **{f"Left{bone}": ranges for bone, ranges in left.items()},
        **{f"Right{bone}": mirror_ranges(ranges) for bone, ranges in left.items()},
    }


LIMITS: Ranges = _both_sides(_CENTRE, _LEFT)
"""Approximate ranges of the joints of quadrupeds."""
USUAL: Ranges = _both_sides(_USUAL_CENTRE, _USUAL_LEFT)
"""Ranges of everyday poses on four feet: what Table 6 of the NPT paper is for people."""
LOWERED_HEAD = {"Neck1": 40.0, "Neck2": 20.0, "Head": -20.0}
"""First angle of joints (degrees) in which animals are modelled too: a share of this, from the head up to it down."""
