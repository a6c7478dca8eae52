"""Build the Blender extension `dist/mimesh-blender-<version>-<platform>.zip`, which contains all wheels that it needs.

    python scripts/build_blender.py [--platform windows-x64] [--python 3.11] [--output dist]

One archive is for Blender 4.5 and 5.0 (Python 3.11) and later versions (3.13): Blender unpacks the wheels for its own
Python and skips the others. NumPy is part of Blender. Builds of one commit with the same wheels are equal byte by byte.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "blender"
PYTHONS = ("3.11", "3.13")
"""Python versions of Blender 4.5 and 5.0, and of 5.1 and later."""
PACKAGES = ("scipy", "onnxruntime", "jaxtyping", "wadler-lindig", "threadpoolctl")
"""Packages that a transfer imports; the dependencies of onnxruntime are for tools that are not used."""
PLATFORMS = {
    "linux-x64": [f"manylinux_2_{minor}_x86_64" for minor in (17, 24, 27, 28)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{major}_0_{arch}" for major in (11, 12, 13, 14) for arch in ("arm64", "universal2")],
}
"""Blender's names of platforms, and the tags of wheels for them."""
EARLIEST = (1980, 1, 1, 0, 0, 0)
"""Date of all files in the archive, fixed for reproducible builds."""


def build(platform: str, pythons: list[str], output: Path) -> Path:
    """Write the archive and return its path."""
    with tempfile.TemporaryDirectory() as folder:
        wheels = Path(folder)
        _pip("wheel", "--no-deps", "--wheel-dir", folder, str(ROOT))
        for python in pythons:
            _download(platform, python, wheels)
        output.mkdir(parents=True, exist_ok=True)
        path = output / f"mimesh-blender-{_version()}-{platform}.zip"
        _write(path, platform, sorted(wheels.glob("*.whl")))
    return path


def _download(platform: str, python: str, wheels: Path) -> None:
    """Download the wheels of PACKAGES for a platform and Python version to a folder."""
    tags = [option for tag in PLATFORMS[platform] for option in ("--platform", tag)]
    pinned = ["--constraint", str(ROOT / "constraints.txt")]
    _pip(
        *("download", "--no-deps", "--only-binary=:all:", "--python-version", python),
        *(*tags, *pinned, "--dest", str(wheels), *PACKAGES),
    )


def _write(path: Path, platform: str, wheels: list[Path]) -> None:
    """Write the archive: the extension's files and the wheels, with platform and wheels listed in its manifest."""
    content = {file.name: file.read_bytes() for file in FOLDER.iterdir() if file.is_file()}
    lists = (
        f'platforms = ["{platform}"]\nwheels = [\n'
        + "".join(f'  "./wheels/{wheel.name}",\n' for wheel in wheels)
        + "]\n"
    )
    content["blender_manifest.toml"] += lists.encode()
    content |= {f"wheels/{wheel.name}": wheel.read_bytes() for wheel in wheels}
    partial = path.with_suffix(".partial")
    with zipfile.ZipFile(partial, "w") as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, EARLIEST)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_STORED if name.endswith(".whl") else zipfile.ZIP_DEFLATED
            archive.writestr(entry, content[name])
    partial.replace(path)


def _version() -> str:
    """Read the version of the extension, which must be that of the package.

    Raises:
        ValueError: they differ.
    """
    extension = tomllib.loads((FOLDER / "blender_manifest.toml").read_text())["version"]
    package = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    if extension != package:
        raise ValueError(f"blender_manifest.toml: expected version {package}, found {extension}; make them equal")
    return extension


def _pip(*arguments: str) -> None:
    """Run pip."""
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *arguments]
    subprocess.run(command, check=True)


def main() -> None:
    """Parse the command line, build, and print what was written."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--platform", choices=PLATFORMS, default="linux-x64")
    parser.add_argument(
        "--python", choices=PYTHONS, action="append", help="only for Blender with this Python, at half the size"
    )
    parser.add_argument("--output", type=Path, default=ROOT / "dist")
    args = parser.parse_args()
    path = build(args.platform, args.python or list(PYTHONS), args.output)
    print(f"{path} ({path.stat().st_size / 1e6:.0f} MB)")
    print("In Blender: Edit > Preferences > Get Extensions > Install from Disk")


if __name__ == "__main__":
    main()
