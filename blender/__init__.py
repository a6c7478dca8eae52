# SPDX-License-Identifier: GPL-3.0-or-later
"""mimesh in Blender: transfers the pose or motion of one object to another, rigs a mesh, captures joints.

`panel.py` shows the properties of `properties.py`; `operator.py` reads the scene (`reading.py`, `bones.py`), runs
mimesh in a thread (`job.py`) and builds the result: on the identity's own armature (`own_armature.py`), on a copy or
for captured joints (`building.py`, `animating.py`), or empties for joints that the user can correct (`joints.py`).
mimesh itself is a wheel in the extension, imported when first used.
"""

import bpy

from .operator import (
    MIMESH_OT_animate,
    MIMESH_OT_capture,
    MIMESH_OT_clear_joints,
    MIMESH_OT_pose,
    MIMESH_OT_rig,
    MIMESH_OT_show_joints,
)
from .panel import MIMESH_PT_axes, MIMESH_PT_joints, MIMESH_PT_main, MIMESH_PT_motion, MIMESH_PT_rig
from .properties import MimeshProgress, MimeshSettings

CLASSES = (
    MimeshSettings,
    MimeshProgress,
    MIMESH_OT_animate,
    MIMESH_OT_pose,
    MIMESH_OT_rig,
    MIMESH_OT_capture,
    MIMESH_OT_show_joints,
    MIMESH_OT_clear_joints,
    MIMESH_PT_main,
    MIMESH_PT_joints,
    MIMESH_PT_motion,
    MIMESH_PT_rig,
    MIMESH_PT_axes,
)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.mimesh = bpy.props.PointerProperty(type=MimeshSettings)
    bpy.types.WindowManager.mimesh = bpy.props.PointerProperty(type=MimeshProgress)


def unregister() -> None:
    del bpy.types.WindowManager.mimesh
    del bpy.types.Scene.mimesh
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
