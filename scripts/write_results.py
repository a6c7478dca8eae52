"""Write docs/RESULTS.md and the table of README.md from the reports in docs/results.

python scripts/write_results.py
"""

from __future__ import annotations

from pathlib import Path

from mimesh.evaluate.results import readme_table, results_page, with_readme_table
from mimesh.io.atomic import whole_file

DOCS = Path(__file__).parents[1] / "docs"
RESULTS = DOCS / "results"


def main() -> None:
    """Write the page and the table."""
    readme = DOCS.parent / "README.md"
    pages = {DOCS / "RESULTS.md": results_page(RESULTS)}
    pages[readme] = with_readme_table(readme.read_text(), readme_table(RESULTS))
    for path, text in pages.items():
        with whole_file(path) as temporary:
            temporary.write_text(text)
        print(f"{path}: written")


if __name__ == "__main__":
    main()
