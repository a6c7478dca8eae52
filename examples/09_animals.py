"""Move a four-legged animal by another one: a cow with a horse's gallop, and what the report says about it.

python examples/09_animals.py                   # a shipped cow and a shipped gallop
python examples/09_animals.py cat.glb dog.glb   # your own: both four-legged, with or without rigs
"""

import argparse
from pathlib import Path

import mimesh
from mimesh.bodies.animals import animal
from mimesh.motions.animal_clips import gait_clip
from mimesh.view.movie import clip_frames, save_movie
from mimesh.view.sheet import DRIVING_TINT


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("identity", nargs="?", type=Path, help="the animal to be moved")
    parser.add_argument("driving", nargs="?", type=Path, help="an animal in motion")
    parser.add_argument("--frames", type=int, default=30, help="number of frames to use")
    parser.add_argument("-o", "--output", type=Path, default=Path("09_animals"), help="folder")
    options = parser.parse_args(argv)
    identity = mimesh.load_mesh(options.identity) if options.identity else animal("cow")
    driving = mimesh.load_clip(options.driving, fps=30.0) if options.driving else gait_clip("horse", "gallop", 4)

    # body="auto", the default, would find out that these are animals; to say it leaves nothing to guess.
    hints, frames = mimesh.Hints(body="quadruped"), mimesh.FrameRange(stop=options.frames)
    result = mimesh.animate(identity, driving, hints=hints, frames=frames)
    print("wrote", result.save_skinned(options.output / "result.glb"))

    # Confidence is from 0 to 1, the expected error in heights of the identity; of two rigged animals there is neither.
    report = result.report
    print("taken for:", report["body"])
    for which in ("identity", "driving"):
        reading = report[which]
        print(f"{which}: up {reading['up']}, front {reading['front']}")
        if "confidence" in reading:
            worst = max(reading["limbs"], key=reading["limbs"].get)
            print(f"  confidence {reading['confidence']:.2f}, expected error {reading['expected_error']:.4f} heights")
            print(f"  least certain: {worst}")
    if report["foot_skate"] is not None:
        skate = report["foot_skate"], report["foot_skate_driving"]
        print("feet on the ground slide {:.2f} heights a second, those of the driving {:.2f}".format(*skate))
    for note in result.notes:
        print("note:", note)

    movie = options.output / "beside.webp"
    clips = [("driving", result.driving), ("result", result.clip)]
    save_movie(clip_frames(clips, (360, 320), view=(-62.0, 8.0), tints=[DRIVING_TINT, None], track=True), movie)
    print("wrote", movie)


if __name__ == "__main__":
    main()
