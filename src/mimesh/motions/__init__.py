"""Motions: clips of joint rotations, shipped and procedural, BVH files, and putting them on a body."""

from .clips import DEMO, load_motion, motion_names, pose_bank
from .motion import Motion, mirror, motion_clip, resample, window

__all__ = ["DEMO", "Motion", "load_motion", "mirror", "motion_clip", "motion_names", "pose_bank", "resample", "window"]
