"""Write the tables of docs/results.md and README.md, and docs/results/rows.csv, from the reports in docs/results.

python scripts/write_results.py
"""

from __future__ import annotations

from pathlib import Path

from mimesh.evaluate.results import page_tables, read_reports, readme_table, rows_csv, with_tables
from mimesh.io.atomic import whole_file

DOCS = Path(__file__).parents[1] / "docs"
RESULTS = DOCS / "results"


def main() -> None:
    """Write the tables between their marks, and the CSV file."""
    page, readme, reports = DOCS / "results.md", DOCS.parent / "README.md", read_reports(RESULTS)
    texts = {
        page: with_tables(page.read_text(encoding="utf-8"), page_tables(reports)),
        readme: with_tables(readme.read_text(encoding="utf-8"), {"results": readme_table(reports)}),
        RESULTS / "rows.csv": rows_csv(reports),
    }
    for path, text in texts.items():
        with whole_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
        print(f"{path}: written")


if __name__ == "__main__":
    main()
