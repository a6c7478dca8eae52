"""Read, copy and write material libraries (.mtl) of OBJ files and the images they refer to."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable
from pathlib import Path, PureWindowsPath

from ..core.mesh import Material, Mesh
from ..core.printable import numbered, plain
from .atomic import whole_file, written
from .beside import find_beside, is_there
from .text import decoded, encoded

_SIGNATURE = "# written by mimesh\n"
"""First line of libraries written here; only those are overwritten."""
DEFAULT = "default"
"""Name of the group or material of faces without one: OBJ has no statement that ends the previous one."""
LONGEST_STEM = 60
"""Characters of the name of an image, which file systems limit to 255 bytes."""
_MAPS = ("map_", "bump", "disp", "decal", "refl", "norm")
"""Prefixes of statements whose argument is an image file."""
IMAGE_TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp", b"\xabKTX": "image/ktx2"}
"""MIME type by the first bytes of an image: PNG and JPEG, and in glTF WebP and KTX2 through extensions."""
_NEW_MATERIAL = re.compile(r"^[ \t]*newmtl[ \t]+", re.MULTILINE)


def read_libraries(folder: Path, names: Iterable[str]) -> tuple[dict[str, Material], list[str], list[str]]:
    """Read material libraries; return the materials by name, the library and image files found, and images not found.

    File names are relative to `folder`. Read are the diffuse colour (Kd, taken as linear RGB), the opacity (d, or
    1 - Tr) and the diffuse image (map_Kd). Images of other statements (bump, gloss, reflection) are listed too. Missing
    files are skipped: a mesh can be read without its materials.
    """
    materials: dict[str, Material] = {}
    found: list[str] = []
    missing: list[str] = []
    for name in names:
        if not is_there(folder / name):
            continue
        found.append(name)
        text = "\n".join(decoded(line) for line in (folder / name).read_bytes().splitlines())
        for block in _NEW_MATERIAL.split(text)[1:]:
            material, images, lost = _read_material(block, folder, Path(name).parent)
            materials[material.name] = material
            found += images
            missing += lost
    return materials, list(dict.fromkeys(found)), list(dict.fromkeys(missing))


def read_image(path: Path) -> bytes | None:
    """Read a PNG or JPEG file; None for other formats, which `Material.texture` does not support."""
    content = path.read_bytes()
    return content if image_suffix(content) else None


def image_type(content: bytes) -> str | None:
    """Return the MIME type of an image from its first bytes; None for others."""
    return next((mime for magic, mime in IMAGE_TYPES.items() if content.startswith(magic)), None)


def image_suffix(content: bytes) -> str:
    """Return `.png` or `.jpg` by the first bytes of an image file, and an empty string for other formats."""
    return {"image/png": ".png", "image/jpeg": ".jpg"}.get(image_type(content) or "", "")


def write_image(content: bytes, folder: Path, stem: str) -> str:
    """Write an image into a folder under the first free name and return the name; an equal file there is reused."""
    stem = _file_name(safe_name(stem))[:LONGEST_STEM]
    places = ((name, written(folder / name)) for name in numbered(stem, suffix=image_suffix(content)))
    name, there = next(place for place in places if not place[1].exists() or place[1].read_bytes() == content)
    if not there.exists():
        with whole_file(folder / name) as temporary:
            temporary.write_bytes(content)
    return name


def copy_companions(names: Iterable[str], source: Path, target: Path) -> None:
    """Copy files that a mesh refers to from its folder `source` to the output folder `target`, keeping relative paths.

    Existing files are never overwritten. Absolute names and names with `..` are skipped, so that nothing is written
    outside of `target`.
    """
    if source.resolve() == target.resolve():
        return
    for name in names:
        is_inside = not Path(name).is_absolute() and ".." not in Path(name).parts
        if is_inside and (source / name).is_file() and not (target / name).exists():
            with whole_file(target / name) as temporary:
                shutil.copyfile(source / name, temporary)


def write_library(mesh: Mesh, path: Path) -> Path:
    """Write the materials of a mesh's parts as a .mtl file with its images beside it, and return the file's path.

    A library of that name that was not written by mimesh is not overwritten: a number is added to the name.
    """
    paths = (path.with_name(name) for name in numbered(path.stem, suffix=path.suffix))
    path = next(p for p in paths if not p.exists() or p.read_text("utf-8", "replace").startswith(_SIGNATURE))
    text = _SIGNATURE
    for material, name in material_names(mesh).items():
        red, green, blue, alpha = material.base_color
        text += f"newmtl {name}\nKd {red:.6g} {green:.6g} {blue:.6g}\nd {alpha:.6g}\n"
        if material.texture is not None:
            image = path.with_name(f"{path.stem}_{_file_name(name)}{image_suffix(material.texture)}")
            with whole_file(image) as temporary:
                temporary.write_bytes(material.texture)
            text += f"map_Kd {image.name}\n"
        text += "\n"
    with whole_file(path) as temporary:
        temporary.write_bytes(encoded(text))
    return path


def material_names(mesh: Mesh) -> dict[Material, str]:
    """Return a unique name in a new library for each material of a mesh; materials may have equal names in memory."""
    names: dict[Material, str] = {}
    used_names = {DEFAULT} if any(part.material is None for part in mesh.parts) else set()
    for material in (part.material for part in mesh.parts if part.material):
        if material not in names:
            # Images are named after it: names that differ in case, or in characters replaced by `_`, are not free.
            free = numbered(safe_name(material.name))
            names[material] = next(name for name in free if used_names.isdisjoint(_equal_names(name)))
            used_names |= _equal_names(names[material])
    return names


def _equal_names(name: str) -> set[str]:
    return {name.lower(), _file_name(name).lower()}


def _file_name(name: str) -> str:
    """Replace the characters of a material name that are not portable in file names."""
    return "".join(character if character.isalnum() or character in "-_." else "_" for character in name)


def safe_name(name: str) -> str:
    """Return a name that is one word of an OBJ or MTL file: white space and what is not printable become `_`.

    An empty name becomes `unnamed`.
    """
    return plain("_".join(name.split())).replace("\\", "_") or "unnamed"  # a backslash continues a line


def _read_material(block: str, folder: Path, library_folder: Path) -> tuple[Material, list[str], list[str]]:
    """Read the statements after one `newmtl`; return the material, all image files found, relative to `folder`, and
    the names of those not found."""
    lines = block.splitlines()
    pairs = [line.split(None, 1) for line in lines[1:]]
    values = {pair[0].lower(): pair[1].strip() for pair in pairs if len(pair) == 2}
    image = _find_image(values.get("map_kd", ""), folder, library_folder)
    color = _numbers(values.get("kd", ""), 3) or [0.8, 0.8, 0.8]
    opacity = _numbers(values.get("d", ""), 1) or [1.0 - t for t in _numbers(values.get("tr", ""), 1)] or [1.0]
    texture = read_image(folder / image) if image else None
    name = lines[0].strip() if lines else ""
    maps = [text for word, text in values.items() if word.startswith(_MAPS)]
    images = [_find_image(text, folder, library_folder) for text in maps]
    missing = [
        PureWindowsPath(_image_names(text)[-1]).name for text, found in zip(maps, images, strict=True) if not found
    ]
    material = Material(name, (color[0], color[1], color[2], opacity[0]), texture)
    return material, [name for name in images if name], [name for name in missing if name]


def _numbers(text: str, count: int) -> list[float]:
    """Read the first `count` numbers of a statement; empty where there are fewer or other words."""
    try:
        numbers = [float(word) for word in text.split()[:count]]
    except ValueError:
        return []  # such as "Kd spectral file.rfl", which has no RGB equivalent
    return numbers if len(numbers) == count else []


def _find_image(text: str, folder: Path, library_folder: Path) -> str:
    """Find the image of a map statement; return its name relative to `folder`, empty where there is no such file."""
    found = find_beside(folder / library_folder, _image_names(text))
    return "" if found is None else (library_folder / found).as_posix()


def _image_names(text: str) -> list[str]:
    """List the names that the argument of a map statement may mean; the last is without its options."""
    words = text.split()
    # Options come before the name, each with one argument or up to three numbers: "-s 1 1 1", "-bm 0.5", "-clamp on".
    while words and words[0].startswith("-"):
        words = words[2:]
        while words and _numbers(words[0], 1):
            words = words[1:]
    # The text as a whole is tried first: the name itself may begin with "-" or contain spaces.
    return [text, " ".join(words)]
