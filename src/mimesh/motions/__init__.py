"""Motions: clips of joint rotations, shipped, read from files or made up from a seed, and putting them on a body."""

from .bvh import load_bvh
from .clips import DEMO, load_motion, motion_names, pose_bank
from .deepmimic import load_deepmimic
from .motion import Motion, mirror, motion_clip, resample, window
from .procedural import spline_motion, walk_motion
from .retarget import retarget

__all__ = [
    "DEMO",
    "Motion",
    "load_bvh",
    "load_deepmimic",
    "load_motion",
    "mirror",
    "motion_clip",
    "motion_names",
    "pose_bank",
    "resample",
    "retarget",
    "spline_motion",
    "walk_motion",
    "window",
]
