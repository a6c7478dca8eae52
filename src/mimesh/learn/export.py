"""Checkpoint to ONNX: dynamic vertex counts, weights stored in half precision, a card beside it."""

from __future__ import annotations

import dataclasses
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from jaxtyping import Float
from torch import nn

from ..core.errors import InputError
from ..evaluate.metrics import VERSION
from ..io.atomic import together, whole_file, written
from ..methods.onnx_runtime import import_onnxruntime
from . import checkpoint
from .config import TrainConfig
from .cost import operations_spent
from .exported_weights import compress
from .onnx_graph import to_onnx
from .tasks.find import find_task

DATA = {
    "table6": "16 people x 400 poses of NPT Table 6",
    "wide": "endless people of the shipped body; rest, Table 6, joint limits, frames of the shipped motions; headings",
    "clips80": "16 people x 80 motions of 30 frames: seconds of the shipped motions, walks and splines",
    "clips": "endless people of the shipped body; windows of the shipped motions at up to 3 times their speed, ways "
    "between poses within the joint limits; headings",
    "meshes": "registered meshes or clips of a folder (`meshes`)",
    "hands": "hands of random people of the shipped body and of characters, fingers in random gestures; mittens, "
    "blocks and hands without fingers",
}
"""Descriptions of `DataConfig.kind` for the card."""
MIME_DATA = (
    "random people of the shipped body, some in its skirt, tights or hair; rest, Table 6, joint limits, frames of the "
    "training seconds of the shipped motions, limbs that touch; headings, some turned over; noise, one-sided surfaces, "
    "missing parts"
)
"""Description of `wide` where `mime` is trained on it."""
ANIMAL_PAIRS = (
    "endless animals of the shipped quadruped; at rest, gaits, sitting, lying and eating, everyday poses, joint "
    "limits; headings"
)
"""Description of `wide` where `npt` is trained on four-legged animals."""
ANIMAL_CLIPS = (
    "endless animals of the shipped quadruped; windows of gaits and of ways to sit, lie and eat at up to 3 times their "
    "speed, ways between poses within the joint limits; headings"
)
"""Description of `clips` where `aniformer` is."""
ANIMAL_DATA = (
    "random animals of the shipped quadruped; at rest, gaits, sitting, lying and eating, everyday poses, joint limits; "
    "headings, some turned over; noise, one-sided surfaces, missing parts"
)
"""Description of `wide` where `mime` is."""
RECOMBINED = ", in {share:.0%} of the cases with head, arms and legs each of another of these"
"""What is added to `table6` and `clips80` where poses are recombined."""
MIXED = ", {share:.0%} of the people random mixtures of the 16"
"""What is added to them where people are mixed."""
CHARACTERS = "; characters of others (`characters`) and people of primitives, in these poses and those of their clips"
"""What is added to it where characters are part of the data."""
NPT_CHARACTERS = "; characters of others (`characters`) in these poses and those of their clips"
"""What is added to `wide` where `npt` is trained on characters too."""
STORED_BITS = (16, 8)
"""Of a weight, as `mimesh export` writes it."""
FULL_BITS = 32
"""Of a weight as it was trained."""


def export_command(path: Path, out: Path, bits: int = 16) -> dict[str, Any]:
    """Do what `mimesh export` does: write the network and its card (`.json`), and give the card.

    The card holds data, configuration, time, hardware and validation figures; whoever measures adds `metrics.test`.

    Args:
        bits: that each weight is stored in, 16 or 8.
    """
    check_output(out, bits, STORED_BITS)
    model, trained = checkpoint.load_model(path)
    config = trained.config
    data = config.data
    facts = {"target_scale": data.target_scale, "body": data.body, "pairing": data.pairing}
    with together():
        save_network(model, config.network, facts, config.model, out, bits)
        card = make_card(out, path, trained)
        save_card(card, out)
    return card


def check_output(out: Path, bits: int, allowed: Sequence[int]) -> None:
    """Check where a network is to be written and in how many bits a weight.

    Raises:
        InputError: the name does not end in .onnx, or `bits` is not one of those allowed, of which the first is usual.
    """
    if out.suffix != ".onnx":
        raise InputError(f"{out}: expected an output that ends in .onnx, found {out.suffix or 'none'}; rename it")
    if bits not in allowed:
        named = f"{', '.join(map(str, allowed[:-1]))} or {allowed[-1]}"
        raise InputError(f"--bits: expected {named}, found {bits}; leave it out for {allowed[0]}")


def save_network(model: nn.Module, network: str, facts: dict[str, Any], config: Any, out: Path, bits: int) -> None:
    """Write a network as ONNX, with what `-m` must know of it and its configuration in the metadata."""
    task = find_task(network)
    graph = to_onnx(task.onnx_interface(model))
    graph = graph if bits == FULL_BITS else compress(graph, bits)
    facts = task.onnx_facts(model) | facts
    onnx.helper.set_model_props(graph, {"mimesh": json.dumps(facts | {"config": dataclasses.asdict(config)})})
    with whole_file(out) as temporary:
        onnx.save(graph, str(temporary))


def save_card(card: dict[str, Any], out: Path) -> None:
    """Write a network's card beside it."""
    with whole_file(out.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8", newline="\n")


def make_card(out: Path, path: Path, trained: checkpoint.Checkpoint) -> dict[str, Any]:
    """Make the model card: provenance and validation figures of the exported weights."""
    header = checkpoint.read_header(path)
    config = header["config"]
    return {
        "name": out.stem,
        "file": out.name,
        "crc32": zlib.crc32(written(out).read_bytes()),
        "license": "not stated" if trained.config.data.kind == "meshes" else "Apache-2.0",
        "data": described_data(trained.config),
        "config": config,
        "seed": config["seed"],
        "commit": header["commit"],
        "hardware": header["hardware"],
        **({"precision": trained.precision} if trained.precision else {}),
        **trained.spent(),
        "pflop": float(f"{operations_spent(trained) / 1e15:.3g}"),
        **({"before": list(trained.before)} if trained.before else {}),
        **({"characters": trained.characters} if trained.characters else {}),
        **({"meshes": trained.meshes} if trained.meshes else {}),
        **({"changes": list(trained.changes)} if trained.changes else {}),
        "metrics": {"version": VERSION, "val": {f"{k}_pmd_e4": round(v, 3) for k, v in trained.metrics.items()}},
    }


def described_data(config: TrainConfig) -> str:
    """Say in words what a training had as data."""
    animals, characters = config.data.body == "quadruped", bool(config.data.characters)
    if config.data.kind == "meshes":
        return DATA["meshes"] + " of animals" * animals
    if config.network == "mime" and config.data.kind == "wide":
        data, more = (ANIMAL_DATA if animals else MIME_DATA), CHARACTERS
    else:
        of_people = DATA[config.data.kind]
        data = {"npt": ANIMAL_PAIRS, "aniformer": ANIMAL_CLIPS}[config.network] if animals else of_people
        more = NPT_CHARACTERS if config.network == "npt" else ""
    more = more.replace("people", "animals") if animals else more
    data += RECOMBINED.format(share=config.data.recombine) if config.data.recombine else ""
    data += MIXED.format(share=config.data.mix_people) if config.data.mix_people else ""
    return data + (more if characters else "")


def test_set(card: dict[str, Any]) -> str:
    """Give the protocol whose figures belong into a card: clips for networks that are trained on them, else pairs."""
    if card["config"].get("data", {}).get("body") == "quadruped":
        return "quadruped"
    if card["config"].get("data", {}).get("pairing") == "order":
        return "clips-ordered"
    return find_task(card["config"].get("network", "npt")).test_set


def infer_onnx(
    network: onnx.ModelProto, identity: Float[np.ndarray, "B V 3"], driving: Float[np.ndarray, "B *T U 3"]
) -> Float[np.ndarray, "B *R V 3"]:
    """Run an exported network once, to compare it with torch."""
    session = import_onnxruntime().InferenceSession(network.SerializeToString(), providers=["CPUExecutionProvider"])
    return np.asarray(session.run(["result"], {"identity": identity, "driving": driving})[0])
