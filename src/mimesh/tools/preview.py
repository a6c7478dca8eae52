"""The picture and the page written beside a result: what moved, what it followed, and what came out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.mesh import Clip, Mesh
from ..io.atomic import whole_file, writing
from ..pipeline.result import ClipResult, Result
from ..render.movie import clip_frames
from ..render.sheet import DRIVING_TINT, page, stack, strip

if TYPE_CHECKING:
    from PIL import Image

TILE = (360, 440)


def beside(result: Result | ClipResult, output: Path) -> tuple[Path, Path]:
    """Write `output`.preview.png and `output`.preview.html, the page that plays it; returns their paths."""
    picture, page = names_beside(output)
    save_picture(result_picture(result), picture)
    return picture, result.player(page, output=output)


def names_beside(output: Path) -> tuple[Path, Path]:
    """Paths of the picture and of the page that are written beside an output."""
    base = output.with_suffix("") if output.suffix else output
    return base.with_name(f"{base.name}.preview.png"), base.with_name(f"{base.name}.preview.html")


def result_picture(result: Result | ClipResult) -> Image.Image:
    """Identity, driving and result side by side; of a clip, driving and result as two strips."""
    own, theirs = _axes(result.report, "identity"), _axes(result.report, "driving")
    if isinstance(result, ClipResult):
        assert result.driving is not None
        clips = ((result.driving, theirs, DRIVING_TINT), (result.clip, own, None))
        return stack([strip(clip, 6, (220, 280), tint=tint, **axes) for clip, axes, tint in clips])
    assert result.identity is not None
    assert result.driving is not None
    tiles = [
        still(result.identity, "identity", **own),
        still(result.driving, "driving", tint=DRIVING_TINT, **theirs),
        still(result.mesh, f"result ({result.model})", **own),
    ]
    return page(tiles, len(tiles))


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
