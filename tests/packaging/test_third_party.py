"""THIRD_PARTY.md: every file of data, every bundled and every installed library, with the licence that it states."""

import json
import re
import runpy
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
NOTICES = (ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DATA = (".npz", ".onnx")
DEVELOPMENT = ("dev", "docs")
"""Extras for work on mimesh itself."""
WORDS = {
    "Apache Software License": "Apache-2.0",
    "Apache 2.0": "Apache-2.0",
    "Apache-2.0": "Apache-2.0",
    "BSD License": "BSD-",
    "3-Clause BSD License": "BSD-3-Clause",
    "ISC License (ISCL)": "ISC",
    "LicenseRef-TOST-1.0": "LicenseRef-TOST-1.0",
    "MIT License": "MIT",
    "MIT": "MIT",
    "zlib": "Zlib",
}
"""How older metadata name licences, and how the SPDX identifiers begin."""


@pytest.fixture
def listed(script) -> dict[str, str]:
    """Licences by library."""
    return script["listed_licences"](NOTICES)


def needed(requirements: list[str]) -> set[str]:
    """Return the names of all that requirements install, as far as it is installed here."""
    names, waiting = set(), [Requirement(line) for line in requirements]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name in names or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        names.add(name)
        waiting += [Requirement(line) for line in metadata.requires(name) or []]
    return names


def stated(name: str) -> str | None:
    """Return the licence in a library's metadata, or how it begins; None if they do not tell or it is not installed."""
    try:
        facts = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return None
    if expression := facts.get("License-Expression"):
        return expression
    kinds = [line.split(" :: ")[-1] for line in facts.get_all("Classifier", []) if line.startswith("License ::")]
    return next((WORDS[word] for word in [*kinds, facts.get("License", "")] if word in WORDS), None)


def test_every_library_of_an_installation_is_listed(listed):
    names = needed(PROJECT["dependencies"])
    assert len(names) > len(PROJECT["dependencies"])
    assert sorted(names - set(listed)) == []


def test_every_library_of_an_extra_is_listed(listed):
    extras = {name: lines for name, lines in PROJECT["optional-dependencies"].items() if name not in DEVELOPMENT}
    names = {canonicalize_name(Requirement(line).name): extra for extra, lines in extras.items() for line in lines}
    assert sorted(set(names) - set(listed)) == []
    for name, extra in names.items():
        assert re.search(rf"(?m)^\| \*\*{name}\*\* \| [^|]+ \| `{extra}` \|$", NOTICES), name


def test_licences_are_those_that_the_libraries_state(listed):
    found = {name: stated(name) for name in listed}
    told = {name: licence for name, licence in found.items() if licence is not None}
    assert needed(PROJECT["dependencies"]) <= set(told)
    assert {
        name: (listed[name], licence) for name, licence in told.items() if not listed[name].startswith(licence)
    } == {}


def test_bundled_libraries_are_listed_with_the_licence_of_the_lock_file(listed):
    lock = json.loads((ROOT / "web" / "package-lock.json").read_text())["packages"]
    bundled = set(lock[""]["dependencies"]) - {"esbuild"}
    assert bundled
    assert {name: lock[f"node_modules/{name}"]["license"] for name in bundled} == {
        name: listed[name] for name in bundled
    }


def test_every_file_of_data_is_named_once():
    files = {str(path.relative_to(ROOT)) for path in (ROOT / "src").rglob("*") if path.suffix in DATA}
    named = re.findall(r"`(src/mimesh/[\w/.-]+)`", "\n".join(re.findall(r"(?m)^## .+$", NOTICES)))
    assert len(named) == len(set(named))
    assert {name for name in named if Path(name).suffix in DATA} == files


def test_makers_of_training_characters_are_named():
    cards = [
        json.loads(path.read_text()) for path in sorted((ROOT / "src" / "mimesh" / "methods" / "zoo").glob("*.json"))
    ]
    trained = [card for card in cards if "characters" in card]
    assert trained
    for card in trained:
        [section] = re.findall(rf"(?ms)^## [^\n]*{card['file']}`[^\n]*\n(.*?)(?=^## )", NOTICES)
        makers = card["characters"]["makers"]
        counts = [int(count) for count in re.findall(r"\((\d+)(?: characters)?\)", section)]
        assert sorted(counts) == sorted(makers.values())
        names = {"Rocketbox" if "Rocketbox" in maker else maker.split(":")[0] for maker in makers}
        assert [name for name in names if not re.search(rf"\*\*.*{name}\*\*", section)] == []


def test_wheels_of_the_blender_extension_are_listed(listed):
    packages = runpy.run_path(str(ROOT / "scripts" / "build_blender.py"))["PACKAGES"]
    section = NOTICES.split("## The Blender extension")[1]
    assert set(re.findall(r"\*\*([\w-]+)\*\*", section)) == set(packages)
    assert set(packages) <= set(listed)
