"""Check the links of the built site and list those that lead out of it.

    python docs/_ext/links.py docs/_build

Every file and every anchor that a page names must be there, and nothing may be fetched from elsewhere to show it.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from os.path import normpath
from pathlib import Path
from urllib.parse import unquote, urlsplit

FETCHED = {("script", "src"), ("img", "src"), ("link", "href"), ("source", "src"), ("iframe", "src")}
"""What a browser gets by itself."""


class Page(HTMLParser):
    """The links and anchors of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[tuple[str, str, str]] = []
        """Tag, attribute and address."""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            if name in ("href", "src") and value:
                self.links.append((tag, name, value))


def check(site: Path) -> tuple[list[str], list[str]]:
    """What is wrong, and the addresses outside the site, both in order."""
    site = site.resolve()
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    wrong, outside = [], set()
    for path, page in pages.items():
        for tag, attribute, address in page.links:
            parts = urlsplit(address)
            if parts.scheme in ("http", "https"):
                outside.add(address)
                if (tag, attribute) in FETCHED:
                    wrong.append(f"{path.name}: expected to fetch nothing, found {address}")
            elif parts.scheme == "" and not parts.netloc:
                target = Path(normpath(path.parent / unquote(parts.path))) if parts.path else path
                wrong += _missing(path, address, target, unquote(parts.fragment), pages)
    return wrong, sorted(outside)


def _missing(path: Path, address: str, target: Path, anchor: str, pages: dict[Path, Page]) -> list[str]:
    if target not in pages and not target.exists():
        return [f"{path.name}: expected {address}, found no such file"]
    if anchor and target in pages and anchor not in pages[target].anchors:
        return [f"{path.name}: expected {address}, found no such anchor"]
    return []


def main() -> None:
    """Print what is wrong, or else what leads out."""
    wrong, outside = check(Path(sys.argv[1]))
    print("\n".join(wrong) or "\n".join(["all links inside the site are sound; these lead out:", *outside]))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
