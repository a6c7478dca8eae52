"""Learned networks as ONNX files, run by onnxruntime: NPT and its max-pool variant.

Inputs "identity" (B, V, 3) and "driving" (B, V, 3) or, where the pose is pooled, (B, U, 3); output "result" (B, V, 3).
Each input is centred on its bounding box and divided by its largest distance from there; the result is centred on its
own bounding box, in units of the identity's radius. The file's metadata say the rest (key "mimesh").
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float32, Int

from ..frame import bbox_centre, radius
from ..geometry import edges, spatial_order
from ..mesh import InputError, Mesh
from . import Drive
from .pairing import rank_vertices, surface_points
from .travel import travelling

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

POOLED_POINTS = 8192
"""Most driving points that a pooling network is given; a denser driving mesh is thinned by the seed."""
PATCHES = 200
"""Patches of the identity's surface by which the size of a result is judged, where the network does not know it."""


@dataclass(frozen=True, eq=False)
class Network:
    """A loaded network, ready for any identity."""

    name: str
    session: InferenceSession
    pose_code: str
    """"per_vertex" (driving and identity need one count) or "global_max" (any driving count)."""
    target_scale: str
    """"identity", or "truth": then the result's size is unknown and is set by the identity's lengths (`Lengths`)."""
    ensemble: int = 1
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Mesh) -> Drive:
        """Rank both meshes and choose the driving points and their pairings, once for all frames."""
        ranked = rank_vertices(identity.vertices)
        still = ranked.merge(identity.vertices)
        pooled = self.pose_code == "global_max"
        points = surface_points(driving, 0 if pooled else len(ranked), _generator(self.seed, 0))
        taken = min(len(points), POOLED_POINTS) if pooled else len(ranked)
        # A pooled pose has no pairing to average over.
        rounds = 1 if pooled else self.ensemble
        pairings = [_generator(self.seed, 1 + k).permutation(len(points))[:taken] for k in range(rounds)]
        lengths = Lengths.of(still, edges(ranked.group[identity.faces]))

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            centred = vertices - bbox_centre(vertices)
            result = self._run(still, points.at(centred / radius(centred)), pairings)
            if self.target_scale == "truth":
                result = result * lengths.total(still) / lengths.total(result)
            return result[ranked.group]

        return lambda frames: travelling(frames, pose, driving.name)

    def _run(
        self,
        identity: Float[np.ndarray, "W 3"],
        driving: Float[np.ndarray, "P 3"],
        pairings: list[Int[np.ndarray, " N"]],
    ) -> Float[np.ndarray, "W 3"]:
        """Mean result over the pairings (float64)."""
        total = np.zeros(identity.shape)
        for pairing in pairings:
            inputs = {"identity": _batch_of_one(identity), "driving": _batch_of_one(driving[pairing])}
            total += np.asarray(self.session.run(["result"], inputs)[0])[0]
        return total / len(pairings)


def load_network(path: Path, *, name: str, ensemble: int = 1, seed: int = 0, threads: int = 2) -> Network:
    """Open an ONNX file written by `mimesh export`.

    Raises:
        InputError: no such file, not an ONNX network, or one that does not say it is ours.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected the weights of model {name}, found no file; choose another model or path")
    session = _open_session(path, threads)
    card = _card(session, path)
    return Network(name, session, card["pose_code"], card["target_scale"], ensemble, seed)


def _open_session(path: Path, threads: int) -> InferenceSession:
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as errors  # pyright: ignore[reportAttributeAccessIssue]

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3  # warnings about graph clean-up are not for users
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except (errors.Fail, errors.InvalidProtobuf, errors.InvalidGraph, errors.InvalidArgument, errors.NotImplemented):
        raise InputError(
            f"{path}: expected a network in ONNX format, found something else; write one with mimesh export"
        ) from None


def _card(session: InferenceSession, path: Path) -> dict:
    """The network's own description, checked."""
    text = session.get_modelmeta().custom_metadata_map.get("mimesh")
    if text is None:
        raise InputError(f"{path}: expected a network of mimesh, found no such metadata; write one with mimesh export")
    card = json.loads(text)
    for key, known in (("pose_code", ("per_vertex", "global_max")), ("target_scale", ("identity", "truth"))):
        if card.get(key) not in known:
            raise InputError(
                f"{path}: expected {key} {' or '.join(known)} in its metadata, found {card.get(key)!r}; "
                "export it again with this version"
            )
    return card


@dataclass(frozen=True, eq=False)
class Lengths:
    """Distances between the middles of neighbouring patches of a surface: a size that roughness hardly changes."""

    patch: Int[np.ndarray, " W"]
    pairs: Int[np.ndarray, "E 2"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "W 3"], welded_edges: Int[np.ndarray, "E 2"]) -> Lengths:
        """Up to PATCHES patches of equally many vertices, and which of them touch."""
        count, patch = min(PATCHES, len(points)), np.empty(len(points), np.int64)
        patch[spatial_order(points)] = np.arange(len(points)) * count // len(points)
        touching = np.unique(patch[welded_edges].reshape(-1, 2), axis=0)
        return cls(patch, touching[touching[:, 0] != touching[:, 1]])

    def total(self, points: Float[np.ndarray, "W 3"]) -> float:
        """Sum of the distances; 1 for a point cloud, whose size is left as it is."""
        sums = np.stack([np.bincount(self.patch, column) for column in points.T], axis=1)
        middles = sums / np.bincount(self.patch)[:, None]
        apart = np.linalg.norm(middles[self.pairs[:, 0]] - middles[self.pairs[:, 1]], axis=1)
        return float(apart.sum()) if len(apart) else 1.0


def _batch_of_one(points: Float[np.ndarray, "N 3"]) -> Float32[np.ndarray, "1 N 3"]:
    return np.ascontiguousarray(points[None], np.float32)


def _generator(seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence([seed, stream]))
