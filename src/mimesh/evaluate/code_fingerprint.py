"""Fingerprint the source code that a figure can depend on, so that an edit outdates only the figures it may change.

The unit is not the file but the definition: a top-level function, class or assignment, or a function of a class. The
source is parsed (`ast`), never run. From the class of the method, the class of the protocol and the function that
measures, references are followed as Python resolves them: names of the module, imports at the top or inside a function,
names that a package imports from its files. Imports under TYPE_CHECKING and annotations do nothing at run time and are
left out. Files would be too coarse: all protocols of meshes share one, and `pipeline.transfer` is one import away from
the renderer (`Result.player`), so that nearly every edit would outdate every figure.

Which class an object has is not known without running the code, so `x.prepare` reaches `prepare` of every reached
class; a class named only in `isinstance(x, C)` is not made there and is not reached by it. (This is rapid type
analysis: D. F. Bacon, P. F. Sweeney, OOPSLA 1996.) Strings that are identifiers count as attributes too, because of
`getattr`. Functions called `__this__`, and all functions of classes with a base from elsewhere, are reached with their
class. What cannot be resolved reaches all of its module: where the analysis is not exact, it outdates too many figures.
Readers of files are an example: `pipeline.transfer` takes paths too, so every figure depends on them. Not seen are
modules imported by a computed name, and attributes of modules that other modules set.

A function that finds a method by its name refers to all methods, and returns one. No list says which functions these
are: their annotation mentions `Method` (`-> Method`), and they choose among the classes that have all members of
`Method`. Of those only the measured one is followed, so a method that itself finds others by name would be read too
narrowly (there is none). How networks are opened counts for all methods, as one function opens all of them.

Data: an .npz file counts if a reached definition writes its name. One whose name no file writes whole counts if a
definition in its folder is reached. Networks (.onnx) have a fingerprint of their own.

Hashed is the syntax tree without comments and docstrings, and what its names refer to. Rewording and formatting outdate
nothing; moving or renaming a definition does, and so does another minor version of Python.
"""

from __future__ import annotations

import functools
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from ..methods import Method
from .parsed_source import Import, Module

PACKAGE = Path(__file__).parents[1]
DATA = ".npz"
"""Suffix of the data that code reads from the package."""
PLAIN_BASES = ("object", "typing.Generic", "typing.NamedTuple", "typing.Protocol")
"""Bases from elsewhere that call no function of a class by its name."""


class Symbol(NamedTuple):
    """A definition: `name` of a module, "Class.function" for a function of a class, "" for its loose statements."""

    module: str
    name: str


METHOD = Symbol(Method.__module__, Method.__qualname__)
Target = Symbol | str
"""What a name refers to; a str is a dotted name from outside the package."""


@dataclass
class Definition:
    """What a definition consists of and refers to."""

    content: bytes = b""
    targets: set[Symbol] = field(default_factory=set)
    alternatives: set[Symbol] = field(default_factory=set)
    """The methods among `targets`, if this finds methods by name."""
    functions: dict[str, Symbol] = field(default_factory=dict)
    """Functions of a class that are reached once their name is used."""
    attributes: set[str] = field(default_factory=set)
    """Names of attributes it uses, of whatever objects."""
    strings: set[str] = field(default_factory=set)


class PackageSource:
    """The source of this package, or another copy of it; each file is parsed once, when it is first asked for."""

    def __init__(self, folder: Path = PACKAGE) -> None:
        name = __name__.partition(".")[0]
        files = {path.relative_to(folder).with_suffix("").parts: path for path in folder.rglob("*.py")}
        self.folder = folder
        self.paths = {".".join([name, *parts]).removesuffix(".__init__"): path for parts, path in files.items()}
        self._modules: dict[str, Module] = {}
        self._definitions: dict[Symbol, Definition] = {}

    def fingerprint(self, method: type, *roots: Callable) -> int:
        """Return the CRC-32 of all definitions and data files that the figures of a method can depend on.

        Args:
            method: the class of the measured method.
            roots: what else the figures come from: the class of the protocol, the function that measures. Those that
                are not of this package are left out.
        """
        total = 0
        for name, content in self.reachable(method, *roots).items():
            total = zlib.crc32(name.encode() + content, total)
        return total

    def reachable(self, method: type, *roots: Callable) -> dict[str, bytes]:
        """Return what `fingerprint` hashes, by "module:definition" or the path of a data file, sorted."""
        named = [Symbol(root.__module__, root.__qualname__) for root in (method, *roots)]
        reached = self._reach([symbol for symbol in named if symbol.module in self.paths], named[0])
        found = {f"{symbol.module}:{symbol.name}": self.definition(symbol).content for symbol in reached}
        found |= {path.relative_to(self.folder).as_posix(): path.read_bytes() for path in self._data_files(reached)}
        return dict(sorted(found.items()))

    def _reach(self, roots: Iterable[Symbol], method: Symbol) -> set[Symbol]:
        """Return all definitions that the roots can use; of the methods that are found by name, `method` alone."""
        reached, attributes = set(), set()
        todo = [part for root in roots for part in self._whole(root)]
        waiting: dict[str, list[Symbol]] = defaultdict(list)  # functions of reached classes, until their name is used
        while todo:
            symbol = todo.pop()
            if symbol in reached:
                continue
            reached.add(symbol)
            definition = self.definition(symbol)
            todo += definition.targets - (definition.alternatives - {method})
            for name, function in definition.functions.items():
                (todo if name in attributes else waiting[name]).append(function)
            for name in definition.attributes - attributes:
                todo += waiting.pop(name, ())
            attributes |= definition.attributes
        return reached

    def _data_files(self, reached: Iterable[Symbol]) -> list[Path]:
        """Return the data files that reached definitions name, and those named nowhere in the folder of one."""
        strings = {string for symbol in reached for string in self.definition(symbol).strings}
        folders = {self.paths[symbol.module].parent for symbol in reached}
        return [
            path
            for path in self.folder.rglob(f"*{DATA}")
            if any(path.name in string for string in strings)
            or (path.parent in folders and path.name not in self._text)
        ]

    @functools.cached_property
    def _text(self) -> str:
        """All source, to look for names of files."""
        return "\n".join(path.read_text(encoding="utf-8") for path in self.paths.values())

    def module(self, name: str) -> Module:
        """Return a module, parsed once."""
        if name not in self._modules:
            path = self.paths[name]
            self._modules[name] = Module.parse(path.read_text(encoding="utf-8"), name, path.stem == "__init__")
        return self._modules[name]

    def definition(self, symbol: Symbol) -> Definition:
        """Return what a definition consists of and refers to, read once."""
        if symbol not in self._definitions:
            self._definitions[symbol] = self._read(symbol)
        return self._definitions[symbol]

    def _read(self, symbol: Symbol) -> Definition:
        module, made, written = self.module(symbol.module), Definition(), []
        for used in module.uses(symbol.name):
            named = {name: self._named(module, used.imports, name) for name in used.names}
            checked = {name: self._named(module, used.imports, name) for name in used.checked - used.names}
            # What isinstance says of a typing.Protocol depends on its members.
            named |= {name: found for name, found in checked.items() if any(map(self._is_protocol, found))}
            targets = {target for found in named.values() for target in found if isinstance(target, Symbol)}
            if METHOD in self._targets(module, module.typing_imports, used.annotation):
                made.alternatives |= {target for target in targets if self._is_method(target)}
            made.targets |= targets
            made.attributes |= used.attributes
            made.strings |= used.strings
            written.append(used.tree)
            written += sorted(f"{name}: {' '.join(sorted(map(str, found)))}" for name, found in named.items())
        made.content = "\n".join(written).encode()
        functions = {name: Symbol(symbol.module, f"{symbol.name}.{name}") for name in module.functions(symbol.name)}
        called_by_others = any(isinstance(base, str) and base not in PLAIN_BASES for base in self._bases(symbol))
        made.functions = {} if called_by_others else {n: f for n, f in functions.items() if not n.startswith("__")}
        made.targets |= {function for name, function in functions.items() if name not in made.functions}
        if symbol.name:
            # To import a module runs what stands loose in it and in the packages that hold it.
            parts = symbol.module.split(".")
            holders = (".".join(parts[:k]) for k in range(1, len(parts) + 1))
            made.targets |= {Symbol(holder, "") for holder in holders if "" in self.module(holder).definitions}
        return made

    def _named(self, module: Module, imports: dict[str, Import], name: str) -> set[Target]:
        """Resolve a dotted name where `imports` are those of the function it stands in; empty for variables."""
        first, *rest = name.split(".")
        if first in imports:
            return self._resolve(imports[first].module, [*imports[first].path, *rest])
        return self._resolve(module.name, [first, *rest]) if module.binds(first) else set()

    def _resolve(self, name: str, path: list[str]) -> set[Target]:
        """Follow attributes from a module on, through what packages import from their files, to a definition."""
        while name in self.paths and path:
            module, first = self.module(name), path[0]
            if first in module.definitions:
                return {Symbol(name, first)}
            found = module.imports.get(first)
            if found is not None and found != (name, [first]):  # else the import of a module of its own package
                name, path = found.module, [*found.path, *path[1:]]
            elif f"{name}.{first}" in self.paths:
                name, path = f"{name}.{first}", path[1:]
            else:
                break
        if name not in self.paths:
            return {".".join([name, *path])}
        return {Symbol(name, definition) for definition in self.module(name).definitions}

    def _whole(self, symbol: Symbol) -> set[Symbol]:
        """Return a definition, and of a class all functions, those of its bases too."""
        found = {
            target for target in self._resolve(symbol.module, symbol.name.split(".")) if isinstance(target, Symbol)
        }
        functions = {function for part in found for function in self.definition(part).functions.values()}
        bases = {base for part in found for base in self._bases(part) if isinstance(base, Symbol)}
        return found.union(functions, *map(self._whole, bases))

    def _bases(self, symbol: Symbol) -> set[Target]:
        """Resolve the bases of a class; empty for other definitions."""
        module = self.module(symbol.module)
        names = {name for used in module.uses(symbol.name) for name in used.bases}
        return self._targets(module, module.imports, names) | {name for name in names if not module.binds(name)}

    def _targets(self, module: Module, imports: dict[str, Import], names: set[str]) -> set[Target]:
        return {target for name in names for target in self._named(module, imports, name)}

    def _is_protocol(self, target: Target) -> bool:
        return isinstance(target, Symbol) and "typing.Protocol" in self._bases(target)

    def _is_method(self, symbol: Symbol) -> bool:
        """Whether a definition is a class that has all members of `Method`."""
        return symbol != METHOD and self._members(METHOD) <= self._members(symbol)

    def _members(self, symbol: Symbol) -> set[str]:
        """Return the names that a class and its bases in the package bind."""
        found = set(self.module(symbol.module).members(symbol.name))
        return found.union(*(self._members(base) for base in self._bases(symbol) if isinstance(base, Symbol)))
