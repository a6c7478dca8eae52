"""Make the pictures of the documentation, and the notes and transcripts that its pages quote.

    python scripts/draw_docs.py [NAME ...]

Names are those of the pictures in docs/images (or `transcripts`); without any, all are made: some minutes. Nothing is
retouched: what a page says of a picture is what came out.
"""

from __future__ import annotations

import argparse
import colorsys
import json
from pathlib import Path

import doc_transcripts
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from trouble_cases import BODY, CASES, OWN, THEIRS, Case, hero, step

from mimesh import Clip, Mesh, Result, animate, transfer
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose
from mimesh.core.surface_points import SurfacePoints
from mimesh.io.atomic import whole_file
from mimesh.render.camera import Camera, fit
from mimesh.render.heat import heat_colors
from mimesh.render.movie import clip_frames
from mimesh.render.raster import render, render_mesh
from mimesh.render.sheet import DRIVING_TINT, INK, page

DOCS = Path(__file__).parents[1] / "docs"
IMAGES, NOTES = DOCS / "images", DOCS / "trouble.json"
SIZE, TILE, LETTER = (420, 480), (300, 343), 20
"""Of a picture as drawn, and as shown without its caption; of a caption's letters, to be read at half the size."""
POINTS = 320
"""That the network of mime reads at once."""
BONE = (58, 84, 122)
MODELS = ("mime", "npt", "npt-maxpool", "aniformer", "skeleton", "copy")
WORST = 0.08
"""Metres at the deepest colour of the picture of models."""


def main() -> None:
    """All pictures, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    wanted = parser.parse_args().names
    notes = json.loads(NOTES.read_text()) if NOTES.exists() else {}
    for make in CASES:
        if not wanted or make.__name__ in wanted:
            notes[make.__name__] = draw_case(make(), make.__name__)
    for draw in (first, models, inside):
        if not wanted or draw.__name__ in wanted:
            save(draw(), draw.__name__)
    write(NOTES, {make.__name__: notes[make.__name__] for make in CASES})
    if not wanted or "transcripts" in wanted:
        write(DOCS / "transcripts.json", doc_transcripts.transcripts())


def draw_case(case: Case, name: str) -> dict[str, list[str]]:
    """Draw what goes in and what comes out, with and without the remedy; the notes of both."""
    before = transfer(case.identity, case.driving, **case.given)
    tiles = [*_inputs(case, before), _tile(before.mesh, "result", before.report["identity"])]
    notes = {"notes": list(before.notes)}
    if case.helped is not None:
        after = transfer(*(case.inputs or (case.identity, case.driving)), **case.helped)
        tiles.append(_tile(after.mesh, case.label, after.report["identity"]))
        notes["helped"] = list(after.notes)
    save(page(tiles, len(tiles)), f"trouble-{name.replace('_', '-')}")
    return notes


def _inputs(case: Case, result: Result) -> list[Image.Image]:
    own, theirs = result.report["identity"], result.report["driving"]
    return [_tile(case.identity, "identity", own), _tile(case.driving, "driving", theirs, DRIVING_TINT)]


def _tile(mesh: Mesh, label: str, axes: dict | None = None, tint=None) -> Image.Image:
    axes = {} if axes is None else {"up": axes["up"], "front": axes["front"]}
    picture = next(clip_frames([("", Clip.still(mesh))], SIZE, tints=[tint], **axes))
    return shown(picture.crop((0, 0, *SIZE)), label)


def shown(picture: Image.Image, label: str) -> Image.Image:
    """A picture with its caption, as it stands on a page."""
    paper = picture.getpixel((0, 0))
    tile = Image.new("RGB", (TILE[0], TILE[1] + 2 * LETTER), paper)
    tile.paste(picture.resize(TILE, Image.Resampling.LANCZOS))
    middle = (TILE[0] / 2, TILE[1] + LETTER / 4)
    ImageDraw.Draw(tile).text(middle, label, INK, ImageFont.load_default(LETTER), anchor="ma")
    return tile


def first() -> Image.Image:
    """A pair and its result."""
    identity, driving = hero(), step()
    tiles = [_tile(identity, "identity"), _tile(driving, "driving", tint=DRIVING_TINT)]
    return page([*tiles, _tile(transfer(identity, driving).mesh, "result")], 3)


def models() -> Image.Image:
    """What each model makes of one pair, coloured by the distance to the truth."""
    identity, rotmat = hero(), rotvec_to_rotmat(sample_pose(BODY, 4, 2))
    driving = step().with_vertices(BODY.posed(THEIRS, rotmat))
    truth = BODY.posed(OWN, rotmat)
    tiles = [_tile(identity, "identity"), _tile(driving, "driving", tint=DRIVING_TINT)]
    camera = fit(truth, SIZE)
    tiles += [shown(Image.fromarray(render(truth, BODY.faces, camera, SIZE)), "truth")]
    for model in MODELS:
        vertices = transfer(identity, driving, model).vertices
        vertices = vertices + truth.mean(axis=0) - vertices.mean(axis=0)
        off = np.linalg.norm(vertices - truth, axis=1)
        picture = render(vertices, BODY.faces, camera, SIZE, heat_colors(off / WORST))
        tiles.append(shown(Image.fromarray(picture), f"{model}: {1000 * off.mean():.0f} mm"))
    return page(tiles, 3)


def inside() -> Image.Image:
    """What mime reads of a mesh: points, joints and weights, and the same mesh skinned to other turns."""
    identity = hero()
    result = animate(identity, Clip.still(step()))
    assert result.skeleton is not None
    rig, parents = result.skeleton.rig, result.skeleton.parents
    camera, moved = fit(identity.vertices, SIZE), result.clip.vertices[0].astype(np.float64)
    points = SurfacePoints.of(identity, POINTS, np.random.default_rng(0)).points(identity.vertices)
    colors = rig.weights @ _hues(len(parents))
    bones = Image.fromarray(render_mesh(identity, SIZE, camera))
    _draw_bones(bones, camera, rig.joints, parents)
    pictures = [
        (_drawn(points, np.zeros((0, 3), int), camera), f"{POINTS} points of it"),
        (bones, "joints of a person fitted"),
        (_drawn(identity.vertices, identity.faces, camera, colors), "skinning weights"),
        (_drawn(moved, identity.faces, fit(moved, SIZE), colors), "skinned to other turns"),
    ]
    return page([shown(*one) for one in pictures], len(pictures))


def _drawn(vertices: np.ndarray, faces: np.ndarray, camera: Camera, colors=None) -> Image.Image:
    return Image.fromarray(render(vertices, faces, camera, SIZE, colors))


def _hues(count: int) -> np.ndarray:
    """Soft colours, neighbours apart."""
    turns = (0.61803 * np.arange(count)) % 1.0
    return np.array([colorsys.hls_to_rgb(turn, 0.62, 0.45) for turn in turns])


def _draw_bones(picture: Image.Image, camera: Camera, joints: np.ndarray, parents: tuple[int, ...]) -> None:
    places = camera.project(joints, SIZE)[:, :2]
    draw = ImageDraw.Draw(picture)
    for j, parent in enumerate(parents):
        if parent >= 0:
            draw.line([tuple(places[parent]), tuple(places[j])], BONE, 3)
    for x, y in places:
        draw.ellipse([x - 4, y - 4, x + 4, y + 4], BONE)


def save(image: Image.Image, name: str) -> None:
    """Write a WebP into docs/images."""
    path = IMAGES / f"{name}.webp"
    with whole_file(path) as temporary:
        image.save(temporary, format="WEBP", quality=82, method=6)
    print(f"{path}: {path.stat().st_size / 1024:.0f} KiB")


def write(path: Path, value: object) -> None:
    """Write JSON."""
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
