"""Draw the pairs with the largest errors of a method, which the means of a report do not show."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .clip_protocols import ClipPair
from .measure import run_on_clip, run_on_pair
from .metrics import pmd
from .pairs import Pair
from .protocols import Protocol

if TYPE_CHECKING:
    from PIL import Image

WORST = 3
"""Number of pairs of each method and kind that are drawn."""


def dump_worst(
    protocol: Protocol,
    split: str,
    kind: str,
    method: str,
    options: dict[str, Any],
    figures: list[dict[str, Any]],
    folder: Path,
) -> list[Path]:
    """Draw the WORST pairs as `<folder>/<method>-<kind>-<rank>.png` and return the paths.

    The worst have the largest PMD or, where no true mesh is known, the largest angle between limbs.
    """
    measured = {i: metrics.get("pmd_e4", metrics.get("limb_deg")) for i, metrics in enumerate(figures)}
    errors = {i: error for i, error in measured.items() if error is not None}
    worst = sorted(errors, key=errors.__getitem__, reverse=True)[:WORST]
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for rank, i in enumerate(worst, 1):
        pair = protocol.pair(split, kind, i)
        path = folder / f"{Path(method).stem}-{kind}-{rank}.png"
        trial_picture(*_to_draw(pair, method, options)).save(path)
        paths.append(path)
    return paths


def _to_draw(pair: Pair, method: str, options: dict[str, Any]) -> tuple[Pair, Float[np.ndarray, "V 3"]]:
    """Return a pair and the method's result beside its truth; for a clip, those of the frame with the largest PMD."""
    if not isinstance(pair, ClipPair):
        return pair, run_on_pair(pair, method, **options).beside(pair.truth)
    frames = run_on_clip(pair, method, **options).beside(pair.truth_frames)
    worst = int(np.argmax([pmd(a, b) for a, b in zip(frames, pair.truth_frames, strict=True)]))
    return pair.frame(worst), frames[worst]


def trial_picture(pair: Pair, result: Float[np.ndarray, "V 3"]) -> Image.Image:
    """Draw identity, driving, result and truth in a row, above the result's heat map (mm for a person of 1.7 m).

    The result lies where it is compared with the truth.

    Without a true mesh, the first three are drawn.
    """
    from ..render.heat import heat_map
    from ..render.sheet import stack, transfer_sheet

    scale = 1.7 / pair.height
    shown, truth = (dataclasses.replace(pair.identity, vertices=scale * points) for points in (result, pair.truth))
    if not pair.truth_known:
        return transfer_sheet(pair.identity, pair.driving, shown)
    return stack([transfer_sheet(pair.identity, pair.driving, shown, truth), heat_map(shown, truth)])
