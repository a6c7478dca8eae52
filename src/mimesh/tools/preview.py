"""The picture and the page that are written beside a result: identity, driving and result."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from ..core.errors import InputError
from ..core.frame_buffer import evenly_spread
from ..core.mesh import Clip, Mesh, merged_mesh, same_colors
from ..core.printable import file_name
from ..core.surface_clusters import clustered_mesh
from ..io.atomic import whole_file, writing
from ..pipeline.report import MeshReport, RigReport
from ..pipeline.result import ClipResult, Result
from ..view.camera import fit
from ..view.movie import clip_frames
from ..view.pack import MotionLimits
from ..view.raster import render_mesh
from ..view.sheet import DRIVING_TINT, captioned, page, stack, strip

if TYPE_CHECKING:
    from PIL import Image

    from ..core.animated_rig import AnimatedRig

MOTION = MotionLimits(frames=250, characters=4 * 2**20, vertices=50_000, driving_vertices=2000)
"""Of a page beside a result: seconds to write, and 5 MB with the script, a small .glb and no textures."""
TILE = (360, 440)
"""Width and height of one picture in pixels."""
STRIP, STRIP_TILE = 6, (220, 280)
"""Frames of a clip that are drawn side by side, and the size of each in pixels."""
BONE_CLAY, BONE_COLOR, JOINT_COLOR, BONE_WIDTH = (0.86, 0.87, 0.89), (199, 72, 38), (60, 60, 70), 3
"""Colours of a mesh whose bones are drawn over it, of bones and of joints, and the width of bones in pixels."""
DRAWN = 300_000
"""Vertices to which larger meshes are reduced before they are drawn: a picture has 158,400 pixels."""


def write_preview(
    result: Result | ClipResult, output: Path, clip: str | None = None, usual: str = ".glb"
) -> tuple[tuple[Path, ...], tuple[Path, ...], tuple[str, ...]]:
    """Write OUTPUT.preview.png and OUTPUT.preview.html, the page that plays the result.

    `clip` is the name of the result's animation where the output has several; for `usual` see `names_beside`.

    Returns:
        The pictures and the pages that were written, one each, and a note on each that could not be.
    """
    picture, page = names_beside(output, clip, usual)
    pictures, no_picture = written_beside(picture, lambda: save_picture(result_picture(result), picture))
    pages, no_page = written_beside(page, lambda: result.player(page, output=output, motion=MOTION))
    return pictures, pages, no_picture + no_page


def written_beside(path: Path, write: Callable[[], object]) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Write a picture or a page beside a result that is there already; return its path, or a note that it failed.

    Whatever fails, even in a library that draws, must not cost the result.
    """
    try:
        write()
    except Exception as error:
        logging.getLogger(__package__).debug("%s", path, exc_info=True)
        found = error if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        line = " ".join(str(found).split())
        return (), (f"{path.name} was not written ({line}); the result is complete",)
    return (path,), ()


def names_beside(output: Path, clip: str | None = None, usual: str = ".glb") -> tuple[Path, Path]:
    """Return the paths of the picture and of the page beside an output, or beside it for one of its clips.

    They have the name of the output, without its suffix if that is the `usual` one: hero.glb and hero.ply in one folder
    have previews of their own.
    """
    name = output.stem if output.suffix.lower() == usual.lower() else output.name
    if clip is not None:
        name = f"{name}-{file_name(clip)}"
    return output.with_name(f"{name}.preview.png"), output.with_name(f"{name}.preview.html")


def result_picture(result: Result | ClipResult) -> Image.Image:
    """Draw identity, driving and result side by side; of a clip, driving and result as two strips."""
    identity_axes, driving_axes = _axes(result.report["identity"]), _axes(result.report["driving"])
    if isinstance(result, ClipResult):
        assert result.driving is not None
        chosen = evenly_spread(len(result.frames), STRIP)
        group = same_colors(result.mesh, result.frames.group)
        frames = result.frames if group is None else result.frames.distinct
        moved = Clip(merged_mesh(result.mesh, group), np.stack(list(frames.at(chosen))), result.fps)
        return stack(
            [
                strip(result.driving, STRIP, STRIP_TILE, tint=DRIVING_TINT, **driving_axes),
                strip(moved, STRIP, STRIP_TILE, times=(chosen / result.fps).tolist(), **identity_axes),
            ]
        )
    assert result.identity is not None
    assert result.driving is not None
    tiles = [
        still(result.identity, "identity", **identity_axes),
        still(result.driving, "driving", tint=DRIVING_TINT, **driving_axes),
        still(result.mesh, f"result ({result.model})", **identity_axes),
    ]
    return page(tiles, len(tiles))


def rig_picture(skeleton: AnimatedRig, report: RigReport) -> Image.Image:
    """Draw the mesh of a rig at rest, and its bones over it from the front and from the side."""
    return bones_picture(skeleton.mesh, skeleton.rig.joints, skeleton.parents, "bones", **_axes(report))


def bones_picture(
    mesh: Mesh, joints: Float[np.ndarray, "J 3"], parents: tuple[int, ...], label: str, up: str, front: str
) -> Image.Image:
    """Draw a mesh, and bones over it from the front and from the side."""
    axes: dict[str, Any] = {"up": up, "front": front}
    drawn = clustered_mesh(mesh, DRAWN) if len(mesh.vertices) > 2 * DRAWN and len(mesh.faces) else mesh
    tiles = [still(mesh, "mesh", **axes)]
    for view in ("front", "side"):
        camera = fit(drawn.vertices, TILE, view, **axes)
        picture = render_mesh(drawn, TILE, camera, clay=True, tint=BONE_CLAY)
        places = camera.project(joints, TILE)[:, :2]
        tiles.append(captioned(_with_bones(picture, places, parents), f"{label}, {view}"))
    return page(tiles, len(tiles))


def _with_bones(
    picture: UInt8[np.ndarray, "h w C"], places: Float[np.ndarray, "J 2"], parents: tuple[int, ...]
) -> UInt8[np.ndarray, "h w C"]:
    """Draw bones, from the joints' pixels to those of their parents, over a picture."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for j, parent in enumerate(parents):
        if parent >= 0:
            draw.line([*map(tuple, (places[parent].tolist(), places[j].tolist()))], BONE_COLOR, BONE_WIDTH)
    for x, y in places.tolist():
        draw.ellipse((x - BONE_WIDTH, y - BONE_WIDTH, x + BONE_WIDTH, y + BONE_WIDTH), JOINT_COLOR)
    return np.asarray(image)


def save_picture(image: Image.Image, path: Path) -> Path:
    """Write a PNG or JPEG; after an error no incomplete file is left."""
    with writing(path), whole_file(path) as temporary:
        image.save(temporary)
    return path


def still(mesh: Mesh, label: str, *, tint=None, up: str = "y", front: str | None = None) -> Image.Image:
    """Draw a captioned picture of a mesh, in its own colours or in those of a tint."""
    mesh = clustered_mesh(mesh, DRAWN) if len(mesh.vertices) > 2 * DRAWN and len(mesh.faces) else mesh
    return next(clip_frames([(label, Clip.still(mesh))], TILE, tints=[tint], up=up, front=front))


def _axes(mesh: MeshReport) -> dict[str, Any]:
    return {"up": mesh["up"], "front": mesh["front"]}
