"""A method of your own beside the shipped ones: some lines, then the paper's test set.

python examples/06_your_own_method.py             # 4 pairs of each kind
python examples/06_your_own_method.py --pairs 72  # as many as the tables have
"""

import argparse
import dataclasses
import itertools
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

import mimesh
from mimesh.evaluate.measure import measure
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.methods.base import Drive, Method
from mimesh.methods.find import find_method

FLIP = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Mirrored:
    """Another method asked twice, once in a mirror, and the mean of its two answers.

    A method sees both meshes normalised: y up, facing +z, in the unit sphere. `prepare` does what is done once and
    gives a function from the driving's frames to the identity's vertices, one frame at a time.
    """

    inner: Method
    rough: ClassVar[bool] = False
    """Whether results are smoothed on the identity's surface unless the user says otherwise."""

    @property
    def name(self) -> str:
        return f"{self.inner.name} twice"

    def prepare(self, identity: mimesh.Mesh, driving: mimesh.Clip) -> Drive:
        straight = self.inner.prepare(identity, driving)
        seen = dataclasses.replace(driving, mesh=mirrored(driving.mesh), vertices=driving.vertices * FLIP)
        across = self.inner.prepare(mirrored(identity), seen)

        def drive(frames: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
            ones, others = itertools.tee(frames)
            for one, other in zip(straight(ones), across(frame * FLIP for frame in others), strict=True):
                yield (one + other * FLIP) / 2

        return drive


def mirrored(mesh: mimesh.Mesh) -> mimesh.Mesh:
    """Left and right exchanged; triangles are turned round, so that they still look outwards."""
    return mimesh.Mesh(mesh.vertices * FLIP, mesh.faces[:, ::-1].copy(), name=mesh.name)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=4, help="of each kind")
    parser.add_argument("--beside", nargs="*", default=["mime", "copy"], help="shipped models")
    parser.add_argument("-o", "--output", type=Path, default=Path("06_your_own_method"), help="folder")
    options = parser.parse_args(argv)

    protocol, table = PROTOCOLS["human-npt"], {}
    print(f"{'method':10}" + "".join(f"{kind:>10}" for kind in protocol.kinds) + "   (PMD x1e4, less is better)")
    for method in (Mirrored(find_method("mime")), *options.beside):
        # What takes a model's name takes a method too: measure(), mimesh.transfer() and mimesh.animate().
        errors = {
            kind: np.mean([measure(pair, method)["pmd_e4"] for pair in protocol.trials("test", kind, options.pairs)])
            for kind in protocol.kinds
        }
        name = method if isinstance(method, str) else method.name
        print(f"{name:10}" + "".join(f"{errors[kind]:10.2f}" for kind in protocol.kinds))
        table[name] = {kind: round(float(error), 4) for kind, error in errors.items()}
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "table.json").write_text(json.dumps(table, indent=2) + "\n")
    print("wrote", options.output / "table.json")


if __name__ == "__main__":
    main()
