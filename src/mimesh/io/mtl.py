"""Material libraries (.mtl) and the images they name: read for looks, copied along, written for new OBJ files."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from ..core.mesh import Material, Mesh
from .atomic import whole_file
from .beside import is_there
from .text import decoded

_SIGNED = "# written by mimesh\n"
"""First line of our own libraries: those may be written over."""
DEFAULT = "default"
"""What faces without a group or a material are given to, for in an OBJ nothing ends the ones before."""
_MAPS = ("map_", "bump", "disp", "decal", "refl", "norm")
"""Beginnings of the statements that name an image."""
_NEW_MATERIAL = re.compile(r"^[ \t]*newmtl[ \t]+", re.MULTILINE)


def read_libraries(folder: Path, names: Iterable[str]) -> tuple[dict[str, Material], list[str]]:
    """Materials of the libraries that can be read, and the files found (libraries and images), relative to `folder`.

    Takes name, diffuse colour (Kd, taken as linear), opacity (d or Tr) and the diffuse image (map_Kd). Images of other
    statements (bumps, gloss, reflections) are found too. A library or an image that is not there costs the looks, never
    the mesh.
    """
    materials: dict[str, Material] = {}
    found: list[str] = []
    for name in names:
        if not is_there(folder / name):
            continue
        found.append(name)
        text = "\n".join(decoded(line) for line in (folder / name).read_bytes().splitlines())
        for block in _NEW_MATERIAL.split(text)[1:]:
            material, images = _read_material(block, folder, Path(name).parent)
            materials[material.name] = material
            found += images
    return materials, list(dict.fromkeys(found))


def read_image(path: Path) -> bytes | None:
    """Content of a PNG or JPEG file; None for anything else, which `Material.texture` does not hold."""
    content = path.read_bytes()
    return content if image_suffix(content) else None


def image_suffix(content: bytes) -> str:
    """`.png` or `.jpg` by the first bytes of the file, empty if it is neither."""
    if content.startswith(b"\x89PNG"):
        return ".png"
    return ".jpg" if content.startswith(b"\xff\xd8") else ""


def copy_companions(names: Iterable[str], source: Path, target: Path) -> None:
    """Copy the files a mesh refers to (relative names) from its folder to the output's, keeping relative paths.

    Never overwrites, and writes nothing outside of `target`: a name with `..` or an absolute one is left where it is.
    """
    if source.resolve() == target.resolve():
        return
    for name in names:
        inside = not Path(name).is_absolute() and ".." not in Path(name).parts
        if inside and (source / name).is_file() and not (target / name).exists():
            with whole_file(target / name) as temporary:
                shutil.copyfile(source / name, temporary)


def write_library(mesh: Mesh, path: Path) -> Path:
    """Write the materials of a mesh's parts as a .mtl file, with its images beside it; returns the name it took.

    A library of that name that somebody else wrote is left alone: ours then takes the next free number.
    """
    wanted, number = path, 2
    while path.exists() and not path.read_text("utf-8", "replace").startswith(_SIGNED):
        path, number = wanted.with_stem(f"{wanted.stem}-{number}"), number + 1
    text = _SIGNED + "".join(_material_text(name, material, path) for material, name in material_names(mesh).items())
    with whole_file(path) as temporary:
        temporary.write_text(text, "utf-8")
    return path


def material_names(mesh: Mesh) -> dict[Material, str]:
    """What each material of a mesh is called in a new file: a name of its own, whatever it was called before."""
    names: dict[Material, str] = {}
    taken = {DEFAULT} if any(part.material is None for part in mesh.parts) else set()
    for material in (part.material for part in mesh.parts if part.material):
        if material not in names:
            names[material] = _free(safe_name(material.name), taken)
            taken |= {names[material].lower(), _file_word(names[material]).lower()}
    return names


def _free(name: str, taken: set[str]) -> str:
    """The name, or with the next free number; images are called after it, on systems that know no capitals too."""
    wanted, number = name, 2
    while name.lower() in taken or _file_word(name).lower() in taken:
        name, number = f"{wanted}-{number}", number + 1
    return name


def _file_word(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)


def safe_name(name: str) -> str:
    """A name that survives as one word of an OBJ or MTL file."""
    return "_".join(name.split()) or "unnamed"


def _material_text(name: str, material: Material, path: Path) -> str:
    red, green, blue, alpha = material.base_color
    text = f"newmtl {name}\nKd {red:.6g} {green:.6g} {blue:.6g}\nd {alpha:.6g}\n"
    if material.texture is None:
        return text + "\n"
    image = path.with_name(f"{path.stem}_{_file_word(name)}{image_suffix(material.texture)}")
    with whole_file(image) as temporary:
        temporary.write_bytes(material.texture)
    return text + f"map_Kd {image.name}\n\n"


def _read_material(block: str, folder: Path, inner: Path) -> tuple[Material, list[str]]:
    """A material, and all images that it names and that are there."""
    lines = block.splitlines()
    pairs = [line.split(None, 1) for line in lines[1:]]
    values = {pair[0].lower(): pair[1].strip() for pair in pairs if len(pair) == 2}
    image = _find_image(values.get("map_kd", ""), folder, inner)
    color = _numbers(values.get("kd", ""), 3) or [0.8, 0.8, 0.8]
    opacity = _numbers(values.get("d", ""), 1) or [1.0 - t for t in _numbers(values.get("tr", ""), 1)] or [1.0]
    texture = read_image(folder / image) if image else None
    name = lines[0].strip() if lines else ""
    others = [_find_image(text, folder, inner) for word, text in values.items() if word.startswith(_MAPS)]
    return Material(name, (color[0], color[1], color[2], opacity[0]), texture), [name for name in others if name]


def _numbers(text: str, count: int) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()[:count]]
    except ValueError:
        return []  # "Kd spectral file.rfl" and the like say nothing we can hold
    return numbers if len(numbers) == count else []


def _find_image(text: str, folder: Path, inner: Path) -> str:
    """The image a map statement names, relative to `folder`; also looked for by its bare name beside the library."""
    words = text.split()
    while words and words[0].startswith("-"):  # "-s 1 1 1", "-bm 0.5", "-clamp on", ...
        words = words[2:]
        while words and _numbers(words[0], 1):
            words = words[1:]
    for statement in (text, " ".join(words)):
        name = statement.replace("\\", "/")
        for candidate in (name, name.rpartition("/")[2]):
            if candidate and is_there(folder / inner / candidate):
                return (inner / candidate).as_posix()
    return ""
