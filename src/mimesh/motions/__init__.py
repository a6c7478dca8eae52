"""Motions (joint rotations over time): shipped, read from files or generated from a seed, and applied to a body.

Readers of files are imported where files are read.
"""

from .clips import DEMO, load_motion, motion_names, pose_bank
from .motion import Motion, mirror, motion_clip, resample, window

__all__ = ["DEMO", "Motion", "load_motion", "mirror", "motion_clip", "motion_names", "pose_bank", "resample", "window"]
