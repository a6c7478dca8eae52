"""Run methods over a protocol: resumable, with provenance, and with pictures of the worst if wanted."""

from __future__ import annotations

import contextlib
import datetime
import json
import zlib
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..io.atomic import whole_file
from ..methods.find import MODELS, TABLE_MODELS, WITHOUT_FIT, check_weights, weights_path
from .clip_protocols import ClipPair, clips_aniformer
from .cross_body import cross_body
from .measure import GIVEN, measure, measure_clip, summary
from .pairs import Pair
from .protocols import PROTOCOLS, SPLITS, Protocol
from .provenance import code_fingerprint, commit, libraries, machine

FOLDERS = ("cross-body", "clips-aniformer")
"""Protocols that read a folder."""


def evaluate_command(
    protocol: str,
    methods: list[str],
    out: Path | None = None,
    split: str = "test",
    pairs: int = 0,
    ensemble: int = 1,
    progress: Progress | None = None,
    dump: Path | None = None,
    data: Path | None = None,
    refine: bool = False,
) -> dict[str, Any]:
    """What `mimesh evaluate` does: one result row a method and kind of pair; written to `out` as JSON if given.

    With `out`, figures of finished pairs are kept beside it (`<out>.partial`) until all are there, and a run that was
    stopped goes on from them.
    """
    chosen = find_protocol(protocol, data)
    if split not in SPLITS:
        raise InputError(f"{split}: expected a split ({', '.join(SPLITS)}), found another; check the name")
    for method in methods:
        check_method(method)
    chosen.check(split)
    options = {"ensemble": ensemble, "refine": refine}
    config = {"split": split, "pairs": pairs or chosen.pairs, **options}
    if data is not None and protocol in FOLDERS:
        config["data"] = sorted(path.name for path in data.iterdir())
    made = provenance(config)
    question = {**config, "protocol": [protocol, chosen.version], "code": code_fingerprint(), **libraries()}
    ledger = PartialReport(out and out.with_name(out.name + ".partial"), question)
    counts = {kind: chosen.count(kind, pairs) for kind in chosen.kinds}
    total, done, rows = sum(counts.values()) * len(methods), 0, []
    for method in methods:
        weights = fingerprint(method)
        for kind in chosen.kinds:
            figures = []
            for i in range(counts[kind]):
                key = [method, weights, kind, i]
                known = ledger.get(key)
                figures.append(known or ledger.put(key, figures_of(chosen.pair(split, kind, i), method, options)))
                done += 1
                if progress is not None:
                    progress(done, total)
            rows.append({**summary(method, kind, figures), "weights": weights})
            if dump is not None:
                from .dump import dump_worst

                dump_worst(chosen, split, kind, method, options, figures, dump)
    report = {
        "protocol": chosen.name,
        "version": chosen.version,
        "provenance": made,
        "results": rows,
    }
    if out is not None:
        with whole_file(out) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")
        ledger.close()
    return report


def figures_of(trial: Pair, method: str, options: dict[str, Any]) -> dict[str, Any]:
    """Figures of one trial, a pair of meshes or a clip."""
    return measure_clip(trial, method, **options) if isinstance(trial, ClipPair) else measure(trial, method, **options)


class PartialReport:
    """Figures of finished pairs as JSON lines; the first line says what question they answer.

    Figures that answer another question (other pairs, code, data or libraries) are put aside as `<name>.old`.
    """

    def __init__(self, path: Path | None, question: dict[str, Any]) -> None:
        self.path, self.known = path, {}
        if path is None:
            return
        lines = list(_whole_lines(path))
        if lines and lines[0] == json.loads(json.dumps(question)):
            self.known = {json.dumps(key): figures for key, figures in lines[1:]}
        elif path.exists():
            path.replace(path.with_name(path.name + ".old"))
        kept = [question, *([json.loads(key), figures] for key, figures in self.known.items())]
        with whole_file(path) as temporary:
            temporary.write_text("".join(json.dumps(line) + "\n" for line in kept))

    def get(self, key: list) -> dict[str, Any] | None:
        """Figures of a pair, if it was finished before."""
        return self.known.get(json.dumps(key))

    def put(self, key: list, figures: dict[str, Any]) -> dict[str, Any]:
        """Keep the figures of a pair."""
        if self.path is not None:
            with self.path.open("a") as file:
                file.write(json.dumps([key, figures]) + "\n")
        return figures

    def close(self) -> None:
        """All is in the report now."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def _whole_lines(path: Path):
    for line in path.read_text().splitlines() if path.exists() else ():
        with contextlib.suppress(json.JSONDecodeError):  # cut short by a kill
            yield json.loads(line)


def find_protocol(name: str, data: Path | None = None) -> Protocol:
    """A protocol by name, `data` being the folder that those of FOLDERS read; InputError lists the ones there are."""
    if name == "cross-body":
        if data is None:
            raise InputError("cross-body: expected a folder of rigged characters, found none; give it with --data")
        return cross_body(data)
    if name == "clips-aniformer":
        return clips_aniformer(data)
    if name not in PROTOCOLS:
        known = ", ".join((*PROTOCOLS, *FOLDERS))
        raise InputError(f"{name}: expected a protocol ({known}), found another; check the name")
    return PROTOCOLS[name]


def fingerprint(method: str) -> int:
    """Of a network's weights, so that figures of others are never taken for its own; 0 for methods without."""
    path = weights_path(method)
    return zlib.crc32(path.read_bytes()) if path.suffix == ".onnx" else 0


def check_method(method: str) -> None:
    """Raise InputError, with the names there are, for a method that cannot be measured."""
    names = sorted({*GIVEN, *MODELS} - {"deformation-transfer"})
    if method not in (*names, *TABLE_MODELS, *WITHOUT_FIT) and not (
        method.endswith(".onnx") and Path(method).is_file()
    ):
        raise InputError(f"{method}: expected one of {', '.join(names)} or an .onnx file, found neither; check -m")
    check_weights(method)


def provenance(config: dict[str, Any]) -> dict[str, Any]:
    """Where and when figures were made: seed, configuration, commit, machine, libraries, date."""
    return {
        "seed": 0,
        "config": config,
        "commit": commit(),
        "machine": machine(),
        "libraries": libraries(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
