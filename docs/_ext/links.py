"""Checks the links of the built site and lists those that lead out of it.

    python docs/_ext/links.py docs/_build

Every linked file and anchor must exist, and a page must not load anything from another host.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from os.path import normpath
from pathlib import Path
from urllib.parse import unquote, urlsplit

FETCHED = {("script", "src"), ("img", "src"), ("link", "href"), ("source", "src"), ("iframe", "src")}
"""Tags and attributes whose target a browser loads without a click."""


class Page(HTMLParser):
    """The links and anchors of an HTML page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[tuple[str, str, str]] = []
        """Tag, attribute and address of each link."""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            if name in ("href", "src") and value:
                self.links.append((tag, name, value))


def check(site: Path) -> tuple[list[str], list[str]]:
    """Return the errors of a site, one line each, and the sorted addresses outside the site."""
    site = site.resolve()
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    errors, outside = [], set()
    for path, page in pages.items():
        for tag, attribute, address in page.links:
            parts = urlsplit(address)
            if parts.scheme in ("http", "https"):
                outside.add(address)
                if (tag, attribute) in FETCHED:
                    errors.append(f"{path.name}: expected to fetch nothing, found {address}")
            elif parts.scheme == "" and not parts.netloc:
                target = Path(normpath(path.parent / unquote(parts.path))) if parts.path else path
                errors += _missing(path, address, target, unquote(parts.fragment), pages)
    return errors, sorted(outside)


def _missing(path: Path, address: str, target: Path, anchor: str, pages: dict[Path, Page]) -> list[str]:
    if target not in pages and not target.exists():
        return [f"{path.name}: expected {address}, found no such file"]
    if anchor and target in pages and anchor not in pages[target].anchors:
        return [f"{path.name}: expected {address}, found no such anchor"]
    return []


def main() -> None:
    """Print the errors, or the addresses outside the site if there are none; exit with 1 on errors."""
    errors, outside = check(Path(sys.argv[1]))
    print("\n".join(errors) or "\n".join(["all links inside the site are sound; these lead out:", *outside]))
    sys.exit(bool(errors))


if __name__ == "__main__":
    main()
