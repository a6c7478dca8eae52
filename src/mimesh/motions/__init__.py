"""Motions (joint rotations over time): shipped, read from files or generated from a seed, and applied to a body."""

from .amass import load_amass
from .bvh import load_bvh
from .clips import DEMO, load_motion, motion_names, pose_bank
from .deepmimic import load_deepmimic
from .motion import Motion, mirror, motion_clip, resample, window
from .on_body import motion_file_clip
from .procedural import spline_motion, walk_motion
from .retarget import retarget

__all__ = [
    "DEMO",
    "Motion",
    "load_amass",
    "load_bvh",
    "load_deepmimic",
    "load_motion",
    "mirror",
    "motion_clip",
    "motion_file_clip",
    "motion_names",
    "pose_bank",
    "resample",
    "retarget",
    "spline_motion",
    "walk_motion",
    "window",
]
