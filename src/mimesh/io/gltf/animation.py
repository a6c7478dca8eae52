"""Animations of a glTF file: what moves, and its values at any time.

Keys are read as the standard has them: STEP, LINEAR (rotations along the great arc) and CUBICSPLINE; before the first
key and after the last one a channel holds its value. Animated pointers of extensions are not read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..timing import RATES, lie_on, sample_rate, usual_rate
from .document import Document, read_floats
from .scene import inner_products, normalized_quaternions

PATH_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 0}
"""What moves, and how many numbers that is; as many as there are targets for weights."""


@dataclass(frozen=True, eq=False)
class AnimationChannel:
    """What one node's translation, rotation, scale or weights do."""

    node: int
    path: str
    times: Float[np.ndarray, " K"]
    values: Float[np.ndarray, "K C"]
    """At the keys; three times as wide with in- and out-tangents around them if cubic."""
    interpolation: str

    def sample(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T C"]:
        """The values at times in seconds."""
        width = self.values.shape[1] // (3 if self.interpolation == "CUBICSPLINE" else 1)
        middle = slice(width, 2 * width) if self.interpolation == "CUBICSPLINE" else slice(0, width)
        after = np.searchsorted(self.times, times, side="right")
        values = self.values[np.minimum(after, len(self.times) - 1), middle]
        inside = (after > 0) & (after < len(self.times))
        values[inside] = self._interpolate(after[inside], times[inside], middle)
        return normalized_quaternions(values) if self.path == "rotation" else values

    def _interpolate(
        self, after: Int[np.ndarray, " T"], times: Float[np.ndarray, " T"], middle: slice
    ) -> Float[np.ndarray, "T C"]:
        a, b = self.values[after - 1], self.values[after]
        if self.interpolation == "STEP":
            return a[:, middle]
        span = (self.times[after] - self.times[after - 1])[:, None]
        s = (times - self.times[after - 1])[:, None] / span
        if self.interpolation == "CUBICSPLINE":
            width = middle.stop - middle.start
            leaving, arriving = span * a[:, 2 * width :], span * b[:, :width]
            hermite = (2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2)
            return hermite[0] * a[:, middle] + hermite[1] * leaving + hermite[2] * b[:, middle] + hermite[3] * arriving
        return _slerp(a, b, s) if self.path == "rotation" else (1 - s) * a + s * b


def animation_names(document: Document) -> tuple[str, ...]:
    """Of all animations, by their numbers where they have no name."""
    return tuple(str(entry.get("name") or i) for i, entry in enumerate(document.gltf.get("animations", [])))


def document_details(document: Document) -> tuple[tuple[str, str], ...]:
    """Unit, joints of the skins, blend shapes and length of the animations, as text; only what there is."""
    gltf = document.gltf
    found = [("unit", "metre, y up (all glTF files)")]
    if skins := [len(skin["joints"]) for skin in gltf.get("skins", [])]:
        found.append(("skins", f"{len(skins)}, of {', '.join(map(str, skins))} joints"))
    shapes = [
        max((len(primitive.get("targets", [])) for primitive in mesh["primitives"]), default=0)
        for mesh in gltf.get("meshes", [])
    ]
    if any(shapes):
        found.append(("blend shapes", ", ".join(str(count) for count in shapes if count)))
    for number, name in enumerate(animation_names(document)):
        times = [channel.times[-1] for channel in read_channels(document, number)]
        found.append(("animation", f"{name}, {max(times, default=0.0):.2f} s"))
    return tuple(found)


def find_animation(document: Document, wanted: str) -> int:
    """Number of the animation of a name or number.

    Raises:
        InputError: there is none of that name, with the names there are.
    """
    names = animation_names(document)
    if wanted in names:
        return names.index(wanted)
    endings = [i for i, name in enumerate(names) if name.rpartition("|")[2] == wanted]
    if len(endings) == 1:
        return endings[0]
    if wanted.isdecimal() and int(wanted) < len(names):
        return int(wanted)
    raise InputError(
        f"{document.path}: expected one of its animations ({', '.join(names) or 'it has none'}), found {wanted!r}; "
        "check --animation"
    )


def read_channels(document: Document, animation: int) -> list[AnimationChannel]:
    """What moves in an animation; channels of extensions and of nodes that are not named are left out.

    Raises:
        InputError: keys without values, times that do not rise, an interpolation that is not of the standard.
    """
    found = []
    try:
        entry = document.gltf["animations"][animation]
        for channel in entry["channels"]:
            target = channel["target"]
            if target["path"] in PATH_WIDTHS and target.get("node") is not None:
                found.append(_read_channel(document, target, entry["samplers"][channel["sampler"]]))
    except (KeyError, IndexError, TypeError) as error:
        raise InputError(
            f"{document.path}: expected channels with samplers in animation {animation}, found a gap ({error!r}); "
            "the file is damaged, export it again"
        ) from error
    return found


def select_channels(document: Document, wanted: str | None) -> list[AnimationChannel]:
    """What moves in the animation of a name or number; if none is wanted, in the first and in all that go with it.

    With it go, in order, those that move nothing which is moved already: exporters that write an animation for each
    object mean them all at once, while other ways for the same joints to move are there to choose from.

    Raises:
        InputError: as `find_animation` and `read_channels`.
    """
    if wanted is not None:
        return read_channels(document, find_animation(document, wanted))
    chosen: list[AnimationChannel] = []
    for number in range(len(document.gltf.get("animations", []))):
        moved = {(channel.node, channel.path) for channel in chosen}
        channels = read_channels(document, number)
        if not any((channel.node, channel.path) in moved for channel in channels):
            chosen += channels
    return chosen


def frame_rate(channels: list[AnimationChannel]) -> float | None:
    """The frames a second whose frames all keys lie on; None if they lie on those of no usual rate.

    Keys as close and even as frames are the frames. Sparser ones are a curve, of which frames lie in between.
    """
    times = np.unique(np.concatenate([channel.times for channel in channels] or [np.zeros(0)]))
    rate = sample_rate(times)
    if rate is not None and rate >= min(RATES) and lie_on(times, rate):
        return rate
    return usual_rate(times)


def _read_channel(document: Document, target: dict[str, Any], sampler: dict[str, Any]) -> AnimationChannel:
    times, values = (read_floats(document, sampler[key]) for key in ("input", "output"))
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("STEP", "LINEAR", "CUBICSPLINE"):
        raise InputError(
            f"{document.path}: expected keys of STEP, LINEAR or CUBICSPLINE, found {interpolation}; export it again"
        )
    times = times[:, 0]
    keys = len(times)
    per_key = values.size // keys if keys else 0
    cubic = 3 if interpolation == "CUBICSPLINE" else 1
    fits = per_key == cubic * PATH_WIDTHS[target["path"]] or (
        target["path"] == "weights" and per_key and not per_key % cubic
    )
    known = 0 <= target["node"] < len(document.gltf.get("nodes", []))
    if not (fits and known and values.size == keys * per_key and (np.diff(times) > 0).all()):
        raise InputError(
            f"{document.path}: expected rising times with a value each, found {keys} times and {values.size} numbers; "
            "the file is damaged, export it again"
        )
    return AnimationChannel(target["node"], target["path"], times, values.reshape(keys, per_key), interpolation)


def _slerp(
    a: Float[np.ndarray, "T 4"], b: Float[np.ndarray, "T 4"], s: Float[np.ndarray, "T 1"]
) -> Float[np.ndarray, "T 4"]:
    """Along the shorter arc between unit quaternions; between near ones along the chord."""
    cosine = inner_products(a, b)
    b, cosine = np.where(cosine < 0, -b, b), np.abs(cosine)
    values = (1 - s) * a + s * b
    far = cosine[:, 0] <= 0.9995
    angle, s = np.arccos(cosine[far]), s[far]
    values[far] = (np.sin((1 - s) * angle) * a[far] + np.sin(s * angle) * b[far]) / np.sin(angle)
    return values
