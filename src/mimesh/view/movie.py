"""Movies: frames of clips and turntables, written as animated WebP, GIF or MP4."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.arguments import check_rate
from ..core.errors import InputError, option
from ..core.frame_buffer import PAGED, Progress, counted, release_pages
from ..core.geometry import normal_turner
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..io import check_writable, save_clip
from ..io.atomic import whole_file, writing
from .camera import Camera, extreme_points, fit, follow, orbit
from .raster import render_mesh
from .shading import BACKGROUND
from .sheet import Color, captioned, page

if TYPE_CHECKING:
    from PIL import Image

MOVIES = (".gif", ".mp4", ".webp")
"""Suffixes of clips that are written as pictures."""
MOVIE_SIZE = (640, 720)
"""Default width and height of a movie in pixels."""


def write_clip(clip: Clip, path: Path, frames_as: str | None = None, progress: Progress | None = None) -> None:
    """Write a clip as a file, a folder of frames or a movie."""
    if path.suffix.lower() not in MOVIES:
        save_clip(clip, path, suffix=frames_as, progress=progress)
        return
    normalization = Normalization.fit(clip.mesh)
    pictures = clip_frames(clip, MOVIE_SIZE, track=True, up=normalization.up, front=normalization.front)
    save_movie(counted(pictures, len(clip), progress), path, clip.fps)


def save_movie(frames: Iterable[Image.Image | np.ndarray], path: str | Path, fps: float = 30.0) -> int:
    """Write frames as an endlessly looping .webp or .gif, or as an .mp4, and return how many there were.

    WebP keeps full colour and is the smaller. GIF gets one palette for all frames, so that colours do not flicker, and
    times in hundredths of a second, rounded so that the total duration stays right; viewers slow down above 50 frames
    a second. Both merge identical frames into one longer frame. MP4 is H.264 and needs PyAV; its frames are written
    one by one, and a side of odd length loses its last pixel.

    Raises:
        InputError: another suffix, no frames, a frame rate that is not positive, no PyAV, or a Pillow without WebP.
    """
    from PIL import Image

    path = Path(path)
    suffix = path.suffix.lower()
    writers = {".webp": _write_webp, ".gif": _write_gif}
    if suffix not in (*writers, ".mp4"):
        known = ".webp, .gif or .mp4"
        raise InputError(f"{path}: expected a movie name ending in {known}, found {path.suffix or 'no suffix'}")
    check_writable(path)
    check_rate(fps, path, f"give one with {option('fps', ...)}")
    pictures = (Image.fromarray(x) if isinstance(x, np.ndarray) else x.convert("RGB") for x in frames)
    if suffix == ".mp4":
        with writing(path), whole_file(path) as temporary:
            return _write_mp4(pictures, temporary, fps)
    images = list(pictures)
    if not images:
        raise InputError(f"{path}: expected at least one frame, found none; render a longer clip")
    with writing(path), whole_file(path) as temporary:
        writers[suffix](images, temporary, fps)
    return len(images)


def clip_frames(
    clips: Clip | Sequence[tuple[str, Clip]],
    size: tuple[int, int] = (512, 512),
    *,
    view: str | tuple[float, float] = "three-quarter",
    tints: Sequence[tuple[float, float, float] | None] | None = None,
    track: bool = False,
    clay: bool = False,
    up: str = "y",
    front: str | None = None,
    labels: bool = True,
    background: Color = BACKGROUND,
) -> Iterator[Image.Image]:
    """Yield the pictures of a clip, or of several side by side with captions, one by one.

    Each clip has one camera for all of its frames, so that the picture does not jump. Side by side, the first clip's
    frame rate is used and shorter clips stay at their last frame.

    Args:
        size: of one panel in pixels; a caption adds to its height.
        tints: sRGB colour of each clip's clay; None keeps its materials.
        track: the camera follows the subject along the floor, for instance in a long walk.
    """
    named = [("", clips)] if isinstance(clips, Clip) else list(clips)
    cameras = [clip_cameras(clip, size, view, track, up, front) for _, clip in named]
    posers, colors = [mesh_poser(clip.mesh) for _, clip in named], tints or [None] * len(named)
    fps = named[0][1].fps
    for k in range(max(round(clip.seconds * fps) for _, clip in named)):
        tiles = []
        for (label, clip), clip_camera, pose_mesh, tint in zip(named, cameras, posers, colors, strict=True):
            # The last frame at or before this time; the small term absorbs rounding of k / fps * fps.
            t = min(int(k / fps * clip.fps + 1e-6), len(clip) - 1)
            picture = render_mesh(
                pose_mesh(np.asarray(clip.vertices[t], np.float64)),
                size,
                clip_camera[t],
                clay=clay,
                tint=tint,
                background=background,
            )
            tiles.append(captioned(picture, label if label and labels else None))
        # Clips on disk are paged in by reading: without releasing them, long movies would fill the memory.
        if k % PAGED == 0:
            for _, clip in named:
                release_pages(clip.vertices)
        yield page(tiles, len(tiles))


def turntable_frames(
    mesh: Mesh,
    count: int = 60,
    size: tuple[int, int] = (512, 512),
    *,
    view: str | tuple[float, float] = "three-quarter",
    clay: bool = False,
    up: str = "y",
    front: str | None = None,
    background: Color = BACKGROUND,
) -> Iterator[Image.Image]:
    """Yield the pictures of one full turn around the mesh; the last is followed by the first in a loop."""
    from PIL import Image

    for camera in orbit(mesh.vertices, size, count, view, up=up, front=front):
        yield Image.fromarray(render_mesh(mesh, size, camera, clay=clay, background=background))


def mesh_poser(mesh: Mesh) -> Callable[[np.ndarray], Mesh]:
    """Return a function of vertices (V, 3) that does the same as `mesh.with_vertices`, but faster for many frames."""
    if mesh.corner_normals is None:
        return mesh.with_vertices
    normals, turners = mesh.corner_normals, list[Callable[[np.ndarray], np.ndarray]]()

    def pose(points: np.ndarray) -> Mesh:
        if np.array_equal(points, mesh.vertices):  # a still
            return mesh
        if not turners:
            turners.append(normal_turner(normals, mesh.faces, mesh.vertices))
        return dataclasses.replace(mesh, vertices=points, corner_normals=turners[0](points))

    return pose


def clip_cameras(
    clip: Clip, size: tuple[int, int], view: str | tuple[float, float], track: bool, up: str, front: str | None
) -> list[Camera]:
    """Fit a camera for each frame: one for all, or one that follows the subject; the clip is read frame by frame."""
    if track:
        return follow(clip.vertices, size, view, up=up, front=front)
    return [fit(extreme_points(clip.vertices, size, view, up=up, front=front), size, view, up=up, front=front)] * len(
        clip
    )


def _write_webp(images: list[Image.Image], path: Path, fps: float) -> None:
    from PIL import features

    if not features.check("webp"):
        raise InputError(f"{path}: expected a Pillow that writes WebP, found one without it; write a .gif instead")
    durations = _durations(len(images), 1000.0 / fps, 1)
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0, quality=82, method=4)


def _write_gif(images: list[Image.Image], path: Path, fps: float) -> None:
    from PIL import Image

    palette = _shared_palette(images)
    dither = Image.Dither.FLOYDSTEINBERG
    indexed = [image.quantize(palette=palette, dither=dither) for image in images]
    durations = _durations(len(images), 1000.0 / fps, 10)
    indexed[0].save(path, save_all=True, append_images=indexed[1:], duration=durations, loop=0, optimize=False)


def _write_mp4(images: Iterator[Image.Image], path: Path, fps: float) -> int:
    import av

    count = 0
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.pix_fmt = "yuv420p"
        for count, image in enumerate(images, 1):
            # Chroma has half the resolution in yuv420p: both sides must be even.
            width, height = (side - side % 2 for side in image.size)
            if count == 1:
                stream.width, stream.height = width, height
            frame = av.VideoFrame.from_image(image.crop((0, 0, width, height)))
            container.mux(stream.encode(frame))
        if not count:
            raise InputError(f"{path}: expected at least one frame, found none; render a longer clip")
        container.mux(stream.encode(None))  # flush
    return count


def _shared_palette(images: list[Image.Image]) -> Image.Image:
    """Choose 256 colours from eight frames spread over the movie."""
    from PIL import Image

    # Frames of their own palettes would flicker; median cut runs on one image of all of them.
    chosen = images[:: max(1, len(images) // 8)][:8]
    width, height = chosen[0].size
    board = Image.new("RGB", (width, height * len(chosen)))
    for k, image in enumerate(chosen):
        board.paste(image, (0, k * height))
    return board.quantize(256, method=Image.Quantize.MEDIANCUT)


def _durations(count: int, exact: float, step: int) -> list[int]:
    """Return milliseconds per frame in multiples of `step`, rounded so that their cumulative sum stays right."""
    # Rounded end times, each at least one step after the one before; durations are their differences.
    ends = [max(round(exact * k / step), k) * step for k in range(count + 1)]
    return [stop - start for start, stop in itertools.pairwise(ends)]
