"""Check the links of the built site and list those that lead out of it.

    python docs/_ext/links.py docs/_build

Every file and every anchor that a page names must be there, and nothing may be fetched from elsewhere to show it.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
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
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path.resolve()
                wrong += _missing(path, address, target, unquote(parts.fragment), pages, site)
    return wrong, sorted(outside)


def _missing(path: Path, address: str, target: Path, anchor: str, pages: dict[Path, Page], site: Path) -> list[str]:
    if not target.exists():
        return [f"{path.name}: expected {address}, found no such file"]
    known = {page.resolve(): content.anchors for page, content in pages.items()}.get(target)
    if anchor and known is not None and anchor not in known:
        return [f"{path.name}: expected {address}, found no such anchor"]
    return []


def main() -> None:
    """Print what is wrong, or else what leads out."""
    wrong, outside = check(Path(sys.argv[1]))
    print("\n".join(wrong) or "\n".join(["all links inside the site are sound; these lead out:", *outside]))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
