"""Open a network that `mimesh export` wrote, of either kind: its metadata (key "mimesh") say which."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import InputError
from .aniformer import AniFormerMethod
from .base import Method
from .limp import LIMPMethod
from .mime.drive import MimeMethod
from .npt import NPTMethod
from .onnx_runtime import import_onnxruntime

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

KNOWN = {
    "npt": {"pose_code": ("per_vertex", "global_max"), "target_scale": ("identity", "truth")},
    "aniformer": {"head": ("frames", "regression"), "target_scale": ("identity", "truth")},
    "limp": {"target_scale": ("identity", "truth")},
    "mime": {},
}
"""What the metadata of each kind say, and what they may say."""
SKELETON = ("joints", "parents", "legs", "points")
"""What those of mime say too."""
LONGEST = 64
"""Most driving frames of a window."""


def load_network(
    path: Path, *, name: str, ensemble: int = 1, seed: int = 0, threads: int = 2, fits: bool = True
) -> Method:
    """Open an ONNX file written by `mimesh export`.

    Args:
        ensemble: see `find_method`.
        fits: whether mime's readings are the start of a fit (see `fitting.py`).

    Raises:
        InputError: no such file, not an ONNX network, or one that does not say it is ours.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected the weights of model {name}, found no file; choose another model or path")
    session = _open_session(path, threads)
    card = _card(session, path)
    if card["model"] == "aniformer":
        return AniFormerMethod(name, session, card["frames"], card["head"], card["target_scale"], ensemble, seed)
    if card["model"] == "limp":
        return LIMPMethod(name, session, card["vertices"], card["target_scale"])
    if card["model"] == "mime":
        joints, parents, legs = tuple(card["joints"]), tuple(card["parents"]), tuple(map(tuple, card["legs"]))
        return MimeMethod(name, session, joints, parents, legs, card["points"], fits, seed)
    return NPTMethod(name, session, card["pose_code"], card["target_scale"], ensemble, seed)


def _open_session(path: Path, threads: int) -> InferenceSession:
    onnxruntime = import_onnxruntime()
    errors = onnxruntime.capi.onnxruntime_pybind11_state
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3  # warnings about graph clean-up are not for users
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except (errors.Fail, errors.InvalidProtobuf, errors.InvalidGraph, errors.InvalidArgument, errors.NotImplemented):
        raise InputError(
            f"{path}: expected a network in ONNX format, found something else; write one with mimesh export"
        ) from None


def _card(session: InferenceSession, path: Path) -> dict[str, Any]:
    """The network's own description, checked."""
    text = session.get_modelmeta().custom_metadata_map.get("mimesh")
    if text is None:
        raise InputError(f"{path}: expected a network of mimesh, found no such metadata; write one with mimesh export")
    card = json.loads(text)
    _check(card, "model", tuple(KNOWN), path)
    for key, known in KNOWN[card["model"]].items():
        _check(card, key, known, path)
    if card["model"] == "aniformer":
        _check(card, "frames", tuple(range(1, LONGEST + 1)), path)
    lacking = [key for key in SKELETON if card["model"] == "mime" and key not in card]
    if lacking:
        raise InputError(
            f"{path}: expected {lacking[0]} in its metadata, found none; export it again with this version"
        )
    return card


def _check(card: dict[str, Any], key: str, known: tuple, path: Path) -> None:
    if card.get(key) not in known:
        wanted = " or ".join(known) if isinstance(known[0], str) else f"{known[0]} to {known[-1]}"
        raise InputError(
            f"{path}: expected {key} {wanted} in its metadata, found {card.get(key)!r}; "
            "export it again with this version"
        )
