"""Open a network that `mimesh export` wrote: its metadata (key "mimesh", JSON) name the kind of model."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bodies.character_limbs import SIDES
from ..core.errors import InputError
from .aniformer import AniFormerMethod
from .base import Method
from .limp import LIMPMethod
from .mime.drive import MimeMethod
from .mime.hand_network import FingerNetwork
from .mime.hands import HandFinder
from .npt import NPTMethod
from .onnx_runtime import import_onnxruntime, open_session

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

METADATA = {
    "npt": {"pose_code": ("per_vertex", "global_max"), "target_scale": ("identity", "truth")},
    "aniformer": {"head": ("frames", "regression"), "target_scale": ("identity", "truth")},
    "limp": {"target_scale": ("identity", "truth")},
    "mime": {},
    "hands": {},
}
"""Model -> keys of its metadata, with the values that are allowed."""
HANDS = "hands.onnx"
"""File of the network of hands, which mime uses beside its own."""
FINDER_JOINTS = {f"{side}{part}" for side in SIDES for part in ("Hand", "ForeArm")}
"""Joints of the body that hands are found by."""
MIME_KEYS = ("joints", "parents", "legs", "points")
"""Further keys for mime, with any value."""
MAX_WINDOW = 64
"""Largest number of driving frames in a window of aniformer."""


def load_network(
    path: Path,
    *,
    name: str,
    ensemble: int = 1,
    seed: int = 0,
    fits: bool = True,
    fingers: bool = True,
) -> Method:
    """Open an ONNX file written by `mimesh export`.

    Args:
        path: the .onnx file.
        name: of the method in messages and reports.
        ensemble: see `find_method`.
        seed: see `find_method`.
        fits: whether mime fits a body to the meshes, starting from its predictions (see `mime/body_fit.py`).
        fingers: whether mime moves the fingers of hands that show them (see `mime/hands.py`).

    Raises:
        InputError: no such file, not an ONNX network, or one without valid metadata.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected the weights of model {name}, found no file; choose another model or path")
    session = _open_session(path)
    card = _metadata(session, path)
    body = card.get("body", "human")
    if card["model"] == "aniformer":
        facts = (card["frames"], card["head"], card["target_scale"])
        return AniFormerMethod(name, session, *facts, ensemble, seed, card.get("vertices", 0), body)
    if card["model"] == "limp":
        return LIMPMethod(name, session, card["vertices"], card["target_scale"])
    if card["model"] == "hands":
        raise InputError(f"{path}: expected a model that moves meshes, found the network of hands; mime uses it itself")
    if card["model"] == "mime":
        joints, parents, legs = tuple(card["joints"]), tuple(card["parents"]), tuple(map(tuple, card["legs"]))
        hands = load_hand_finder(joints, seed) if fingers else None
        return MimeMethod(name, session, joints, parents, legs, card["points"], body, fits, seed, hands=hands)
    return NPTMethod(name, session, card["pose_code"], card["target_scale"], ensemble, seed, body)


def hands_path() -> Path:
    """Return the path of the shipped network of hands."""
    return Path(str(resources.files("mimesh") / "zoo" / HANDS))


def load_hand_finder(joints: tuple[str, ...], seed: int = 0) -> HandFinder | None:
    """Open the shipped network of hands; None where it is not installed, or the body lacks joints that are needed.

    Args:
        joints: of the body.
        seed: see `find_method`.
    """
    path = hands_path()
    if not path.is_file() or not FINDER_JOINTS.issubset(joints):
        return None
    session = _open_session(path)
    return HandFinder(FingerNetwork(session, _metadata(session, path)["points"]), joints, seed)


def _open_session(path: Path) -> InferenceSession:
    """Open a file with onnxruntime on the CPU, or raise InputError if it cannot be read."""
    errors = import_onnxruntime().capi.onnxruntime_pybind11_state
    try:
        return open_session(path)
    except (errors.Fail, errors.InvalidProtobuf, errors.InvalidGraph, errors.InvalidArgument, errors.NotImplemented):
        raise InputError(
            f"{path}: expected a network in ONNX format, found something else; write one with mimesh export"
        ) from None


def _metadata(session: InferenceSession, path: Path) -> dict[str, Any]:
    """Return the metadata of a network, checked."""
    text = session.get_modelmeta().custom_metadata_map.get("mimesh")
    if text is None:
        raise InputError(f"{path}: expected a network of mimesh, found no such metadata; write one with mimesh export")
    card = json.loads(text)
    _check(card, "model", tuple(METADATA), path)
    for key, allowed in METADATA[card["model"]].items():
        _check(card, key, allowed, path)
    if card["model"] == "aniformer":
        _check(card, "frames", tuple(range(1, MAX_WINDOW + 1)), path)
    missing = [key for key in MIME_KEYS if card["model"] == "mime" and key not in card]
    if missing:
        raise InputError(
            f"{path}: expected {missing[0]} in its metadata, found none; export it again with this version"
        )
    return card


def _check(card: dict[str, Any], key: str, allowed: tuple, path: Path) -> None:
    """Raise InputError if a value of the metadata is not one of those allowed."""
    if card.get(key) not in allowed:
        expected = " or ".join(allowed) if isinstance(allowed[0], str) else f"{allowed[0]} to {allowed[-1]}"
        raise InputError(
            f"{path}: expected {key} {expected} in its metadata, found {card.get(key)!r}; "
            "export it again with this version"
        )
