"""Write a method of your own and compare it with the shipped ones on a counterpart of NPT's test set.

python examples/06_your_own_method.py             # 4 pairs of each kind
python examples/06_your_own_method.py --pairs 72  # as many as the tables have
"""

import argparse
import dataclasses
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

import mimesh
from mimesh.evaluate.measure import measure
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.methods.base import Drive
from mimesh.methods.find import find_mime
from mimesh.mime.model import Mime
from mimesh.rigs.retarget import Retarget

MIRROR = np.array([-1.0, 1.0, 1.0])
"""Factors of x, y and z that exchange left and right."""


@dataclass(frozen=True)
class Mirrored:
    """Moves a mesh by mime's joints and its mirror image by those of the mirrored driving, and averages the two.

    A method gets both meshes normalised: y up, facing +z, in the unit sphere. `prepare` does the work that is needed
    once and returns a drive: a function from driving frames to the identity's vertices, one frame at a time.
    """

    inner: Mime
    rough: ClassVar[bool] = False
    """Whether results have a rough surface, so that they are refined by default."""

    @property
    def name(self) -> str:
        return f"{self.inner.name} twice"

    def prepare(self, identity: mimesh.Mesh, driving: mimesh.Clip) -> Drive:
        direct = self.follow(identity, driving)
        mirror_image = dataclasses.replace(driving, mesh=mirrored(driving.mesh), vertices=driving.vertices * MIRROR)
        mirror = self.follow(mirrored(identity), mirror_image)

        def drive(frames: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
            # A generator that takes frame after frame, so a clip of any length needs little memory.
            for t, frame in enumerate(frames):
                yield (direct.frame(t, frame) + mirror.frame(t, frame * MIRROR) * MIRROR) / 2

        return drive

    def follow(self, identity: mimesh.Mesh, driving: mimesh.Clip) -> Retarget:
        """Let the joints that are found on the identity follow those of the driving."""
        return Retarget.of(self.inner.rig(identity), self.inner.capture(driving))


def mirrored(mesh: mimesh.Mesh) -> mimesh.Mesh:
    """Return the mirror image of a mesh; the order of corners is reversed, so that triangles still face outwards."""
    return mimesh.Mesh(mesh.vertices * MIRROR, mesh.faces[:, ::-1].copy(), name=mesh.name)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=4, help="number of pairs of each kind")
    parser.add_argument("--beside", nargs="*", default=["mime", "copy"], help="shipped models to compare with")
    parser.add_argument("-o", "--output", type=Path, default=Path("06_your_own_method"), help="folder")
    options = parser.parse_args(argv)

    protocol, table = PROTOCOLS["human-npt"], {}
    print(f"{'method':10}" + "".join(f"{kind:>10}" for kind in protocol.kinds) + "   (PMD x1e4, lower is better)")
    for method in (Mirrored(find_mime("mime")), *options.beside):
        # measure(), mimesh.transfer() and mimesh.animate() take the name of a model or a method.
        errors = {}
        for kind in protocol.kinds:
            pairs = (protocol.pair("test", kind, number) for number in range(options.pairs))
            measured = [measure(pair, method) for pair in pairs]
            failed = [found[why] for found in measured for why in ("failed", "why") if why in found]
            if failed:  # a method may refuse pairs; its mean is then not comparable
                raise SystemExit(f"{len(failed)} of {len(measured)} pairs of {kind} have no result: {failed[0]}")
            errors[kind] = np.mean([found["pmd_e4"] for found in measured])
        name = method if isinstance(method, str) else method.name
        print(f"{name:10}" + "".join(f"{errors[kind]:10.2f}" for kind in protocol.kinds))
        table[name] = {kind: round(float(error), 4) for kind, error in errors.items()}
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "table.json").write_text(json.dumps(table, indent=2) + "\n")
    print("wrote", options.output / "table.json")


if __name__ == "__main__":
    main()
