"""Measure retargeting on characters' own rigs: every chosen character with clips of other makers.

    python research/measure_rigs.py POOL --motions FILE ... [-o docs/rigs.json] [--characters 40] [--clips 20]
    python research/measure_rigs.py --own FILE ... [-o docs/rigs.json]
    python research/measure_rigs.py POOL --unnamed [-o docs/rigs.json]

The second form plays the own clips of files through `mimesh animate` and compares the written files with them: the
motion, and all else that was in the files (`research/own_rigs.py`). The third hides the names of the joints of all
characters of the pool and finds them again (`research/unnamed_rigs.py`). Each form leaves the figures of the others.

POOL is a pool of rigged characters; those of its splits train and val are used. FILEs are motions without a mesh: .bvh,
or .glb with animations of joints. Figures: `research/retargets.py`. "copied rotations" is what users do by hand with
constraints: each joint gets the rotation of its namesake, rest poses are not calibrated.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

from own_rigs import is_compressed, lost_content, playback_error
from retargets import (
    METRICS,
    Actor,
    choose_characters,
    copy_rotations,
    measure,
    motion_actors,
    pool_actor,
    retarget,
    summary,
    write_pool,
)
from unnamed_rigs import match_character, summarise_matches

from mimesh.__main__ import run
from mimesh.bodies.character_pool import PoolCharacter, read_pool
from mimesh.commands.terminal import progress
from mimesh.core.mesh import cut_clip
from mimesh.evaluate.limb_metrics import LimbedCharacter
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import load_mesh
from mimesh.io.atomic import whole_file
from mimesh.io.gltf.animation import animated_nodes, animation_names
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.motion import PLAYED_PATHS, gltf_joints, is_motion
from mimesh.pipeline.gltf_rigs import UNNAMED, rig_facts

MOST_FRAMES = 150
"""Longer motions are cut to so many frames, in the middle."""
CLIPS_OF_A_CHARACTER = 3
"""Clips of each character of the pool that others imitate."""


def main() -> None:
    """Measure all pairs and write the report; a pair that raises an exception is counted and named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path, nargs="?")
    parser.add_argument("--own", type=Path, nargs="+", metavar="FILE", help="files whose own clips are played")
    parser.add_argument("--unnamed", action="store_true", help="find the joints of the pool without their names")
    parser.add_argument("--motions", type=Path, nargs="+", default=[], metavar="FILE")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/rigs.json"))
    parser.add_argument("--characters", type=int, default=40)
    parser.add_argument("--clips", type=int, default=20)
    args = parser.parse_args()
    if args.own:
        measure_own(args.own, args.output)
        return
    if args.pool is None:
        parser.error("expected POOL or --own, found neither")
    pool = [character for split in ("train", "val") for character in read_pool(args.pool, split).characters]
    if args.unnamed:
        measure_unnamed(pool, args.output)
        return
    chosen = choose_characters(tuple(pool), args.characters)
    with tempfile.TemporaryDirectory() as folder:
        players = choose_characters(tuple(c for c in pool if c.clips), 8)
        paths = write_pool([*{c.meta.file: c for c in (*chosen, *players)}.values()], Path(folder))
        actors = [pool_actor(c, paths[c.meta.file], clip) for c in players for clip in _spread(list(c.clips))]
        actors += [actor for path in args.motions for actor in _motions(path)]
        pairs: list[dict[str, Any]] = []
        with progress("pairs", quiet=False) as advance:
            for k, character in enumerate(chosen):
                others = [actor for actor in actors if actor.maker != character.meta.maker]
                mesh = load_mesh(paths[character.meta.file])
                limbed = LimbedCharacter(character.rig, character.limbs)
                for actor in _alternating(others)[: args.clips]:
                    pairs.append(_measure_pair(mesh, limbed, actor) | {"pack": character.meta.pack})
                if advance is not None:
                    advance(k + 1, len(chosen))
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "characters": len(chosen)}
    report |= {"clips": args.clips, "pairs": len(pairs), "failed": [pair for pair in pairs if "error" in pair]}
    report |= {"upside_down": sum((pair.get("upright") or 1.0) < 0 for pair in pairs), "results": _table(pairs)}
    _update(args.output, report | {"figures": pairs})
    print(json.dumps({key: report[key] for key in ("pairs", "failed", "upside_down", "results")}, indent=2))


def measure_unnamed(pool: list[PoolCharacter], output: Path) -> None:
    """Find the joints of all characters without their names, and add the figures to the report."""
    rows = []
    with tempfile.TemporaryDirectory() as folder, progress("characters", quiet=False) as advance:
        for k, character in enumerate(pool):
            rows.append(match_character(character, Path(folder)))
            if advance is not None:
                advance(k + 1, len(pool))
    report = {"commit": commit(), "machine": machine(), "results": summarise_matches(rows), "characters": rows}
    _update(output, {"unnamed": report})
    print(json.dumps(report["results"], indent=2))


def measure_own(paths: list[Path], output: Path) -> None:
    """Play the own clips of files with the command, compare what is written, and add the figures to the report."""
    rows = []
    for path in paths:
        rows.append(_own_row(path))
        print(json.dumps(rows[-1]), flush=True)
    _update(output, {"own": {"commit": commit(), "machine": machine(), "files": rows}})


def _own_row(path: Path) -> dict[str, Any]:
    """Compare one file with what the command writes from it and its own clips."""
    document = open_document(path)
    names = animation_names(document)
    row: dict[str, Any] = {"file": path.name, "clips": len(names), "error": None, "failed": []}
    if is_motion(document):
        return row | {"joints": gltf_joints(document), "person": False, "reason": "animations without a mesh"}
    rig = rig_facts(load_mesh(path))
    text = "" if rig is None else rig.text
    named = rig is not None and rig.used and text != UNNAMED
    joints = {joint for skin in document.gltf.get("skins", []) for joint in skin["joints"]}
    row |= {"joints": len(joints or animated_nodes(document, PLAYED_PATHS)), "person": named}
    row["reason"] = "" if named else text.removeprefix(f"{path}: ")
    errors, lost, is_fbx = [], set(), path.suffix.lower() == ".fbx"
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "written.glb"
        for animation in [str(number) for number in range(len(names))] or [None]:
            chosen = [] if animation is None else ["--animation", animation]
            words = ["animate", str(path), str(path), "-o", str(written), *chosen, "-q", "--no-preview"]
            if run(words):
                row["failed"].append(animation)
                continue
            errors.append(playback_error(path, animation, written))
            lost |= set() if is_fbx else set(lost_content(path, written))
    row["error"] = max(errors, default=None)
    return row | ({} if is_fbx else {"compressed": is_compressed(path), "lost": sorted(lost)})


def _update(output: Path, report: dict[str, Any]) -> None:
    """Write a report in place of an older one; parts that only that has are kept."""
    old = json.loads(output.read_text()) if output.is_file() else {}
    with whole_file(output) as temporary:
        temporary.write_text(_layout(old | report) + "\n")


def _layout(value: Any, indent: str = "") -> str:
    """Write JSON with a line for each entry of a list, such as a pair of files, and for each group of figures."""
    inner = indent + " "
    if isinstance(value, dict) and any(isinstance(entry, (dict, list)) for entry in value.values()):
        lines = [f"{inner}{json.dumps(key)}: {_layout(entry, inner)}" for key, entry in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        return "[\n" + ",\n".join(inner + json.dumps(entry) for entry in value) + f"\n{indent}]"
    return json.dumps(value)


def _measure_pair(mesh, limbed: LimbedCharacter, actor: Actor) -> dict[str, Any]:
    """Measure one pair, with the tool and with rotations copied by hand; an exception is part of the figures."""
    row: dict[str, Any] = {"identity": mesh.name, "driving": actor.name}
    begin = time.perf_counter()
    try:
        result = retarget(mesh, actor)
        row |= {"own": result.own is not None, "notes": list(result.notes), "seconds": time.perf_counter() - begin}
        row |= measure(result, limbed, actor)
        by_hand = copy_rotations(mesh, actor)
        return row | ({} if by_hand is None else {"copied rotations": measure(by_hand, limbed, actor)})
    except Exception as error:  # that there is none is what is measured
        return row | {"error": repr(error)}


def _motions(path: Path) -> list[Actor]:
    """Read motions without a mesh; of several animations in a file a few, evenly spread."""
    names = animation_names(open_document(path)) if path.suffix.lower() in (".glb", ".gltf") else ()
    actors = list(motion_actors(path, path.stem, _spread(list(names)) or None))
    cut = [(max(len(actor.clip) - MOST_FRAMES, 0) // 2, actor) for actor in actors]
    return [Actor(a.name, a.maker, cut_clip(a.clip, start, start + MOST_FRAMES, 1), a.limbed) for start, a in cut]


def _spread(names: list[str]) -> list[str]:
    """Choose CLIPS_OF_A_CHARACTER names, evenly spread."""
    count = min(CLIPS_OF_A_CHARACTER, len(names))
    return [names[k * (len(names) - 1) // max(count - 1, 1)] for k in range(count)]


def _alternating(actors: list[Actor]) -> list[Actor]:
    """Order clips so that those of each maker come in turn."""
    by_maker: dict[str, list[Actor]] = {}
    for actor in actors:
        by_maker.setdefault(actor.maker, []).append(actor)
    longest = max(map(len, by_maker.values()), default=0)
    return [some[k] for k in range(longest) for some in by_maker.values() if k < len(some)]


def _table(pairs: list[dict[str, Any]]) -> dict[str, dict[str, dict[str, float]]]:
    """Summarise the figures by pack, of all, and of rotations copied by hand beside the tool on the same pairs."""
    by_hand = [pair for pair in pairs if "copied rotations" in pair]
    groups = {"all": pairs, **{pack: [p for p in pairs if p["pack"] == pack] for pack in {p["pack"] for p in pairs}}}
    groups |= {"clips with a rig": by_hand, "copied rotations": [pair["copied rotations"] for pair in by_hand]}
    keys = (*METRICS, "skate", "skate_driving", "seconds")
    return {
        name: {key: summary(values) for key in keys if (values := [p[key] for p in rows if p.get(key) is not None])}
        for name, rows in groups.items()
    }


if __name__ == "__main__":
    main()
