"""The studio's desk: how soon a file that was chosen is seen to move, and whether memory levels off.

    python benchmarks/studio.py [-o FILE]

A character as .glb and the shipped jump as .glb, with mime, one core. `first_pose_s` and `whole_clip_s` begin when both
files are on the disk. Then rounds: load both anew, change the model, change an option, export, pack the scene, remove.
Memory is that of this process, after each round.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from mimesh.bodies import load_body
from mimesh.bodies.characters import character
from mimesh.core.mesh import Clip
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import save_clip, save_mesh
from mimesh.io.atomic import whole_file
from mimesh.studio import make_desk
from mimesh.studio.session import Item, Session
from mimesh.studio.state import described, scene
from mimesh.tools.demo import played

ROUNDS = 10
LIMIT = 2**29
SHORT = 12
"""Frames of the clip in the rounds."""


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        hero, jump, short = write_inputs(Path(folder))
        report = {"commit": commit(), "machine": machine(), "libraries": libraries()}
        report |= latency(hero, jump) | memory(hero, short)
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def write_inputs(folder: Path) -> tuple[Path, Path, Path]:
    """A character, a motion, and its first frames."""
    clip = played(load_body())
    save_mesh(character("runner"), folder / "hero.glb")
    save_clip(clip, folder / "jump.glb")
    save_clip(dataclasses.replace(clip, vertices=clip.vertices[:SHORT]), folder / "short.npz")
    return folder / "hero.glb", folder / "jump.glb", folder / "short.npz"


def latency(hero: Path, jump: Path) -> dict[str, float]:
    """Measure seconds to the first pose and to the whole clip in the second run; the first run loads the networks."""
    for _ in range(2):
        desk, begin = make_desk([], LIMIT), time.perf_counter()
        item = laid(desk, hero, jump)
        driving = desk.driving
        assert driving is not None
        until(lambda item=item, driving=driving: item.content is not None and driving.content is not None)
        read = time.perf_counter() - begin
        desk.pose(item.number, 0).result()
        first = time.perf_counter() - begin
        until(lambda item=item: item.outcome is not None and item.outcome.current)
        whole = time.perf_counter() - begin
        frames = len(driving.content) if isinstance(driving.content, Clip) else 1
        begin = time.perf_counter()
        packed = scene(desk)
        pack = time.perf_counter() - begin
        desk.close()
    found = {"read_s": read, "first_pose_s": first, "whole_clip_s": whole, "scene_s": pack}
    size = len(json.dumps(packed)) / 2**20
    return {"frames": frames, **{name: round(value, 2) for name, value in found.items()}, "scene_mib": round(size, 1)}


def memory(hero: Path, short: Path) -> dict[str, list[int]]:
    """MiB of the process after each round, and the jobs and items that are kept then."""
    desk, after = make_desk([], LIMIT), []
    for _ in range(ROUNDS):
        item = laid(desk, hero, short)
        for options in ({"model": "copy"}, {"model": "mime"}, {"root": "keep"}, {"root": "scale"}):
            desk.set_options(options)
            until(lambda item=item: item.outcome is not None and (item.outcome.current or bool(item.outcome.error)))
        number = desk.export(".glb", [], True, None)
        until(lambda number=number: desk.exports[number].path is not None or bool(desk.exports[number].error))
        scene(desk)
        described(desk)
        desk.remove(item.number)
        gc.collect()
        after.append(resident())
    desk.close()
    return {"resident_mib": after}


def laid(desk: Session, hero: Path, clip: Path) -> Item:
    """Both files on the desk, as if they had been chosen."""
    desk.set_driving(clip, clip.name)
    (number,) = desk.add_identities([hero])
    return desk.identities[number]


def until(met: Callable[[], bool]) -> None:
    """Wait until the worker thread has met a condition."""
    while not met():
        time.sleep(0.002)


def resident() -> int:
    """Return the resident memory (MiB) of this process (Linux)."""
    text = Path("/proc/self/status").read_text()
    return int(text.partition("VmRSS:")[2].split()[0]) // 1024


if __name__ == "__main__":
    main()
