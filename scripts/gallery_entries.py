"""The entries of the gallery: title, sentence, commands and picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from gallery_stage import Movie, Panel, heat, on_one_floor, side_by_side, stills
from PIL import Image

Picture = Movie | Image.Image
JUMP_CHARACTERS = (("slim", -1.9), ("heavy", -0.95), ("child", 0.85), ("brute", 1.85))
"""Characters of an entry, and their positions (metres to the left)."""
LUNGE_CHARACTERS = (("brute", -2.7), ("imp", 0.7), ("stork", 2.9))
ROOTS = ("keep", "scale", "drop")
GALLOPING, WALKING = ("cow", "cat", "dog", "rhino"), ("cow", "cat", "horse", "rhino")
"""Animals that a horse and a dog drive."""
ANIMAL_TILE = (172, 146)
COMPARED_MODELS = ("copy", "npt", "aniformer", "mime")


@dataclass(frozen=True)
class Entry:
    """An entry of the gallery."""

    name: str
    """File name of its picture, without the suffix."""
    title: str
    sentence: str
    commands: tuple[str, ...]
    """Commands, run in order in the gallery's folder."""
    draw: Callable[[Path], Picture]
    """Draws the picture from the files in that folder, after the commands have run."""


def _animate(identity: str, driving: str, options: str = "", result: str = "") -> str:
    """Return the command that animates an identity with a clip."""
    result = result or f"{identity}-{Path(driving).stem}.glb"
    return f"mimesh animate inputs/{identity}.glb inputs/{driving} -o {result}{options and ' ' + options}"


def _three_panels(identity: str, driving: str, result: str, label: str) -> list[Panel]:
    return [
        Panel(f"inputs/{identity}.glb", "identity"),
        Panel(f"inputs/{driving}", label, drives=True),
        Panel(result, "result"),
    ]


def _clip_panels(identity: str, driving: str, result: str, label: str) -> Callable[[Path], Picture]:
    """Return a function that draws identity, driving clip and result side by side as a movie."""
    return lambda folder: side_by_side(folder, _three_panels(identity, driving, result, label))


def _pose_panels(identity: str, driving: str, result: str, label: str) -> Callable[[Path], Picture]:
    """Return a function that draws identity, driving mesh and result side by side as a still."""
    return lambda folder: stills(folder, _three_panels(identity, driving, result, label))


def _one_jump(folder: Path) -> Picture:
    others = [Panel(f"{name}-jump.glb", "", place=(x, -0.35)) for name, x in JUMP_CHARACTERS]
    return on_one_floor(folder, [Panel("inputs/jump.bvh", "", True, (0.0, 0.8)), *others], (720, 330))


def _proportions(folder: Path) -> Picture:
    others = [Panel(f"{name}-lunge.glb", "", place=(x, 0.0)) for name, x in LUNGE_CHARACTERS]
    return on_one_floor(folder, [Panel("inputs/lunge.bvh", "", True, (-0.9, 0.4)), *others], (720, 340))


def _root_options(folder: Path) -> Picture:
    lanes = [("inputs/walk.bvh", "driving"), *((f"walk-{root}.glb", root) for root in ROOTS)]
    panels = [Panel(file, label, not k, (1.2 - 0.85 * k, 0.0)) for k, (file, label) in enumerate(lanes)]
    return on_one_floor(folder, panels, (720, 330), view=(-78.0, 13.0))


def _hard_poses(folder: Path) -> Picture:
    pairs = [(f"inputs/pose-{i}.obj", f"brute-pose-{i}.glb") for i in range(3)]
    panels = [panel for a, b in pairs for panel in (Panel(a, "driving", True), Panel(b, "result"))]
    return stills(folder, panels, (240, 300))


def _animals(folder: Path, names: Sequence[str], driving: str, label: str) -> Picture:
    panels = [Panel(f"inputs/{driving}.glb", label, drives=True), *(Panel(f"{n}-{driving}.glb", n) for n in names)]
    return side_by_side(folder, panels, ANIMAL_TILE, view=(-62.0, 8.0))


def _model_comparison(folder: Path) -> Picture:
    return heat(folder, [(f"{model}.obj", model) for model in COMPARED_MODELS], "inputs/truth.obj", limit=0.08)


ENTRIES = (
    Entry(
        "one-jump",
        "One jump, four people",
        "A captured jump (blue, in front) drives a slim person, a heavy one, a child and a stylised brute.",
        tuple(_animate(name, "jump.bvh") for name, _ in JUMP_CHARACTERS),
        _one_jump,
    ),
    Entry(
        "dancer",
        "In skirt and hair",
        "Four surfaces in one file, none of them rigged; the file comes back with its materials.",
        (_animate("dancer", "dance.bvh"),),
        _clip_panels("dancer", "dance.bvh", "dancer-dance.glb", "driving: a BVH file"),
    ),
    Entry(
        "creatures",
        "Other proportions",
        "A generated motion (blue) on a brute, an imp with a large head and a stork with long limbs.",
        tuple(_animate(name, "lunge.bvh") for name, _ in LUNGE_CHARACTERS),
        _proportions,
    ),
    Entry(
        "noise",
        "A noisy driving scan",
        "Every vertex of every frame has noise of 2 % of half the height; the surface of the result has none of it.",
        (_animate("runner", "noisy.glb", result="runner-noisy.glb"),),
        _clip_panels("runner", "noisy.glb", "runner-noisy.glb", "driving: 2 % noise"),
    ),
    Entry(
        "points",
        "Driving point clouds",
        "A folder of point clouds, 1,500 points each and no triangles.",
        (_animate("child", "points", "--fps 15"),),
        _clip_panels("child", "points", "child-points.glb", "driving: points"),
    ),
    Entry(
        "half-scan",
        "Half of a driving surface",
        "A surface as one depth camera records it: the side that faces away is missing.",
        ("mimesh transfer inputs/slim.glb inputs/half-scan.ply -o slim-half-scan.glb",),
        _pose_panels("slim", "half-scan.ply", "slim-half-scan.glb", "driving: seen from one side"),
    ),
    Entry(
        "meshings",
        "Different meshings",
        "The identity has about 500 vertices, the driving mesh 6,900 others; no correspondence is given.",
        (_animate("low-poly", "retriangulated.glb"),),
        _clip_panels("low-poly", "retriangulated.glb", "low-poly-retriangulated.glb", "driving: retriangulated"),
    ),
    Entry(
        "roots",
        "Three ways to walk",
        "An adult (blue) drives a child: with the adult's path (`keep`), with the path scaled by leg length (`scale`), "
        "and in place (`drop`).",
        tuple(_animate("child", "walk.bvh", f"--root {root}", f"walk-{root}.glb") for root in ROOTS),
        _root_options,
    ),
    Entry(
        "skinned",
        "A character for a game engine",
        "The same mesh with 31 joints, four weights a vertex and joint rotations instead of frames: {size}.",
        (
            _animate("runner", "dance.bvh"),
            _animate("runner", "dance.bvh", "--morphs", "runner-morphs.glb"),
        ),
        _clip_panels("runner", "dance.bvh", "runner-dance.glb", "driving: a BVH file"),
    ),
    Entry(
        "hard-poses",
        "At the limits of the joints",
        "Random poses within the limits of human joints.",
        tuple(f"mimesh transfer inputs/brute.glb inputs/pose-{i}.obj -o brute-pose-{i}.glb" for i in range(3)),
        _hard_poses,
    ),
    Entry(
        "gallop",
        "A horse's gallop",
        "A generated gallop (blue, at half its speed) drives a cow, a cat, a dog and a rhino-like animal. None has a "
        "rig, and no two have the same triangles. Once a stride no foot is on the ground. They carry head and tail as "
        "the horse does; the cow's tail, which hangs between its hind legs, bends little below its root.",
        tuple(_animate(name, "gallop.glb") for name in GALLOPING),
        lambda folder: _animals(folder, GALLOPING, "gallop", "driving: a horse"),
    ),
    Entry(
        "dog-walk",
        "A dog's walk",
        "The same with a dog's walk and a horse. Poses are taken over as they are: cow and rhino raise their heads as "
        "the dog does, which folds the skin of the rhino's neck.",
        tuple(_animate(name, "dog-walk.glb") for name in WALKING),
        lambda folder: _animals(folder, WALKING, "dog-walk", "driving: a dog"),
    ),
    Entry(
        "rivals",
        "Four models on one pair",
        "Distance to the true result, from grey (none) to purple (80 mm and more), and its mean. `aniformer` is made "
        "for clips and gets one frame here.",
        tuple(f"mimesh transfer inputs/stander.obj inputs/poser.obj -m {m} -o {m}.obj" for m in COMPARED_MODELS),
        _model_comparison,
    ),
    Entry(
        "failure",
        "What fails",
        "A handstand: `mime` does not find the arms and puts them along the trunk. A note warns of this result.",
        ("mimesh transfer inputs/runner.glb inputs/handstand.obj -o runner-handstand.glb",),
        _pose_panels("runner", "handstand.obj", "runner-handstand.glb", "driving: a handstand"),
    ),
)  # fmt: skip
