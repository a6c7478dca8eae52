"""Compare models on a pair whose true result is known: error metrics, and a heat map for each model.

python examples/04_compare_models.py                     # a pair of a shipped test set
python examples/04_compare_models.py id.obj pose.obj truth.obj --models mime copy  # your own, with equal topology
"""

import argparse
import dataclasses
from pathlib import Path

import mimesh
from mimesh.core import geometry
from mimesh.evaluate.metrics import box_aligned, edge_score, mean_error_mm, pmd_aligned
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.view import heat, sheet


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", type=Path, help="identity, driving and truth")
    parser.add_argument("--models", nargs="+", default=["copy", "npt", "mime"], help="see `mimesh models`")
    parser.add_argument("-o", "--output", type=Path, default=Path("04_compare_models"), help="folder")
    options = parser.parse_args(argv)
    identity, driving, truth = [mimesh.load_mesh(path) for path in options.meshes] or shipped_pair()
    options.output.mkdir(parents=True, exist_ok=True)

    edges, height = geometry.edges(identity.faces), identity.vertices[:, 1].max() - identity.vertices[:, 1].min()
    print(f"{'model':12} {'PMD x1e4':>9} {'mm':>6} {'edge score':>10}")
    for model in options.models:
        result = mimesh.transfer(identity, driving, model)
        # Results stand in the world: moved to the truth by the centres of the boxes, their position does not count.
        moved = box_aligned(result.vertices, truth.vertices)
        metrics = (
            1e4 * pmd_aligned(moved, truth.vertices),
            mean_error_mm(moved, truth.vertices, height),
            edge_score(moved, truth.vertices, edges),
        )
        print("{:12} {:9.2f} {:6.1f} {:10.3f}".format(model, *metrics))
        picture = options.output / f"{Path(model).stem}.png"
        heat.heat_map(dataclasses.replace(result.mesh, vertices=moved), truth, limit=0.1, tile=(360, 440)).save(picture)
        print("wrote", picture)
    picture = options.output / "pair.png"
    sheet.transfer_sheet(identity, driving, truth).save(picture)
    print("wrote", picture)


def shipped_pair() -> tuple[mimesh.Mesh, mimesh.Mesh, mimesh.Mesh]:
    """Return identity, driving mesh and truth of a pair of `human-npt`, in a pose without training data."""
    protocol = PROTOCOLS["human-npt"]
    pair = protocol.unshuffled_pair("test", "unseen", 0, protocol.rng("test", "unseen", 0))
    return pair.identity, pair.driving, pair.identity.with_vertices(pair.truth)


if __name__ == "__main__":
    main()
