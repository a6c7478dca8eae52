"""Checks of `mimesh doctor`: whether everything that a transfer needs works on this computer."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

REQUIRED = (
    "numpy",
    "scipy",
    "onnxruntime",
    "pillow",
    "typer",
    "rich",
    "jaxtyping",
    "fast-simplification",
    "threadpoolctl",
)
EXTRAS = {
    "fbx": (("ufbx",), "to read FBX"),
    "compressed": (("DracoPy", "meshopt"), "for Draco and meshopt glTF"),
    "usd": (("usd-core",), "for USD"),
    "video": (("av",), "for MP4"),
    "viewer": (("starlette", "uvicorn"), "for the studio"),
    "train": (("torch", "onnx", "safetensors"), "for training"),
}
"""Extra -> its packages, and what they are for."""


@dataclass(frozen=True)
class Check:
    """Result of one check."""

    name: str
    ok: bool
    found: str
    """Version, count or error, for the user."""
    optional: bool = False
    """Whether it is missing, and only some formats or commands need it."""


def examine() -> list[Check]:
    """Run all checks; after a failed one the others still run."""
    from .. import __version__

    checks = [Check("mimesh", True, f"{__version__}, Python {platform.python_version()}, {platform.platform()}")]
    checks += [_version(package) for package in REQUIRED]
    checks += [
        _version(package, extra, purpose) for extra, (packages, purpose) in EXTRAS.items() for package in packages
    ]
    checks.append(_blender())
    checks.append(
        Check("threads", True, f"{os.cpu_count()} cores, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')}")
    )
    probes: dict[str, Callable[[], str]] = {
        "shipped body": _body,
        "shipped motions": _motions,
        "shipped networks": _networks,
        "this folder": _writable,
        "self check": _transfer,
    }
    for name, probe in probes.items():
        try:
            checks.append(Check(name, True, probe()))
        except Exception as error:  # any error is the result of the check, and is shown to the user
            checks.append(Check(name, False, f"{type(error).__name__}: {error}"))
    return checks


def _version(package: str, extra: str | None = None, purpose: str = "") -> Check:
    """Look up the version of a package; one of an extra may be missing."""
    try:
        return Check(package, True, metadata.version(package))
    except metadata.PackageNotFoundError:
        if extra is None:
            return Check(package, False, "missing")
        return Check(package, True, f"not installed (pip install 'mimesh[{extra}]' {purpose})", optional=True)


def _blender() -> Check:
    from ..core.errors import InputError
    from ..io.fbx.write import PACKAGE, VARIABLE, find_blender

    try:
        return Check("blender", True, find_blender(Path("result.fbx"))[0])
    except InputError:
        if os.environ.get(VARIABLE):
            found = f"not found at {VARIABLE}={os.environ[VARIABLE]} (correct it to write FBX)"
        else:
            found = f"not installed (pip install {PACKAGE}, or the program, to write FBX)"
        return Check("blender", True, found, optional=True)


def _body() -> str:
    from ..bodies import load_body

    body = load_body()
    return f"{body.name}: {len(body.vertices)} vertices, {len(body.joint_names)} joints"


def _motions() -> str:
    from ..motions import load_motion, motion_names

    names = motion_names()
    frames = sum(len(load_motion(name).root) for name in names)
    return f"{len(names)} clips, {frames} frames"


def _networks() -> str:
    from ..methods.find import NETWORK_OF_BODY, SHIPPED_NETWORKS, find_model

    names = dict.fromkeys((*NETWORK_OF_BODY.values(), *SHIPPED_NETWORKS))
    return ", ".join(find_model(name).name for name in names)


def _writable() -> str:
    from ..io.atomic import scratch_folder

    with scratch_folder(Path.cwd()):
        return f"{Path.cwd()} can be written to"


def _transfer() -> str:
    """Transfer a pose between two files with the shipped network, and compare the file that is written."""
    import numpy as np

    from ..bodies import load_body
    from ..bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
    from ..io import load_mesh, save_mesh
    from ..io.atomic import scratch_folder
    from ..pipeline import transfer

    body = load_body()
    posed = body.posed(sample_shape(body, 0, 0), rotvec_to_rotmat(sample_pose(body, 0, 0)))
    with scratch_folder() as folder:
        paths = [folder / f"{name}.obj" for name in ("identity", "driving", "result")]
        save_mesh(body.mesh(), paths[0])
        save_mesh(body.mesh(posed), paths[1])
        result = transfer(paths[0], paths[1])
        result.save(paths[2])
        written = load_mesh(paths[2])
    if not np.allclose(written.vertices, result.vertices, atol=1e-5):
        raise AssertionError("the written result differs from the computed one")
    return f"one person moved by {result.model} in {sum(result.seconds.values()):.1f} s"
