"""Open a network that `mimesh export` wrote: its metadata (key "mimesh", JSON) name the kind of model."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from ..bodies.character_limbs import SIDES
from ..core.errors import InputError
from ..core.system import refuse_pipe
from ..mime.hands import FingerNetwork, HandFinder
from ..mime.model import Mime
from .base import Method
from .onnx_metadata import read_metadata
from .onnx_runtime import import_onnxruntime, open_session

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

HANDS = "hands.onnx"
"""File of the network of hands, which mime uses beside its own."""
FINDER_JOINTS = {f"{side}{part}" for side in SIDES for part in ("Hand", "ForeArm")}
"""Joints of the body that hands are found by."""


def load_network(
    path: Path, *, name: str, ensemble: int = 1, seed: int = 0, fits: bool = True, fingers: bool = True
) -> Mime | Method:
    """Open an ONNX file written by `mimesh export`.

    Args:
        path: the .onnx file.
        name: of the method in messages and reports.
        ensemble: see `find_model`.
        seed: see `find_model`.
        fits: whether mime fits a body to the meshes, starting from its predictions (see `mime/body_fit.py`).
        fingers: whether mime moves the fingers of hands that show them (see `mime/hands.py`).

    Raises:
        InputError: no such file, not an ONNX network, or one without valid metadata.
    """
    refuse_pipe(path)
    if not path.is_file():
        raise InputError(f"{path}: expected the weights of model {name}, found no file; choose another model or path")
    session = _open_session(path)
    card = read_metadata(session, path)
    body, pairing = card.get("body", "human"), card.get("pairing", "random")
    if card["model"] == "aniformer":
        from .aniformer import AniFormerMethod

        facts = (card["frames"], card["head"], card["target_scale"])
        return AniFormerMethod(name, session, *facts, ensemble, seed, card.get("vertices", 0), body, pairing)
    if card["model"] == "hands":
        raise InputError(f"{path}: expected a model that moves meshes, found the network of hands; mime uses it itself")
    if card["model"] == "mime":
        joints, parents, legs = tuple(card["joints"]), tuple(card["parents"]), tuple(map(tuple, card["legs"]))
        hands = load_hand_finder(joints, seed) if fingers else None
        return Mime(name, session, joints, parents, legs, card["points"], body, fits, seed, hands=hands)
    from .npt import NPTMethod

    # A network that pools the pose pairs nothing, however it was trained.
    pairing = pairing if card["pose_code"] == "per_vertex" else "random"
    return NPTMethod(name, session, card["pose_code"], card["target_scale"], ensemble, seed, body, pairing)


def hands_path() -> Path:
    """Return the path of the shipped network of hands."""
    return Path(str(resources.files("mimesh.methods") / "zoo" / HANDS))


def load_hand_finder(joints: tuple[str, ...], seed: int = 0) -> HandFinder | None:
    """Open the shipped network of hands; None where it is not installed, or the body lacks joints that are needed.

    Args:
        joints: of the body.
        seed: see `find_model`.
    """
    path = hands_path()
    if not path.is_file() or not FINDER_JOINTS.issubset(joints):
        return None
    session = _open_session(path)
    return HandFinder(FingerNetwork(session, read_metadata(session, path)["points"]), joints, seed)


def _open_session(path: Path) -> InferenceSession:
    library = vars(import_onnxruntime().capi.onnxruntime_pybind11_state).values()
    errors = [kind for kind in library if isinstance(kind, type) and issubclass(kind, Exception)]
    try:
        return open_session(path)
    except (*errors, UnicodeDecodeError):  # the library's message may quote bytes of the file
        raise InputError(
            f"{path}: expected a network in ONNX format, found something else; write one with mimesh export"
        ) from None
