"""pyproject.toml: text for the package index, Python versions; the recipe and the Dockerfile agree with it."""

import json
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
HOOK = ("tool", "hatch", "metadata", "hooks", "fancy-pypi-readme", "substitutions")
ADDRESS = "https://HOST/OWNER/mimesh"


def rules(document: dict) -> list[dict[str, str]]:
    """Return the substitutions that a document has for the text of the package index."""
    for key in HOOK:
        document = document[key]
    return document  # pyright: ignore[reportReturnType]


def substituted(substitutions: list[dict[str, str]]) -> str:
    """Return the README after substitutions, each of which must change something."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for rule in substitutions:
        text, count = re.subn(rule["pattern"], rule["replacement"], text)
        assert count, rule["pattern"]
    return text


def test_the_text_for_the_package_index_needs_no_clone(script):
    text = substituted(rules(PROJECT))
    assert "    pip install mimesh\n    mimesh demo  " in text
    assert ".venv" not in text
    assert "make demo" not in text
    assert script["relative_links"](text) == []


def test_rules_for_an_address_make_links_and_pictures_absolute(script):
    [block] = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "contributing.md").read_text(), re.DOTALL)
    text = substituted(rules(PROJECT)[:-2] + rules(tomllib.loads(block)))
    assert script["relative_links"](text) == []
    pictures = re.findall(rf"!\[[^\]]+\]\({ADDRESS}/raw/v\$HFPR_VERSION/([^)]+)\)", text)
    pages = re.findall(rf"\]\({ADDRESS}/blob/v\$HFPR_VERSION/([^)#]+)(?:#[^)]+)?\)", text)
    assert len(pictures) == 1
    assert len(pages) > 15
    assert [path for path in pictures + pages if not (ROOT / path).exists()] == []


def test_python_versions_of_the_package_are_those_that_were_run():
    found = json.loads((ROOT / "benchmarks" / "pythons.json").read_text())
    ran = {".".join(row["python"].split(".")[:2]) for row in found["rows"] if row["ok"]}
    named = {line.split(" :: ")[-1] for line in PROJECT["project"]["classifiers"] if re.search(r":: 3\.\d+$", line)}
    assert named == ran
    assert PROJECT["project"]["requires-python"] == f">={min(ran, key=lambda version: int(version[2:]))}"


def test_the_recipe_has_the_requirements_of_the_package():
    yaml = pytest.importorskip("yaml")
    requirements = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())["requirements"]
    package = [*PROJECT["project"]["dependencies"], f"python{PROJECT['project']['requires-python']}"]
    assert sorted(line.replace(" ", "") for line in requirements["run"]) == sorted(package)
    assert set(PROJECT["build-system"]["requires"]) <= {line.replace(" ", "") for line in requirements["host"]}


def test_the_image_gets_every_file_that_it_copies_and_extras_that_exist():
    text = (ROOT / "Dockerfile").read_text()
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = {name for names in re.findall(r"(?m)^COPY (?!--)(.+) \S+$", text) for name in names.split()}
    assert copied == kept
    assert [name for name in copied if not (ROOT / name).exists()] == []
    build = {PROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["fragments"][0]["path"]}
    assert build | set(PROJECT["project"]["license-files"]) <= copied
    [extras] = re.findall(r"\.whl\)\[([\w,-]+)\]", text)
    assert set(extras.split(",")) <= set(PROJECT["project"]["optional-dependencies"])
