"""scripts/release.py: the parts of a release that need no network."""

import zipfile
from pathlib import Path

import pytest

from mimesh import __version__
from mimesh.core.errors import InputError

ROOT = Path(__file__).parents[2]
BILL = {"bomFormat": "CycloneDX", "components": [{"name": "mimesh"}, {"name": "Wadler_Lindig"}]}
TABLE = "| library | licence | needed by |\n| --- | --- | --- |\n| **wadler-lindig** | Apache-2.0 | jaxtyping |\n"


def test_files_of_the_repository_agree_on_the_version(script):
    assert script["version_of"](ROOT) == __version__


def test_another_version_in_one_file_is_refused(script, tmp_path):
    for name in ("pyproject.toml", *script["VERSIONS"]):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text())
    assert script["version_of"](tmp_path) == __version__
    citation = tmp_path / "CITATION.cff"
    citation.write_text(citation.read_text().replace(f"\nversion: {__version__}\n", "\nversion: 9.9.9\n"))
    with pytest.raises(InputError, match=rf"CITATION.cff: expected version {__version__}, found 9.9.9"):
        script["version_of"](tmp_path)


def test_the_tag_has_its_section_without_marks_of_comments(script):
    log = "## 0.2.0 - 2027-01-02\n\n### Added\n\n- b\n\n## 0.1.0 - 2026-11-25\n\nFirst.\n\n### Fixed\n\n- a\n"
    assert script["tag_message"](log, "0.2.0") == "mimesh 0.2.0\n\nAdded:\n\n- b\n"
    assert script["tag_message"](log, "0.1.0") == "mimesh 0.1.0\n\nFirst.\n\nFixed:\n\n- a\n"


@pytest.mark.parametrize("heading", ["## 0.1.0 - unreleased", "## 0.1.00 - 2026-11-25", "## 0x1.0 - 2026-11-25"])
def test_a_version_without_a_dated_section_has_no_tag(script, heading):
    with pytest.raises(InputError, match=r"expected a section '## 0.1.0 - YYYY-MM-DD'"):
        script["tag_message"](f"# Changelog\n\n{heading}\n\n- a\n", "0.1.0")


def test_this_version_has_a_tag_message(script):
    message = script["tag_message"]((ROOT / "CHANGELOG.md").read_text(), __version__)
    assert message.startswith(f"mimesh {__version__}\n\n")
    assert [line for line in message.splitlines() if line.startswith("#")] == []


@pytest.mark.parametrize(("name", "limit"), [("a.whl", 30_000_000), ("a.tar.gz", 30_000_000)])
def test_a_large_archive_is_refused(script, tmp_path, name, limit):
    path = tmp_path / name
    path.touch()
    with path.open("r+b") as file:
        file.truncate(limit)  # sparse: no byte is written
    script["check_size"](path)
    with path.open("r+b") as file:
        file.truncate(limit + 1)
    with pytest.raises(InputError, match=rf"{name}: expected at most"):
        script["check_size"](path)


def test_metadata_of_a_wheel_tells_what_is_left_to_do(script, tmp_path):
    path = tmp_path / "a-1-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a-1.dist-info/METADATA", "Name: a\nClassifier: x\nClassifier: y\n\n[b](docs/b.md) [c](#c)\n")
    metadata = script["wheel_metadata"](path)
    assert metadata["Classifier"] == ["x", "y"]
    assert script["relative_links"](metadata["Description"][0]) == ["docs/b.md"]
    assert len(script["to_do"](metadata)) == 1
    assert script["to_do"](metadata | {"Project-URL": ["Repository, https://example.org"]}) == []


def test_a_library_without_a_row_is_refused(script):
    assert script["check_licences"](BILL, TABLE) == {"wadler-lindig": "Apache-2.0"}
    with pytest.raises(InputError, match="expected a row for each library, found none for wadler-lindig"):
        script["check_licences"](BILL, TABLE.replace("wadler", "other"))


def test_the_bill_of_materials_has_bundled_libraries_and_no_tool(script):
    bill = script["with_bundled"](
        BILL, {"dependencies": {"esbuild": "1", "three": "0.187.0"}}, {"three": "MIT", "x": "ISC"}
    )
    assert bill["components"][:2] == BILL["components"]
    [three] = bill["components"][2:]
    assert (three["purl"], three["licenses"]) == ("pkg:npm/three@0.187.0", [{"license": {"id": "MIT"}}])


def test_files_of_an_earlier_release_are_not_mixed_in(script, tmp_path):
    (tmp_path / "mimesh-0.0.1.tar.gz").touch()
    with pytest.raises(InputError, match=r"expected an empty folder, found mimesh-0.0.1.tar.gz"):
        script["make"](tmp_path, "HEAD", False)
