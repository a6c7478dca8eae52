"""What shells complete: names of models and values of options."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

VALUES = {
    "root": ("scale", "keep", "drop"),
    "rig": ("own", "mimesh"),
    "body": ("auto", "human", "quadruped", "other"),
    "pairing": ("auto", "random", "order", "body"),
    "names": ("own", "mixamo", "unreal", "vrm", "godot", "rigify"),
    "rest": ("file", "T", "A"),
}
"""Option -> its values. Written again here, because a shell waits while the modules that check them are loaded."""
MODELS = ("mime", "npt", "npt-maxpool", "aniformer", "copy", "deformation-transfer", "skeleton")
"""Names of models that -m takes."""


def one_of(option: str) -> Callable[[str], list[str]]:
    """Return the function that completes a value of an option."""
    return lambda incomplete: [value for value in VALUES[option] if value.startswith(incomplete)]


def models(incomplete: str) -> list[str]:
    """Complete the value of -m: a name, or the path of an .onnx file."""
    folder = Path(incomplete) if incomplete.endswith("/") else Path(incomplete).parent
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        entries = []
    # As the user writes it: "./net.onnx" and "net.onnx" are the same path.
    before = incomplete[: incomplete.rfind("/") + 1]
    paths = [
        before + entry.name + "/" * entry.is_dir() for entry in entries if entry.is_dir() or entry.suffix == ".onnx"
    ]
    hidden = incomplete[len(before) :].startswith(".")
    shown = [path for path in paths if hidden or not path[len(before) :].startswith(".")]
    return [word for word in (*MODELS, *shown) if word.startswith(incomplete)]
