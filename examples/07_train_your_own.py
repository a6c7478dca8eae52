"""Train a small network for two minutes, export it, and use it. Needs pip install '.[train]'.

python examples/07_train_your_own.py               # two minutes of NPT: a rough result
python examples/07_train_your_own.py --minutes 120 # the time and width of the shipped `npt`
"""

import argparse
from pathlib import Path

import mimesh
from mimesh.bodies import character, load_body
from mimesh.motions import load_motion, motion_clip
from mimesh.view import sheet

SMALL = ("model.encoder=[32, 64, 128]", "model.decoder=[131, 64, 32]", "batch=8", "data.vertices=64")
"""Changes to the shipped configuration, as `mimesh train npt --set ...` takes them."""


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("identity", nargs="?", type=Path, help="the mesh to be moved")
    parser.add_argument("driving", nargs="?", type=Path, help="the mesh in the wanted pose")
    parser.add_argument("--minutes", type=float, default=2.0, help="how long to train")
    parser.add_argument("-o", "--output", type=Path, default=Path("07_train_your_own"), help="folder")
    options = parser.parse_args(argv)
    # Only training and export need PyTorch; using the exported network does not.
    from mimesh.learn.export import export_command
    from mimesh.learn.start import train_command

    # Training pairs are generated during the training. An interrupted training is continued with resume=<its folder>.
    run = options.output / "run"
    resume = run if (run / "last.safetensors").exists() else None
    changes = () if resume else (*(SMALL if options.minutes < 30 else ()), f"minutes={options.minutes}")
    if options.minutes < 1:
        changes = (*changes, "validation_pairs=2")
    train_command("npt", "small", run, resume, options.minutes, changes)
    # The best weights on the validation pairs; the last ones where the time was over before any validation.
    best = run / "best.safetensors"
    weights = best if best.exists() else run / "last.safetensors"
    print("wrote", weights, "and", run / "log.jsonl")

    network = options.output / "mine.onnx"
    export_command(weights, network)
    print(f"wrote {network}: {network.stat().st_size / 2**20:.2f} MiB, and its card {network.with_suffix('.json')}")

    # The path of a network can be used as a model name, in Python and as -m of every command.
    identity = mimesh.load_mesh(options.identity) if options.identity else character("runner")
    driving = mimesh.load_mesh(options.driving) if options.driving else reaching()
    result = mimesh.transfer(identity, driving, str(network))
    print("wrote", result.save(options.output / "result.glb"))
    picture = options.output / "picture.png"
    sheet.transfer_sheet(identity, driving, result.mesh).save(picture)
    print("wrote", picture)
    print(f"next: mimesh evaluate human-npt -m {network},npt,mime --pairs 4")


def reaching() -> mimesh.Mesh:
    """Return the shipped body with raised arms."""
    clip = motion_clip(load_body(), None, load_motion("swing"))
    return clip.mesh.with_vertices(clip.vertices[45])


if __name__ == "__main__":
    main()
