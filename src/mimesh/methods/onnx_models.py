"""Open a network that `mimesh export` wrote: its metadata (key "mimesh", JSON) name the kind of model."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bodies.character_limbs import SIDES
from ..core.errors import InputError
from ..core.system import refuse_pipe
from ..mime.hands import FingerNetwork, HandFinder
from ..mime.model import Mime
from .base import Method
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
    if card["model"] == "hands":
        raise InputError(f"{path}: expected a model that moves meshes, found the network of hands; mime uses it itself")
    if card["model"] == "mime":
        joints, parents, legs = tuple(card["joints"]), tuple(card["parents"]), tuple(map(tuple, card["legs"]))
        hands = load_hand_finder(joints, seed) if fingers else None
        return Mime(session, joints, parents, legs, name, card["points"], body, fits, seed, hands=hands)
    from .npt import AniFormerMethod, NPTMethod

    usual = {"name": name, "session": session, "target_scale": card["target_scale"], "seed": seed, "body": body}
    if card["model"] == "aniformer":
        facts = {key: card[key] for key in ("frames", "head")} | {"vertices": card.get("vertices", 0)}
        return AniFormerMethod(**usual, **facts, ensemble=ensemble, pairing=pairing)
    # A network that pools the pose pairs nothing, however it was trained.
    pairing = pairing if card["pose_code"] == "per_vertex" else "random"
    return NPTMethod(**usual, pose_code=card["pose_code"], ensemble=ensemble, pairing=pairing)


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


KEY = "mimesh"
"""Key of the metadata in the file; the value is JSON."""
CHOICES = {
    "npt": {"pose_code": ("per_vertex", "global_max"), "target_scale": ("identity", "truth", "metres")},
    "aniformer": {"head": ("frames", "regression"), "target_scale": ("identity", "truth")},
    "mime": {},
    "hands": {},
}
"""Model -> keys of its metadata, with the values that are allowed."""
PAIRINGS = ("random", "order")
"""How networks are trained to pair the vertices of two meshes; files without this key: at random."""
MAX_WINDOW = 64
"""Largest number of driving frames in a window of aniformer."""
MAX_VERTICES = 1_000_000
"""Largest number of vertices that aniformer has weights for."""
LARGEST = {"aniformer": {"frames": MAX_WINDOW}, "mime": {"points": 100_000}, "hands": {"points": 100_000}}
"""Model -> keys whose values are whole numbers from 1, with the largest that is allowed."""
INPUTS = {
    **dict.fromkeys(("npt", "aniformer"), ("driving", "identity")),
    **dict.fromkeys(("mime", "hands"), ("normals", "points", "vertex_normals", "vertices")),
}
"""Model -> names of the network's inputs, sorted."""


def read_metadata(session: InferenceSession, path: Path) -> dict[str, Any]:
    """Return the metadata of a network, checked for all that `onnx_models` takes from them.

    Raises:
        InputError: there are none, or they are not those of a model that is known.
    """
    try:
        text = session.get_modelmeta().custom_metadata_map.get(KEY)
        card = None if text is None else json.loads(text)
    except (ValueError, RecursionError) as error:  # bytes that are no text, or text that is no JSON
        raise _error(path, "JSON", error) from error
    if card is None:
        raise InputError(f"{path}: expected a network of mimesh, found no such metadata; write one with mimesh export")
    if not isinstance(card, dict):
        raise _error(path, "an object", card)
    _check_choice(card, "model", tuple(CHOICES), path)
    model = card["model"]
    for key, allowed in CHOICES[model].items():
        _check_choice(card, key, allowed, path)
    for key, largest in LARGEST.get(model, {}).items():
        _check_number(card.get(key), key, 1, largest, path)
    if model == "aniformer":
        _check_number(card.get("vertices", 0), "vertices", 0, MAX_VERTICES, path)
    _check_choice({"pairing": "random"} | card, "pairing", PAIRINGS, path)
    if not isinstance(card.get("body", ""), str):
        raise _error(path, "body to be a name", card["body"])
    if model == "mime":
        _check_joints(card, path)
    _check_network(session, card, path)
    return card


def _check_choice(card: dict[str, Any], key: str, allowed: tuple[str, ...], path: Path) -> None:
    if card.get(key) not in allowed:
        raise _error(path, f"{key} {' or '.join(allowed)}", card.get(key))


def _check_number(value: Any, key: str, least: int, largest: int, path: Path) -> None:
    if type(value) is not int or not least <= value <= largest:  # True is an int for isinstance
        raise InputError(
            f"{path}: expected {key} in its metadata as a whole number from {least} to {largest}, found {value!r:.60}; "
            "export it again with this version"
        )


def _check_joints(card: dict[str, Any], path: Path) -> None:
    """Check names of joints, their parents (a tree, parents first), and the chains of joints of the legs."""
    for key in ("joints", "parents", "legs"):
        if not isinstance(card.get(key), list) or not card[key]:
            raise _error(path, key, card.get(key))
    joints, parents, legs = card["joints"], card["parents"], card["legs"]
    if not all(isinstance(name, str) for name in joints) or len(set(joints)) < len(joints):
        raise _error(path, "joints with names of their own", joints)
    # One root, which comes first, and no joint above itself.
    sound = all(
        type(parent) is int and (parent == -1 if k == 0 else 0 <= parent < k) for k, parent in enumerate(parents)
    )
    if len(parents) != len(joints) or not sound:
        raise _error(path, f"a tree of {len(joints)} joints, parents before their children", parents)
    for leg in legs:
        if not isinstance(leg, list) or len(leg) < 2:
            raise _error(path, "legs of two joints or more", leg)
        for joint in leg:
            _check_number(joint, "a joint of a leg", 0, len(joints) - 1, path)


def _check_network(session: InferenceSession, card: dict[str, Any], path: Path) -> None:
    """Check that the network has the inputs of its model and, for mime, as many joints as the metadata name."""
    inputs = tuple(sorted(value.name for value in session.get_inputs()))
    if inputs != INPUTS[card["model"]]:
        raise InputError(
            f"{path}: expected the inputs {', '.join(INPUTS[card['model']])}, found {', '.join(inputs)[:80]}; "
            "export it again with this version"
        )
    try:
        shapes = {value.name: value.shape for value in session.get_outputs()}
    except UnicodeDecodeError as error:  # names of axes in damaged files
        raise _error(path, "outputs with names of axes that are text", error) from error
    if card["model"] == "mime" and shapes.get("joints", [])[1:2] != [len(card["joints"])]:
        raise InputError(
            f"{path}: expected an output of {len(card['joints'])} joints, found {shapes!r:.80}; "
            "export it again with this version"
        )


def _error(path: Path, expected: str, found: Any) -> InputError:
    return InputError(
        f"{path}: expected {expected} in its metadata, found {found!r:.60}; export it again with this version"
    )
