"""Pictures written beside a result: what moved, what it followed, and what came out, each seen from its own front."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .io.atomic import whole_file, writing
from .mesh import Clip, Mesh, cut_clip
from .view.movie import clip_frames, save_movie
from .view.sheet import DRIVING_TINT, page, stack, strip

if TYPE_CHECKING:
    from PIL import Image

    from .result import ClipResult, Result

TILE = (360, 440)
MOST_FRAMES = 32
"""Longer clips are shown with fewer frames per second: drawing must not cost more than moving."""


def transfer_picture(identity: Mesh, driving: Mesh, result: Result) -> Image.Image:
    """Identity, driving mesh and result side by side."""
    own, theirs = _axes(result.report, "identity"), _axes(result.report, "driving")
    tiles = [
        still(identity, "identity", **own),
        still(driving, "driving", tint=DRIVING_TINT, **theirs),
        still(result.mesh, f"result ({result.model})", **own),
    ]
    return page(tiles, len(tiles))


def clip_pictures(driving: Clip, result: ClipResult, output: Path) -> list[Path]:
    """Write `output`.preview.webp (driving and result, moving) and `output`.preview.png (the same as two strips).

    `driving` has the frames that the result has, at its frame rate.
    """
    own, theirs = _axes(result.report, "identity"), _axes(result.report, "driving")
    clips = (("driving", _thinned(driving), theirs, DRIVING_TINT), ("result", _thinned(result.clip), own, None))
    base = output.with_suffix("") if output.suffix else output
    movie, picture = (base.with_name(f"{base.name}.preview{suffix}") for suffix in (".webp", ".png"))
    panels = [clip_frames([(label, clip)], TILE, tints=[tint], track=True, **axes) for label, clip, axes, tint in clips]
    save_movie((page(tiles, len(tiles)) for tiles in zip(*panels, strict=True)), movie, clips[0][1].fps)
    save_picture(stack([strip(clip, 6, (220, 280), tint=tint, **axes) for _, clip, axes, tint in clips]), picture)
    return [movie, picture]


def save_picture(image: Image.Image, path: Path) -> Path:
    """Write a PNG or JPEG, whole or not at all."""
    with writing(path), whole_file(path) as temporary:
        image.save(temporary)
    return path


def still(mesh: Mesh, label: str, *, tint=None, up: str = "y", front: str | None = None) -> Image.Image:
    """One captioned picture of a mesh, in its own colours or in the tint's clay."""
    return next(clip_frames([(label, Clip.still(mesh))], TILE, tints=[tint], up=up, front=front))


def _axes(report: dict[str, Any], which: str) -> dict[str, Any]:
    return {"up": report[which]["up"], "front": report[which]["front"]}


def _thinned(clip: Clip) -> Clip:
    step = -(-len(clip) // MOST_FRAMES)
    return cut_clip(clip, 0, None, step)
