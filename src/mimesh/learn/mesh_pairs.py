"""Batches and validation pairs from the registered meshes or clips of a folder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from ..core.mesh import Clip, Mesh, permute_vertices
from ..evaluate.clip_protocols import ClipPair
from ..evaluate.pairs import Pair
from ..evaluate.protocols import Protocol
from .body_sampler import DataConfig
from .mesh_triples import Triples
from .registered_meshes import RegisteredMeshes
from .vertex_sampler import VertexSampler


@dataclass(frozen=True)
class WindowBatch:
    """Normalised windows of B pairs. Vertex i of `truth` is vertex i of `identity`; `driving` has another order.

    With `pairing: order` it has the same one. T is 1 for meshes.
    """

    identity: Float[Tensor, "B V 3"]
    driving: Float[Tensor, "B T V 3"]
    truth: Float[Tensor, "B T V 3"]
    unit: Float[Tensor, "B T"]
    """Radii by which the frames of `truth` were divided, over that of `identity`."""
    truth_radius: Float[Tensor, "B T"]
    """Radii of the whole frames of `truth` in its unit: 1 where they were divided by their own."""
    index: Int[Tensor, "B V"]
    """Number of each vertex of `identity` in the mesh that it is drawn from."""
    edges: Int[Tensor, "B E 2"]
    edges_of_mesh: float
    """Edges a vertex of the whole mesh over edges a vertex given here."""


class MeshSampler(VertexSampler):
    """Draws pairs and vertices of registered meshes, which lie on the device; subclasses make batches of them."""

    def __init__(self, config: DataConfig, meshes: RegisteredMeshes, device: torch.device, seed: int) -> None:
        super().__init__(meshes.points[0], meshes.faces, config, device, seed)
        self.keep_unit = config.target_scale == "identity"
        self.points = torch.from_numpy(meshes.points).to(device)
        self.radius = self._tensor(meshes.radius)
        self.triples = meshes.split.training.to(device)

    def sample(self, size: int, step: int) -> WindowBatch:
        """Draw the pairs of a step."""
        rng = self._generator(step)
        frames = self.triples.draw(size, rng)
        index, driving_index, edges, share = self._sample_vertices(size, rng)
        identity = self.points[frames.identity[:, None], index]
        driving = self.points[frames.driving[..., None], driving_index[:, None]]
        truth = self.points[frames.truth[..., None], index[:, None]]
        unit = self.radius[frames.truth] / self.radius[frames.identity, None]
        own = torch.ones_like(unit)
        if self.keep_unit:
            truth, unit, own = truth * unit[..., None, None], own, unit
        self._reflect(rng, identity, driving, truth)
        return WindowBatch(identity, driving, truth, unit, own, index, edges, share)


@dataclass(frozen=True, eq=False)
class HeldOutMeshes(Protocol):
    """Pairs of what a folder holds out: new people in poses of the training (`seen`), and new poses (`unseen`)."""

    meshes: RegisteredMeshes
    triples: dict[str, Triples]
    """By kind."""

    @classmethod
    def of(cls, meshes: RegisteredMeshes) -> HeldOutMeshes | None:
        """Make the protocol of a folder; None where nothing is held out."""
        kinds = {"seen": meshes.split.seen, "unseen": meshes.split.unseen}
        triples = {kind: found for kind, found in kinds.items() if found}
        return cls("meshes", 1, tuple(triples), 72, 0.0, meshes, triples) if triples else None

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        """Draw pair `i`, in the order of the files."""
        return self._pair(kind, rng, *(np.arange(self.meshes.points.shape[1]) for _ in range(2)))

    def pair(self, split: str, kind: str, i: int) -> Pair:
        """Draw pair `i` with the vertices of both meshes shuffled, the same way in all frames of a clip."""
        rng = self.rng(split, kind, i)
        return self._pair(kind, rng, *(rng.permutation(self.meshes.points.shape[1]) for _ in range(2)))

    def _pair(
        self, kind: str, rng: np.random.Generator, order: Int[np.ndarray, " V"], other: Int[np.ndarray, " V"]
    ) -> Pair:
        """Make a pair of meshes, or of clips where the training takes windows; lengths are in the files' unit."""
        frames = self.triples[kind].draw(1, torch.Generator().manual_seed(int(rng.integers(2**31))))
        identity = self._mesh(int(frames.identity[0]), order)
        truth = self._points(frames.truth[0], order)
        clip = self._points(frames.driving[0], other)
        driving = self._mesh(int(frames.driving[0, 0]), other)
        height = float(np.ptp(identity.vertices[:, 1]))
        if self.triples[kind].frames == 1:
            return Pair(identity, driving, truth[0], height)
        nothing = np.zeros((0, 2), np.int64)
        return ClipPair(
            identity, driving, truth[0], height, clip=Clip(driving, clip), truth_frames=truth,
            aligned_frames=self._points(frames.driving[0], order), template=nothing,
        )  # fmt: skip

    def _points(self, frames: Int[Tensor, " T"], order: Int[np.ndarray, " V"]) -> Float[np.ndarray, "T V 3"]:
        radius = self.meshes.radius[frames.numpy()]
        return self.meshes.points[frames.numpy()][:, order].astype(np.float64) * radius[:, None, None]

    def _mesh(self, frame: int, order: Int[np.ndarray, " V"]) -> Mesh:
        points = self.meshes.points[frame].astype(np.float64) * self.meshes.radius[frame]
        return permute_vertices(Mesh(points, self.meshes.faces), order)
