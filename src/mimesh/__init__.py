"""Give a mesh the pose or the motion of another mesh.

    result = mimesh.transfer("hero.glb", "pose.obj")  # a pose; result.save("hero-pose.glb")
    moving = mimesh.animate("hero.glb", "walk.bvh")   # a motion; moving.save_skinned("hero-walk.glb")

rig                     give a mesh a skeleton and skinning weights; gives a RiggedMesh
capture                 read the motion of joints out of a clip; gives a CapturedClip
retarget                let a RiggedMesh move as a CapturedClip; gives a ClipResult
transfer, animate       move a mesh (Mesh or path) by a pose or a clip; give a Result or a ClipResult
save_skinned            write several motions of one mesh into one file; gives a SavedClip
batch                   many meshes by many clips, resumable
prepare, LiveSession    pose a mesh frame by frame
load_mesh, load_clip, save_mesh, save_clip, Mesh, Clip    files and arrays
Hints, ModelOptions, MotionOptions, FrameRange            what is known, and what is wanted
Layout                  bone names, root bone, rest pose and frame rate of files for engines
InputError, no_limits   what is wrong with an input; larger files than usual

Names are loaded when first used, so that `import mimesh` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .core.budgets import no_limits
    from .core.errors import InputError
    from .core.mesh import Clip, Mesh
    from .core.options import FrameRange, Hints, Layout, ModelOptions, MotionOptions
    from .io import load_clip, load_mesh, save_clip, save_mesh
    from .jobs.run import batch
    from .pipeline import animate, prepare, transfer
    from .pipeline.capturing import CapturedClip, capture, retarget
    from .pipeline.live import LiveSession
    from .pipeline.report import SavedClip
    from .pipeline.result import ClipResult, Result
    from .pipeline.rigging import RiggedMesh, rig
    from .pipeline.skinned import save_skinned

__version__ = "0.2.0"
__all__ = [
    "CapturedClip",
    "Clip",
    "ClipResult",
    "FrameRange",
    "Hints",
    "InputError",
    "Layout",
    "LiveSession",
    "Mesh",
    "ModelOptions",
    "MotionOptions",
    "Result",
    "RiggedMesh",
    "SavedClip",
    "animate",
    "batch",
    "capture",
    "load_clip",
    "load_mesh",
    "no_limits",
    "prepare",
    "retarget",
    "rig",
    "save_clip",
    "save_mesh",
    "save_skinned",
    "transfer",
]

_MODULES = {
    "core.budgets": ("no_limits",),
    "core.errors": ("InputError",),
    "core.mesh": ("Clip", "Mesh"),
    "core.options": ("FrameRange", "Hints", "Layout", "ModelOptions", "MotionOptions"),
    "jobs.run": ("batch",),
    "io": ("load_clip", "load_mesh", "save_clip", "save_mesh"),
    "pipeline": ("animate", "prepare", "transfer"),
    "pipeline.capturing": ("CapturedClip", "capture", "retarget"),
    "pipeline.live": ("LiveSession",),
    "pipeline.report": ("SavedClip",),
    "pipeline.result": ("ClipResult", "Result"),
    "pipeline.rigging": ("RiggedMesh", "rig"),
    "pipeline.skinned": ("save_skinned",),
}


def __getattr__(name: str) -> object:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f".{module}", __name__), name)
    hint = importlib.import_module(".core.errors", __name__).did_you_mean(name, __all__)
    raise AttributeError(f"module 'mimesh' has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
