"""Make the pictures in docs/images that need more than one command of mimesh.

    python scripts/draw_docs.py [NAME ...]

Without a name, all are made, which takes some minutes. Pictures are not retouched.
"""

from __future__ import annotations

import argparse
import colorsys
import dataclasses
import tempfile
from pathlib import Path

import fast_simplification
import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont

from mimesh import Clip, FrameRange, Mesh, Result, animate, capture, retarget, rig, save_mesh, transfer
from mimesh.bodies import character, load_body
from mimesh.bodies.animals import animal
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose
from mimesh.core.mesh import cut_clip
from mimesh.core.skinning import place_joints
from mimesh.core.surface_points import SurfacePoints
from mimesh.io.atomic import whole_file
from mimesh.motions import load_motion, motion_clip
from mimesh.motions.animal_clips import gait_clip
from mimesh.tools.demo import DRIVING_SHAPE, IDENTITY_SHAPE
from mimesh.view.camera import Camera, fit
from mimesh.view.heat import heat_colors
from mimesh.view.movie import clip_frames
from mimesh.view.raster import render, render_mesh
from mimesh.view.sheet import DRIVING_TINT, INK, page

IMAGES = Path(__file__).parents[1] / "docs" / "images"
BODY = load_body()
IDENTITY_PERSON, DRIVING_PERSON = np.array(IDENTITY_SHAPE), np.array(DRIVING_SHAPE)
"""Shape coefficients."""
STEP = {
    "LeftArm": (0, 0, -60),
    "RightArm": (0, 0, 50),
    "LeftForeArm": (0, -70, 0),
    "RightUpLeg": (-40, 0, 0),
    "RightLeg": (50, 0, 0),
}
"""Joint -> its rotation vector in degrees, of a person who takes a step."""
SIZE, TILE, FONT_SIZE = (420, 480), (300, 343), 20
"""Pixels: of a picture as rendered, of a picture on the page without its caption, and of the caption's font."""
POINTS = 320
"""Number of surface points that mime's network reads."""
BONE_COLOUR = (58, 84, 122)
MODELS = ("mime", "npt", "npt-maxpool", "aniformer", "copy")
"""Models in the picture of models."""
CAPTURED = "jump"
"""Shipped motion in the pictures of captures."""
SCAN_STEP = 3
"""Frames of the shipped motion from one scan to the next."""
MAX_DISTANCE = 0.08
"""Distance to the truth (metres) of the last colour in the picture of models."""


def main() -> None:
    """Make all pictures, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    selected = parser.parse_args().names
    for draw in (first, models, inside, body_fit, rigs, captured, scans, species):
        if not selected or draw.__name__ in selected:
            save(draw(), draw.__name__)


def hero() -> Mesh:
    """Return the identity: a person at rest."""
    return dataclasses.replace(BODY.mesh(BODY.shaped(IDENTITY_PERSON)[0]), name="hero")


def step() -> Mesh:
    """Return the driving mesh: a person taking a step."""
    rotvec = np.zeros((len(BODY.joint_names), 3))
    for joint, rotation in STEP.items():
        rotvec[BODY.joint(joint)] = np.radians(rotation)
    return dataclasses.replace(BODY.mesh(BODY.posed(DRIVING_PERSON, rotvec_to_rotmat(rotvec))), name="pose")


def _tile(mesh: Mesh, label: str, tint=None) -> Image.Image:
    picture = next(clip_frames([("", Clip.still(mesh))], SIZE, tints=[tint]))
    return captioned(picture.crop((0, 0, *SIZE)), label)


def captioned(picture: Image.Image, label: str) -> Image.Image:
    """Scale a picture to its size on the page and add its caption."""
    background = picture.getpixel((0, 0))
    tile = Image.new("RGB", (TILE[0], TILE[1] + 2 * FONT_SIZE), background)
    tile.paste(picture.resize(TILE, Image.Resampling.LANCZOS))
    middle = (TILE[0] / 2, TILE[1] + FONT_SIZE / 4)
    ImageDraw.Draw(tile).text(middle, label, INK, ImageFont.load_default(FONT_SIZE), anchor="ma")
    return tile


def first() -> Image.Image:
    """Draw a pair and its result."""
    identity, driving = hero(), step()
    tiles = [_tile(identity, "identity"), _tile(driving, "driving", tint=DRIVING_TINT)]
    return page([*tiles, _tile(transfer(identity, driving).mesh, "result")], 3)


def models() -> Image.Image:
    """Draw the result of each model on one pair, coloured by the distance to the truth."""
    identity, driving, truth = _pair_with_truth()
    tiles = [_tile(identity, "identity"), _tile(driving, "driving", tint=DRIVING_TINT)]
    tiles += [captioned(Image.fromarray(render(truth, BODY.faces, fit(truth, SIZE), SIZE)), "truth")]
    return page([*tiles, *(_error_tile(transfer(identity, driving, model), truth) for model in MODELS)], 3)


def body_fit() -> Image.Image:
    """Draw what the body fit changes: joints found on the driving mesh, and results, without and with it."""
    identity, driving, truth = _pair_with_truth()
    camera, joints, errors = fit(driving.vertices, SIZE), [], []
    for model, label in (("mime-network", "joints without the fit"), ("mime", "joints with the fit")):
        result = transfer(identity, driving, model)
        assert result.driving_joints is not None
        bones = Image.fromarray(render_mesh(driving, SIZE, camera))
        _draw_bones(bones, camera, np.array([result.driving_joints[name] for name in BODY.joint_names]), BODY.parents)
        joints.append(captioned(bones, label))
        errors.append(_error_tile(result, truth))
    return page([*joints, *errors], 4)


def _pair_with_truth() -> tuple[Mesh, Mesh, Float[np.ndarray, "V 3"]]:
    """Return a person at rest, another one in a random pose, and the vertices of the first in that pose."""
    rotmat = rotvec_to_rotmat(sample_pose(BODY, 4, 2))
    driving = step().with_vertices(BODY.posed(DRIVING_PERSON, rotmat))
    return hero(), driving, BODY.posed(IDENTITY_PERSON, rotmat)


def _error_tile(result: Result, truth: Float[np.ndarray, "V 3"]) -> Image.Image:
    """Draw a result of a person coloured by the distance to the truth, both centred, with the mean below."""
    vertices = result.vertices + truth.mean(axis=0) - result.vertices.mean(axis=0)
    distance = np.linalg.norm(vertices - truth, axis=1)
    picture = render(vertices, BODY.faces, fit(truth, SIZE), SIZE, heat_colors(distance / MAX_DISTANCE))
    return captioned(Image.fromarray(picture), f"{result.model}: {1000 * distance.mean():.0f} mm")


def inside() -> Image.Image:
    """Draw the steps of mime on a mesh: surface points, joints, skinning weights, and the skinned result."""
    identity = hero()
    result = animate(identity, Clip.still(step()))
    assert result.skeleton is not None
    rig, parents = result.skeleton.rig, result.skeleton.parents
    camera, moved = fit(identity.vertices, SIZE), result.clip.vertices[0].astype(np.float64)
    points = SurfacePoints.of(identity, POINTS, np.random.default_rng(0)).points(identity.vertices)
    colors = rig.weights @ _joint_colours(len(parents))
    bones = Image.fromarray(render_mesh(identity, SIZE, camera))
    _draw_bones(bones, camera, rig.joints, parents)
    pictures = [
        (_render(points, np.zeros((0, 3), int), camera), f"{POINTS} surface points"),
        (bones, "joints of the fitted body"),
        (_render(identity.vertices, identity.faces, camera, colors), "skinning weights"),
        (_render(moved, identity.faces, fit(moved, SIZE), colors), "skinned to other rotations"),
    ]
    return page([captioned(*picture) for picture in pictures], len(pictures))


def rigs() -> Image.Image:
    """Draw the bones that are found on meshes without any."""
    tiles = []
    for mesh in (character("heavy"), character("dancer"), character("imp"), animal("camel")):
        found = rig(mesh).skeleton
        camera = fit(mesh.vertices, SIZE)
        picture = Image.fromarray(render_mesh(mesh, SIZE, camera, clay=True))
        _draw_bones(picture, camera, found.rig.joints, found.parents)
        tiles.append(captioned(picture, f"{mesh.name}: {len(found.names)} joints"))
    return page(tiles, len(tiles))


def captured() -> Image.Image:
    """Draw frames of a clip without joints, the joints that are captured from it, and a character that they move."""
    clip = motion_clip(BODY, DRIVING_PERSON, load_motion(CAPTURED))
    motion = capture(clip)
    moved = retarget(motion, rig(character("child"))).clip
    bones = motion.rest[1:] - motion.rest[list(motion.parents[1:])]
    joints = place_joints(motion.root, bones, motion.rotation, motion.parents)
    rows: list[list[Image.Image]] = [[], [], []]
    for frame in np.linspace(0, len(clip) - 1, 5).round().astype(int):
        driving, result = (of.mesh.with_vertices(of.vertices[frame]) for of in (clip, moved))
        camera = fit(driving.vertices, SIZE)
        drawn = Image.fromarray(render_mesh(driving, SIZE, camera))
        _draw_bones(drawn, camera, joints[frame], motion.parents)
        rows[0].append(_tile(driving, "clip", DRIVING_TINT))
        rows[1].append(captioned(drawn, "joints"))
        rows[2].append(_tile(result, "child"))
    return page([tile for row in rows for tile in row], len(rows[0]))


def scans() -> Image.Image:
    """Draw scans of a person, each with triangles of its own, and two characters that move like them."""
    clip = cut_clip(motion_clip(BODY, DRIVING_PERSON, load_motion(CAPTURED)), 0, None, SCAN_STEP)
    rng, taken = np.random.default_rng(0), []
    with tempfile.TemporaryDirectory() as folder:
        for t, vertices in enumerate(clip.vertices):
            points, faces = fast_simplification.simplify(vertices, clip.mesh.faces, rng.uniform(0.6, 0.9))[:2]
            taken.append(Mesh(points.astype(float), faces.astype(int), "scan"))
            save_mesh(taken[-1], Path(folder, f"{t:03d}.ply"))
        moved = [animate(character(name), folder, frames=FrameRange(fps=clip.fps)).clip for name in ("brute", "child")]
    chosen = np.linspace(0, len(taken) - 1, 5).round().astype(int)
    rows = [[_tile(taken[t], f"{len(taken[t].faces):,} triangles", DRIVING_TINT) for t in chosen]]
    rows += [[_tile(of.mesh.with_vertices(of.vertices[t]), of.mesh.name) for t in chosen] for of in moved]
    return page([tile for row in rows for tile in row], len(chosen))


def species() -> Image.Image:
    """Draw a horse and a cat at rest and in poses, and a camel and a lion without rigs that follow them."""
    tiles = []
    for driving, identity, gait in (("horse", "camel", "gallop"), ("cat", "lion", "trot")):
        clip = gait_clip(driving, gait, seconds=0.6)
        result = animate(animal(identity), clip).clip
        for name, moved, tint in ((driving, clip, DRIVING_TINT), (identity, result, None)):
            tiles.append(_tile(animal(name), f"{name}, at rest", tint))
            for frame in np.linspace(0, len(clip) - 1, 4).round().astype(int):
                tiles.append(_tile(moved.mesh.with_vertices(moved.vertices[frame]), name, tint))
    return page(tiles, 5)


def _render(vertices: np.ndarray, faces: np.ndarray, camera: Camera, colors=None) -> Image.Image:
    return Image.fromarray(render(vertices, faces, camera, SIZE, colors))


def _joint_colours(count: int) -> np.ndarray:
    """Return soft colours; steps of the golden ratio keep the hues of consecutive joints apart."""
    hues = (0.61803 * np.arange(count)) % 1.0
    return np.array([colorsys.hls_to_rgb(hue, 0.62, 0.45) for hue in hues])


def _draw_bones(picture: Image.Image, camera: Camera, joints: np.ndarray, parents: tuple[int, ...]) -> None:
    pixels = camera.project(joints, SIZE)[:, :2]
    draw = ImageDraw.Draw(picture)
    for j, parent in enumerate(parents):
        if parent >= 0:
            draw.line([tuple(pixels[parent]), tuple(pixels[j])], BONE_COLOUR, 3)
    for x, y in pixels:
        draw.ellipse([x - 4, y - 4, x + 4, y + 4], BONE_COLOUR)


def save(image: Image.Image, name: str) -> None:
    """Write a WebP into docs/images."""
    path = IMAGES / f"{name}.webp"
    with whole_file(path) as temporary:
        image.save(temporary, format="WEBP", quality=82, method=6)
    print(f"{path}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
