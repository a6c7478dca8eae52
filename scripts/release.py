"""Make all of a release but its upload, from a clean clone of a commit: archives, checks, licences, SBOM, tag message.

    python scripts/release.py [-o dist/release] [--revision HEAD] [--blender]

The wheel is built from the source archive. A new environment gets it as a stranger would, with the newest releases of
what it needs, and runs the demo. docs/contributing.md says what the files are for and what is left to do by hand.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path

from mimesh.core.errors import InputError

ROOT = Path(__file__).parents[1]
TOOLS = ("build==1.6.1", "twine==7.0.0", "cyclonedx-bom==7.5.0")
LIMITS = {".whl": 30e6, ".tar.gz": 30e6}
"""Largest wheel and source archive in bytes."""
WEIGHTS = ("ablations", "training")
"""Folders with weights that are in no other archive."""
VERSIONS = {
    "src/mimesh/__init__.py": r'__version__ = "(.+)"',
    "CITATION.cff": r"(?m)^version: (.+)$",
    "blender/blender_manifest.toml": r'(?m)^version = "(.+)"',
    "conda/recipe.yaml": r'(?m)^  version: "(.+)"',
}
"""Files that repeat the version of pyproject.toml, and how they write it."""
VALIDATION = """
import sys
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
sys.exit(JsonStrictValidator(SchemaVersion.V1_6).validate_str(open(sys.argv[1]).read()))
"""


def version_of(root: Path) -> str:
    """Return the version of pyproject.toml.

    Raises:
        InputError: another file has another version.
    """
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    for name, pattern in VERSIONS.items():
        found = re.search(pattern, (root / name).read_text())
        if found is None or found[1] != version:
            raise InputError(f"{name}: expected version {version}, found {found and found[1]}; make them equal")
    return version


def tag_message(changelog: str, version: str) -> str:
    """Return the message of a version's tag: its section of the change log, headings without marks.

    git would take lines that begin with # for comments.

    Raises:
        InputError: the change log has no such section, or it has no date.
    """
    found = re.search(rf"(?ms)^## \[?{re.escape(version)}\]? - (\d{{4}}-\d\d-\d\d)$\n(.*?)(?=^## |\Z)", changelog)
    if found is None:
        raise InputError(f"CHANGELOG.md: expected a section '## {version} - YYYY-MM-DD', found none; write it")
    return f"mimesh {version}\n\n" + re.sub(r"(?m)^#+ (.+)$", r"\1:", found[2].strip()) + "\n"


def check_size(path: Path) -> None:
    """Raise InputError if an archive is larger than LIMITS allow."""
    for suffix, limit in LIMITS.items():
        if path.name.endswith(suffix) and path.stat().st_size > limit:
            raise InputError(
                f"{path.name}: expected at most {limit / 1e6:.0f} MB, found {path.stat().st_size / 1e6:.1f} MB; "
                "exclude files in pyproject.toml"
            )


def wheel_metadata(path: Path) -> dict[str, list[str]]:
    """Return the fields of a wheel's metadata; `Description` is what a package index shows."""
    with zipfile.ZipFile(path) as archive:
        [name] = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        message = message_from_bytes(archive.read(name))
    return {key: message.get_all(key, []) for key in message} | {"Description": [str(message.get_payload())]}


def relative_links(markdown: str) -> list[str]:
    """Return the targets of links and pictures that work in a clone alone."""
    return re.findall(r"\]\((?!https?:|mailto:|#)([^)\s]+)\)", markdown)


def listed_licences(third_party: str) -> dict[str, str]:
    """Return the licence of each library in the tables of THIRD_PARTY.md."""
    return dict(re.findall(r"(?m)^\| \*\*([\w.-]+)\*\* \| ([^|]+?) \|", third_party))


def check_licences(bill: dict, third_party: str) -> dict[str, str]:
    """Return the licences of a bill of materials by library.

    Raises:
        InputError: THIRD_PARTY.md does not list one of them.
    """
    listed = listed_licences(third_party)
    names = {re.sub(r"[-_.]+", "-", component["name"]).lower() for component in bill["components"]} - {"mimesh"}
    if missing := sorted(names - set(listed)):
        raise InputError(
            f"THIRD_PARTY.md: expected a row for each library, found none for {', '.join(missing)}; add it"
        )
    return {name: listed[name] for name in sorted(names)}


def with_bundled(bill: dict, package: dict, licences: dict[str, str]) -> dict:
    """Add the JavaScript libraries that the wheel's pages hold, by package.json, to a bill of materials.

    esbuild makes the bundle and is not in it.
    """
    bundled = {name: version for name, version in package["dependencies"].items() if name != "esbuild"}
    components = [
        {
            "type": "library",
            "bom-ref": f"pkg:npm/{name}@{version}",
            "name": name,
            "version": version,
            "purl": f"pkg:npm/{name}@{version}",
            "licenses": [{"license": {"id": licences[name]}}],
        }
        for name, version in bundled.items()
    ]
    return bill | {"components": [*bill["components"], *components]}


def to_do(metadata: dict[str, list[str]]) -> list[str]:
    """Return what an upload still lacks."""
    missing = []
    if "Project-URL" not in metadata:
        missing.append("pyproject.toml has no address of the repository: see 'The address' in docs/contributing.md")
    return missing


class Release:
    """The steps of a release in a scratch folder; results go into the output folder."""

    def __init__(self, scratch: Path, output: Path) -> None:
        self.checkout, self.scratch, self.output = scratch / "mimesh", scratch, output
        self.tools = scratch / "tools" / "bin" / "python"
        self.environment = scratch / "venv" / "bin"
        # The caller's own packages and constraints must not reach what is built and installed here.
        dropped = ("PYTHONPATH", "PYTHONHOME", "PIP_CONSTRAINT", "VIRTUAL_ENV")
        self.variables = {name: value for name, value in os.environ.items() if name not in dropped}

    def clone(self, revision: str) -> str:
        """Clone a revision of this repository and return its commit."""
        self._run("git", "clone", "--quiet", "--no-checkout", str(ROOT), str(self.checkout))
        commit = self._text("git", "-C", str(ROOT), "rev-parse", f"{revision}^{{commit}}").strip()
        self._run("git", "-C", str(self.checkout), "checkout", "--quiet", "--detach", commit)
        return commit

    def build(self) -> tuple[Path, Path]:
        """Build the source archive, from it the wheel, check both, and return their paths: wheel, source archive."""
        self._run(sys.executable, "-m", "venv", str(self.tools.parents[1]))
        self._run(str(self.tools), "-m", "pip", "install", "--quiet", *TOOLS)
        self._run(str(self.tools), "-m", "build", "--outdir", str(self.output), str(self.checkout))
        [wheel], [source] = self.output.glob("*.whl"), self.output.glob("mimesh-[0-9]*.tar.gz")
        self._run(str(self.tools), "-m", "twine", "check", "--strict", str(wheel), str(source))
        check_size(wheel)
        check_size(source)
        if links := relative_links(wheel_metadata(wheel)["Description"][0]):
            raise InputError(f"README.md: expected no relative link in the wheel, found {links}; see pyproject.toml")
        return wheel, source

    def install(self, wheel: Path) -> None:
        """Install the wheel into a new environment without anything else, run the demo there."""
        # Without pip, so that the bill of materials has no tool of the environment.
        self._run(sys.executable, "-m", "venv", "--without-pip", str(self.environment.parent))
        target = ("--python", str(self.environment / "python"))
        self._run(str(self.tools), "-m", "pip", *target, "install", "--quiet", str(wheel))
        command = str(self.environment / "mimesh")
        self._run(command, "doctor")
        self._run(command, "demo", "--quiet", "-o", str(self.scratch / "demo"))
        assert (self.scratch / "demo" / "result.glb").stat().st_size > 0

    def bill_of_materials(self, version: str) -> dict:
        """Write the SBOM (CycloneDX JSON) of the environment and of what the wheel bundles, and return it."""
        path = self.output / f"mimesh-{version}.cdx.json"
        self._run(
            *(str(self.tools), "-m", "cyclonedx_py", "environment", "--output-reproducible", "--spec-version", "1.6"),
            *("--pyproject", str(self.checkout / "pyproject.toml"), "--output-file", str(path)),
            str(self.environment / "python"),
        )
        package = json.loads((self.checkout / "web" / "package.json").read_text())
        licences = listed_licences((self.checkout / "THIRD_PARTY.md").read_text())
        bill = with_bundled(json.loads(path.read_text()), package, licences)
        path.write_text(json.dumps(bill, indent=2) + "\n")
        self._run(str(self.tools), "-c", VALIDATION, str(path))
        return bill

    def weights(self, version: str, commit: str) -> None:
        """Write the archive of the weights that are in no other archive."""
        name = f"mimesh-weights-{version}"
        options = ("--format=tar.gz", f"--prefix={name}/", "-o", str(self.output / f"{name}.tar.gz"))
        self._run("git", "-C", str(self.checkout), "archive", *options, commit, *WEIGHTS, "LICENSE")

    def blender(self) -> None:
        """Build the Blender extension for the platform of this machine."""
        script = self.checkout / "scripts" / "build_blender.py"
        self._run(str(self.tools), str(script), "--output", str(self.output))

    def _run(self, *command: str) -> None:
        subprocess.run(command, check=True, env=self.variables, cwd=self.scratch)

    def _text(self, *command: str) -> str:
        return subprocess.run(command, check=True, env=self.variables, capture_output=True, text=True).stdout


def make(output: Path, revision: str, blender: bool) -> dict:
    """Run all steps and return the report."""
    output.mkdir(parents=True, exist_ok=True)
    if found := sorted(path.name for path in output.iterdir()):
        raise InputError(f"{output}: expected an empty folder, found {', '.join(found)}; remove them or name another")
    with tempfile.TemporaryDirectory() as folder:
        release = Release(Path(folder), output)
        commit = release.clone(revision)
        version = version_of(release.checkout)
        message = tag_message((release.checkout / "CHANGELOG.md").read_text(), version)
        wheel, _ = release.build()
        release.install(wheel)
        licences = check_licences(
            release.bill_of_materials(version), (release.checkout / "THIRD_PARTY.md").read_text(encoding="utf-8")
        )
        release.weights(version, commit)
        if blender:
            release.blender()
    (output / "tag-message.txt").write_text(message)
    files = sorted(path for path in output.iterdir())
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    (output / "SHA256SUMS").write_text("".join(f"{digest}  {name}\n" for name, digest in digests.items()))
    sizes = {path.name: path.stat().st_size for path in files}
    return {
        "version": version,
        "commit": commit,
        "bytes": sizes,
        "licences": licences,
        "to_do": to_do(wheel_metadata(wheel)),
    }


def main() -> None:
    """Parse the command line, make the release, print its report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist" / "release")
    parser.add_argument(
        "--revision", default="HEAD", help="commit to release; changes that are not committed are not in"
    )
    parser.add_argument("--blender", action="store_true", help="the Blender extension of this platform, too")
    args = parser.parse_args()
    try:
        report = make(args.output.resolve(), args.revision, args.blender)
    except InputError as error:
        sys.exit(str(error))
    print(json.dumps(report, indent=2))
    print(f"next: git tag -s v{report['version']} -F {args.output}/tag-message.txt {report['commit']}")


if __name__ == "__main__":
    main()
