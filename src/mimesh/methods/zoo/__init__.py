"""Shipped networks, an `.onnx` file and a card (`.json`) each. The card has the training data, licence and errors."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any


def cards() -> list[dict[str, Any]]:
    """Return the cards of all shipped networks by name, with `bytes`, the size of the network's file (0: missing)."""
    return [_card(entry) for entry in sorted(_folder().iterdir(), key=lambda e: e.name) if entry.name.endswith(".json")]


def _card(entry) -> dict[str, Any]:
    card = json.loads(entry.read_text(encoding="utf-8"))
    weights = _folder() / card["file"]
    return {**card, "bytes": len(weights.read_bytes()) if weights.is_file() else 0}


def _folder():
    return resources.files(__name__)
