"""Read and check the metadata of a network that `mimesh export` wrote: they may be those of any file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import InputError

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

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
