"""The studio without a browser: seconds until a chosen file is posed and moved, and whether memory levels off.

    python benchmarks/studio.py [-o FILE]

A character as .glb and the shipped jump as .glb, with mime, one core. `first_pose_s` and `whole_clip_s` begin when both
files are on the disk. Then rounds: load both files, change the model, change an option, export, pack the scene, remove.
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
from mimesh.studio import make_session
from mimesh.studio.exports import Order
from mimesh.studio.items import Item
from mimesh.studio.session import Session
from mimesh.studio.state import describe, scene
from mimesh.tools.demo import driving_clip

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
    """Write a character, a motion and its first frames, and return their paths."""
    clip = driving_clip(load_body())
    save_mesh(character("runner"), folder / "hero.glb")
    save_clip(clip, folder / "jump.glb")
    save_clip(dataclasses.replace(clip, vertices=clip.vertices[:SHORT]), folder / "short.npz")
    return folder / "hero.glb", folder / "jump.glb", folder / "short.npz"


def latency(hero: Path, jump: Path) -> dict[str, float]:
    """Measure seconds to the first pose and to the whole clip in the second run; the first run loads the networks."""
    report: dict[str, float] = {}
    for _ in range(2):
        session, begin = make_session([], LIMIT), time.perf_counter()
        item = add_files(session, hero, jump)
        driving = session.driving
        assert driving is not None
        until(lambda item=item, driving=driving: item.content is not None and driving.content is not None)
        read = time.perf_counter() - begin
        session.pose(item.number, 0).result()
        first = time.perf_counter() - begin
        until(lambda item=item: item.outcome is not None and item.outcome.current)
        whole = time.perf_counter() - begin
        frames = len(driving.content) if isinstance(driving.content, Clip) else 1
        begin = time.perf_counter()
        packed = scene(session)
        pack = time.perf_counter() - begin
        session.close()
        found = {"read_s": read, "first_pose_s": first, "whole_clip_s": whole, "scene_s": pack}
        size = len(json.dumps(packed)) / 2**20
        report = {name: round(value, 2) for name, value in found.items()}
        report |= {"frames": frames, "scene_mib": round(size, 1)}
    return report


def memory(hero: Path, short: Path) -> dict[str, list[int]]:
    """Return the memory (MiB) of this process after each round."""
    session, after = make_session([], LIMIT), []
    for _ in range(ROUNDS):
        item = add_files(session, hero, short)
        for options in ({"model": "copy"}, {"model": "mime"}, {"root": "keep"}, {"root": "scale"}):
            session.set_options(options)
            until(lambda item=item: item.outcome is not None and (item.outcome.current or bool(item.outcome.error)))
        number = session.export(Order(skinned=True))
        until(lambda number=number: session.exports[number].path is not None or bool(session.exports[number].error))
        scene(session)
        describe(session)
        session.remove(item.number)
        gc.collect()
        after.append(resident())
    session.close()
    return {"resident_mib": after}


def add_files(session: Session, hero: Path, clip: Path) -> Item:
    """Add both files to the session, as if they had been chosen on the page."""
    session.set_driving(clip, clip.name)
    (number,) = session.add_identities([hero])
    return session.identities[number]


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
