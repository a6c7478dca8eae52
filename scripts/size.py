"""Print how large the repository is: lines and modules of its parts, words of its pages, arrows between its packages.

    python scripts/size.py [--json]

Files are those that git knows. An arrow is an import of one package of `mimesh` by another, at load or in a function.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PARTS = ("src", "tests", "scripts", "research", "benchmarks", "blender", "examples", "docs")


def main() -> None:
    """Count, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    figures = count()
    if args.json:
        print(json.dumps(figures, indent=1))
        return
    for part, (files, lines) in figures["python"].items():
        print(f"{part:12s} {files:4d} modules {lines:7,d} lines")
    for page, words in figures["words"].items():
        print(f"{page:12s} {words:7,d} words")
    print(f"{len(figures['arrows'])} arrows between packages, {figures['packages']} packages")
    print(f"{figures['tracked_mib']} MiB tracked")


def count() -> dict:
    """Count everything; keys are those of the JSON that is printed."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [path for name in listed.split("\0") if name and (path := ROOT / name).is_file()]
    python = {part: [p for p in files if p.suffix == ".py" and p.is_relative_to(ROOT / part)] for part in PARTS}
    log = ROOT / "docs" / "log"
    pages = [p for p in files if p.suffix == ".md" and p.parent in (ROOT, ROOT / "docs", log)]
    of_part = {ROOT / "README.md": "README", ROOT / "docs" / "results.md": "results", log: "the log"}
    words = dict.fromkeys([*of_part.values(), "other pages"], 0)
    for page in pages:
        part = of_part.get(page) or of_part.get(page.parent, "other pages")
        words[part] += len(page.read_text(encoding="utf-8").split())
    arrows = sorted(package_imports())
    return {
        "python": {part: (len(paths), sum(map(lines_of, paths))) for part, paths in python.items()},
        "words": words,
        "arrows": arrows,
        "packages": len({name for arrow in arrows for name in arrow}),
        "tracked_mib": round(sum(path.stat().st_size for path in files) / 2**20, 1),
    }


def lines_of(path: Path) -> int:
    """Count the lines of a file."""
    return len(path.read_text(encoding="utf-8").splitlines())


def package_imports() -> set[tuple[str, str]]:
    """Find which package of mimesh imports which other one; imports for type checkers count."""
    graph = grimp.build_graph("mimesh", cache_dir=None)
    pairs = ((module, other) for module in graph.modules for other in graph.find_modules_directly_imported_by(module))
    names = ((module.split(".")[1], other.split(".")[1]) for module, other in pairs if "." in module and "." in other)
    return {(here, there) for here, there in names if here != there}


if __name__ == "__main__":
    main()
