"""What the page calls the options of mimesh, in messages."""

from __future__ import annotations

FIELDS = {
    "model": "the model",
    "names": "bone names",
    "rest": "rest pose",
    "root_bone": "root bone",
    "skinned": "bones",
    "rig": "bones",
    "body": "both meshes are",
    "smooth": "smoothing",
    "root": "root motion",
    "ground": "feet on the ground",
    "fps": "frame rate",
    "output_fps": "frame rate",
    "driving_up": "up of the driving",
    "driving_front": "front of the driving",
    "license": "licence",
    "driving_part": "part of the driving",
    "influences": "weights per vertex",
    "joints": "corrected joints",
    "driving_joints": "corrected joints of the driving",
}
"""Option -> the field of the page that it is, where that has another name."""
CHOICES = {
    "False": "off",
    "own": "of the file",
    "mimesh": "found on the surface",
    "human": "a person",
    "quadruped": "a four-legged animal",
    "deformation-transfer": "deformation-transfer, of the command mimesh animate alone",
}
"""Value of an option -> what the field of the page calls it."""


def field_name(name: str, value: object = None) -> str:
    """Name an option in a message, with a value to choose, as the page does."""
    known = FIELDS.get(name, name.replace("_", " "))
    return known if value is None or value is ... else f"“{known}: {CHOICES.get(str(value), value)}”"
