"""Write tables, measured figures and transcripts into the pages of docs/, below the marks that name them.

PYTHONPATH=src python scripts/write_inserts.py
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from mimesh.io.atomic import whole_file

DOCS = Path(__file__).parents[1] / "docs"


def main() -> None:
    """Write the pages that change, and print their names."""
    sys.path.insert(0, str(DOCS / "_ext"))
    written = importlib.import_module("inserts").written
    for page in sorted(DOCS.glob("*.md")):
        before = page.read_text(encoding="utf-8")
        if (text := written(before)) != before:
            with whole_file(page) as temporary:
                temporary.write_text(text, encoding="utf-8", newline="\n")
            print(page.relative_to(DOCS.parent))


if __name__ == "__main__":
    main()
