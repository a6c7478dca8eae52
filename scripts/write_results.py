"""Write docs/RESULTS.md from the reports in docs/results.

python scripts/write_results.py
"""

from __future__ import annotations

from pathlib import Path

from mimesh.evaluate.results import results_page
from mimesh.io.atomic import whole_file

DOCS = Path(__file__).parents[1] / "docs"
RESULTS = DOCS / "results"


def main() -> None:
    """Write the page."""
    with whole_file(DOCS / "RESULTS.md") as temporary:
        temporary.write_text(results_page(RESULTS))
    print(f"{DOCS / 'RESULTS.md'}: written")


if __name__ == "__main__":
    main()
