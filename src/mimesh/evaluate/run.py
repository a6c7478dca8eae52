"""Measure methods on a protocol: a resumable run, a report with provenance, and pictures of the worst pairs."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import hashlib
import json
import re
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError, did_you_mean
from ..core.frame_buffer import Progress
from ..core.options import MeasureOptions
from ..io.atomic import whole_file
from ..methods.find import (
    INDEX_PAIRED,
    MODELS,
    NETWORK_OF_BODY,
    REDUCED_MODELS,
    TABLE_MODELS,
    check_weights,
    find_model,
    is_table_model,
    weights_path,
)
from .characters import Characters, characters, cross_body
from .clip_protocols import CLIPS_ANIFORMER, CLIPS_ORDERED, ClipPair
from .frozen_sets import frozen_sets, pair_checksum, role, set_checksum
from .listed_pairs import ListedPairs, files_below, listed_pairs
from .markdown import summary
from .measure import EXTRA_INPUTS, Runtime, measure, open_network, run_on, weights_checksum
from .metrics import VERSION, pmd
from .pairs import Pair
from .protocols import PROTOCOLS, QUADRUPED, SPLITS, Protocol
from .provenance import commit, libraries, machine
from .rigs import RiggedPeople, RigTrial, measure_rig, rig_comparison, rigs

if TYPE_CHECKING:
    from PIL import Image

WITHOUT_FOLDER: dict[str, Protocol] = {
    **PROTOCOLS,
    **{protocol.name: protocol for protocol in (CLIPS_ANIFORMER, CLIPS_ORDERED, QUADRUPED)},
}
"""Protocols that need no folder."""
READ_A_FOLDER: dict[str, tuple[Callable[[Any], Protocol], str]] = {
    "cross-body": (cross_body, "a folder of rigged characters"),
    "characters": (characters, "the folder of a pool of rigged characters"),
    "rigs": (rigs, "a folder of rigged people"),
}
"""Name -> function that makes the protocol from its folder, and what the folder is."""
FOLDERS = tuple(READ_A_FOLDER)
"""Names of the protocols that read a folder."""

USUAL = MeasureOptions()


def evaluate_command(
    protocol: str,
    methods: list[str],
    out: Path | None = None,
    split: str = "test",
    pairs: int = 0,
    measuring: MeasureOptions = USUAL,
    progress: Progress | None = None,
    dump: Path | None = None,
    data: Path | None = None,
    runtime: Runtime | None = None,
    runtime_name: str = "",
) -> dict[str, Any]:
    """Measure methods on a protocol (`mimesh evaluate`) and return the report: one row per method and kind of pair.

    With `out` the report is also written as JSON, with the rows that one of this name has of other methods. The metrics
    of finished pairs are stored next to it (`<out>.partial`) until the report is complete, so that an interrupted run
    can be continued: with the same commit of the code, without changes to it, and for methods whose weights are the
    same.

    Args:
        protocol: a name, or the path of a list of files or of a folder of lists (`listed_pairs`).
        pairs: number of pairs of each kind; 0 for the protocol's own.
        dump: folder for pictures of the worst pairs.
        data: folder of a protocol that reads one, or that the names of a list are relative to.
        runtime: what runs networks instead of onnxruntime, with its name for the report; not for characters.

    Raises:
        InputError: an unknown protocol, split or method, no method, or missing data.
    """
    chosen = find_protocol(protocol, data, measuring.height, measuring.fps)
    if split not in SPLITS:
        close = did_you_mean(split, SPLITS) or "; check the name"
        raise InputError(f"{split}: expected a split ({', '.join(SPLITS)}), found another{close}")
    if not methods:
        raise InputError("--model: expected one model or more, with commas between, found none; name some")
    methods = list(dict.fromkeys(methods))
    for method in methods:
        names = sorted({*EXTRA_INPUTS, *MODELS, *NETWORK_OF_BODY.values()} - {"deformation-transfer"})
        named = method in (*names, *REDUCED_MODELS, *INDEX_PAIRED.values()) or is_table_model(method)
        if not named and not (method.endswith(".onnx") and Path(method).is_file()):
            close = did_you_mean(method, [*names, *TABLE_MODELS]) or "; check -m"
            if method.endswith(".safetensors"):
                close = f"; mimesh export {method} -o NAME.onnx makes one"
            raise InputError(f"{method}: expected one of {', '.join(names)} or an .onnx file, found neither{close}")
        check_weights(method)
    chosen.check(split)
    if dump is not None and chosen.name in ("characters", "rigs") and split == "test":
        raise InputError("--dump: expected the split val or train of characters, found test, which nobody looks at; "
                         "give --split val")  # fmt: skip
    if runtime and isinstance(chosen, Characters | RiggedPeople):
        raise InputError(f"--torch: expected a test set of meshes or clips, found {protocol}; leave it out")
    for method in filter(fingerprint, methods if runtime else ()):
        open_network(method, measuring.ensemble, runtime)  # later, it would be a failure of every pair
    options: dict[str, Any] = {"ensemble": measuring.ensemble, "refine": measuring.refine}
    config = {**data_facts(chosen, split, data), "pairs": pairs or chosen.pairs, **options}
    if runtime:
        options |= {"runtime": runtime}
        config |= {"runtime": runtime_name}
    made, before = provenance(config), {}
    question = {**config, "protocol": settings(chosen), "metrics": VERSION, "machine": machine(), **libraries()}
    question["commit"] = made["commit"]
    if out is not None:
        before = report_before(out, chosen.name, config)
    ledger = PartialReport(out and out.with_name(out.name + ".partial"), question)
    counts = {kind: chosen.count(kind, pairs, split) for kind in chosen.kinds}
    total, done, rows, sets = sum(counts.values()) * len(methods), 0, [], {}
    for method in methods:
        weights = fingerprint(method)
        for kind in chosen.kinds:
            figures = []
            for i in range(counts[kind]):
                key = [method, weights, kind, i]
                if (metrics := ledger.get(key)) is None:
                    metrics = ledger.put(key, measure_trial(chosen, chosen.pair(split, kind, i), method, options))
                figures.append(metrics)
                done += 1
                if progress is not None:
                    progress(done, total)
            rows.append({**summary(method, kind, figures, chosen.body), "weights": weights})
            if kind not in sets:  # every method gets the same pairs
                sets[kind] = set_facts(chosen, split, kind, [metrics["pair"] for metrics in figures])
            if dump is not None:
                dump_worst(chosen, split, kind, method, options, figures, dump)
    report = {
        "protocol": chosen.name,
        "version": chosen.version,
        "metrics": VERSION,
        "provenance": made,
        "sets": sets,
        "left_out": chosen.left_out(split),
        "results": rows,
    }
    report["results"] += rows_kept(before, report)
    if out is not None:
        with whole_file(out) as temporary:
            temporary.write_text(report_text(report), encoding="utf-8", newline="\n")
        ledger.close()
    return report


def report_before(out: Path, protocol: str, config: dict[str, Any]) -> dict[str, Any]:
    """Read the report that is to be replaced; {} if there is none.

    Raises:
        InputError: it is none of the same test set and options.
    """
    if not out.exists():
        return {}
    try:
        before = json.loads(out.read_text())
        there = {"protocol": before["protocol"], **before["provenance"]["config"]}
    except (OSError, ValueError, KeyError, TypeError):
        before, there = {}, {}
    here = {"protocol": protocol, **json.loads(json.dumps(config))}
    if there != here:
        names = [name for name in dict.fromkeys((*here, *there)) if here.get(name) != there.get(name)]
        found = f"one of other {', '.join(names)}" if there else "another"
        raise InputError(
            f"{out}: expected no file, or a report of the same test set and options, found {found}; choose another name"
        )
    return before


def rows_kept(before: dict[str, Any], report: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of other methods than those of a new report, with their "origin": commit, machine and date.

    Those of other pairs or another version of the metrics are left out.
    """

    def measured_on(of: dict[str, Any]) -> tuple[int, list[str]]:
        return of["metrics"], [facts["sha256"] for facts in of["sets"].values()]

    if not before or measured_on(before) != measured_on(report):
        return []
    origin = {name: before["provenance"][name] for name in ("commit", "machine", "date")}
    measured = {row["method"] for row in report["results"]}
    return [{"origin": origin} | row for row in before["results"] if row["method"] not in measured]


def report_text(report: dict[str, Any]) -> str:
    """Format a report as indented JSON, with one line for each list of figures."""
    text = json.dumps(report, indent=2)
    # Innermost lists: no brackets inside, spread over lines by `indent`. Line breaks in strings are escaped.
    return re.sub(r"\[\n[^\[\]{}]*\]", _on_one_line, text) + "\n"


def _on_one_line(found: re.Match[str]) -> str:
    return re.sub(r"\n\s*", "", re.sub(r",\n\s*", ", ", found[0]))


def measure_trial(protocol: Protocol, trial: Pair, method: str, options: dict[str, Any]) -> dict[str, Any]:
    """Measure a method on one trial, a pair of meshes or a clip, and return its metrics with what identifies it."""
    labels = {"pair": pair_checksum(trial), "identity": trial.groups[0], "driving": trial.groups[1]}
    if isinstance(trial, RigTrial):
        return labels | measure_rig(trial, method)
    return labels | measure(trial, method, **options)


class PartialReport:
    """Metrics of finished pairs, stored as JSON lines below a first line with everything that determines them.

    A file of other pairs, data, libraries or code is renamed to `<name>.old`, and so is one of uncommitted code.
    """

    def __init__(self, path: Path | None, question: dict[str, Any]) -> None:
        self.path, self.metrics = path, {}
        if path is None:
            return
        lines = list(_whole_lines(path))
        dirty = question["commit"].endswith("-dirty")
        same = bool(lines) and not dirty and lines[0] == json.loads(json.dumps(question))
        self.metrics = {json.dumps(key): figures for key, figures in lines[1:] if same}
        if path.exists() and not same:
            path.replace(path.with_name(path.name + ".old"))
        valid = [question, *([json.loads(key), figures] for key, figures in self.metrics.items())]
        with whole_file(path) as temporary:
            temporary.write_text("".join(json.dumps(line) + "\n" for line in valid), encoding="utf-8", newline="\n")

    def get(self, key: list) -> dict[str, Any] | None:
        """Return the metrics of a pair; None if it has not been measured yet."""
        return self.metrics.get(json.dumps(key))

    def put(self, key: list, figures: dict[str, Any]) -> dict[str, Any]:
        """Store the metrics of a pair and return them."""
        if self.path is not None:
            with self.path.open("a") as file:
                file.write(json.dumps([key, figures]) + "\n")
        return figures

    def close(self) -> None:
        """Delete the file, once the report is written."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def _whole_lines(path: Path):
    for line in path.read_text().splitlines() if path.exists() else ():
        with contextlib.suppress(json.JSONDecodeError):  # cut off when the process was killed
            yield json.loads(line)


def set_facts(protocol: Protocol, split: str, kind: str, pairs: list[str]) -> dict[str, Any]:
    """Return the role and the checksum of a set of pairs, and how it compares with the one of `frozen_sets`."""
    if isinstance(protocol, ListedPairs):
        return {"role": "own files", "sha256": set_checksum(pairs), "frozen": "unknown"}
    stored = frozen_sets().get((protocol.name, split, kind))
    frozen = "unknown" if stored is None else stored.compare(pairs)
    return {"role": role(protocol.name, split, kind), "sha256": set_checksum(pairs), "frozen": frozen}


def data_facts(protocol: Protocol, split: str, data: Path | None) -> dict[str, Any]:
    """Return the split, or the checksums of a protocol's lists, and a checksum of the files it reads, if any."""
    if isinstance(protocol, ListedPairs):
        return {"lists": protocol.checksums(), "data": files_checksum(protocol.files())}
    facts: dict[str, Any] = {"split": split}
    if data is not None and protocol.name in FOLDERS:
        files = files_below(data)
        if not files:
            raise InputError(f"{data}: expected a folder with files, found none; check --data")
        facts["data"] = files_checksum({str(path.relative_to(data)): path for path in files})
    return facts


def files_checksum(files: Mapping[str, Path]) -> str:
    """Return the number of some files, and the first 16 hex digits of a SHA-256 over their names and contents."""
    digest = hashlib.sha256()
    for name, path in files.items():
        digest.update(f"{name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
    return f"{len(files)} files, sha256 {digest.hexdigest()[:16]}"


def find_protocol(
    name: str, data: Path | None = None, height: float | None = None, fps: float | None = None
) -> Protocol:
    """Return a protocol by name, or the pairs of a list of files by its path (`listed_pairs`).

    `data` is the folder that those of FOLDERS read, or that of a list's files.

    Raises:
        InputError: no such protocol or list, no folder where one is needed, or an option that has no effect.
    """
    if name not in (*WITHOUT_FOLDER, *FOLDERS) and Path(name).exists():
        return listed_pairs(Path(name), data, height, fps)
    for option, value in (("--height", height), ("--fps", fps)):
        if value is not None:
            raise InputError(f"{option}: expected it with a list of files, found the protocol {name}; leave it out")
    if name in READ_A_FOLDER:
        read, folder = READ_A_FOLDER[name]
        if data is None:
            raise InputError(f"{name}: expected {folder}, found none; give it with --data")
        return read(data)
    if name not in WITHOUT_FOLDER:
        known = ", ".join((*WITHOUT_FOLDER, *FOLDERS))
        close = did_you_mean(name, (*WITHOUT_FOLDER, *FOLDERS)) or "; check the name"
        raise InputError(f"{name}: expected a protocol ({known}) or the path of a list, found neither{close}")
    if data is not None:
        raise InputError(f"--data: expected none with {name}, which reads no folder, found {data}; leave it out")
    return WITHOUT_FOLDER[name]


def settings(protocol: Protocol) -> dict[str, Any]:
    """Return what a protocol is set to, but for the folder it reads."""
    values = {field.name: getattr(protocol, field.name) for field in dataclasses.fields(protocol)}
    return {name: value for name, value in values.items() if not isinstance(value, Path)}


def fingerprint(method: str) -> int:
    """Return a checksum of a method's weights, which ties metrics to these weights; 0 for methods without weights.

    Of a method that uses the network of hands, the weights of that are part of it.
    """
    from ..methods.onnx_models import hands_path

    path = weights_path(method)
    if path.suffix != ".onnx":
        return 0
    checksum = weights_checksum(path)
    uses_hands = getattr(find_model(method), "hands", None) is not None
    return zlib.crc32(hands_path().read_bytes(), checksum) if uses_hands else checksum


def provenance(config: dict[str, Any]) -> dict[str, Any]:
    """Return where and when metrics were measured: seed, configuration, commit, machine, libraries, date."""
    return {
        "seed": 0,
        "config": config,
        "commit": commit(),
        "machine": machine(),
        "libraries": libraries(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


WORST_BY = ("pmd_e4", "limb_deg", "joints_pct")
"""Metrics by which results are the worst, the first that a trial has."""
WORST = 3
"""Number of pairs of each method and kind that are drawn."""


def dump_worst(
    protocol: Protocol,
    split: str,
    kind: str,
    method: str,
    options: dict[str, Any],
    figures: list[dict[str, Any]],
    folder: Path,
) -> list[Path]:
    """Draw the WORST pairs as `<folder>/<method>-<kind>-<rank>.png` and return the paths.

    Means do not show them. The worst have the largest PMD or, where no true mesh is known, the largest angle between
    limbs. Of rigs their joints are farthest from the maker's.
    """
    measured = {i: [metrics[by] for by in WORST_BY if metrics.get(by) is not None] for i, metrics in enumerate(figures)}
    errors = {i: known[0] for i, known in measured.items() if known}
    worst = sorted(errors, key=errors.__getitem__, reverse=True)[:WORST]
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for rank, i in enumerate(worst, 1):
        pair = protocol.pair(split, kind, i)
        path = folder / f"{Path(method).stem}-{kind}-{rank}.png"
        picture = rig_comparison(pair, method) if isinstance(pair, RigTrial) else None
        (picture or trial_picture(*_to_draw(pair, method, options))).save(path)
        paths.append(path)
    return paths


def _to_draw(pair: Pair, method: str, options: dict[str, Any]) -> tuple[Pair, Float[np.ndarray, "V 3"]]:
    """Return a pair and the method's result beside its truth; for a clip, those of the frame with the largest PMD."""
    if not isinstance(pair, ClipPair):
        return pair, run_on(pair, method, **options).beside(pair.truth)
    frames = run_on(pair, method, **options).beside(pair.truth_frames)
    worst = int(np.argmax([pmd(a, b) for a, b in zip(frames, pair.truth_frames, strict=True)]))
    return pair.frame(worst), frames[worst]


def trial_picture(pair: Pair, result: Float[np.ndarray, "V 3"]) -> Image.Image:
    """Draw identity, driving, result and truth in a row, above the result's heat map (mm for a person of 1.7 m).

    The result lies where it is compared with the truth.

    Without a true mesh, the first three are drawn.
    """
    from ..view.heat import heat_map
    from ..view.sheet import stack, transfer_sheet

    scale = 1.7 / pair.height
    shown, truth = (dataclasses.replace(pair.identity, vertices=scale * points) for points in (result, pair.truth))
    if not pair.truth_known:
        return transfer_sheet(pair.identity, pair.driving, shown)
    return stack([transfer_sheet(pair.identity, pair.driving, shown, truth), heat_map(shown, truth)])
