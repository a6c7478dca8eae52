"""What the definitions of a Python file are and what they use, read from its source without running it."""

from __future__ import annotations

import ast
import copy
import functools
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda, ast.comprehension)
"""What binds names of its own."""


class Import(NamedTuple):
    """What a local name is bound to: a module, or an attribute of it."""

    module: str
    path: list[str]


@dataclass
class Module:
    """A parsed file, without docstrings."""

    name: str
    package: str
    """What relative imports start from."""
    definitions: dict[str, list[ast.stmt]] = field(default_factory=lambda: defaultdict(list))
    """Top-level statements by the names they bind or change; "" are those that do neither."""
    imports: dict[str, Import] = field(default_factory=dict)
    typing_imports: dict[str, Import] = field(default_factory=dict)
    """Those of `imports`, and those for annotations alone."""
    _uses: dict[str, list[References]] = field(default_factory=dict)

    @classmethod
    @functools.cache
    def parse(cls, source: str, name: str, is_package: bool) -> Module:
        """Sort the top-level statements of a file by what they bind; done once for all copies of it that are alike."""
        module = cls(name, name if is_package else name.rpartition(".")[0])
        for statement in _Bare().visit(ast.parse(source)).body:
            imports = module.imported(statement)
            module.typing_imports |= imports
            if _only_for_types(statement):
                continue
            module.imports |= imports
            if not isinstance(statement, ast.Import | ast.ImportFrom):
                for bound in _bound(statement) or {""}:
                    module.definitions[bound].append(statement)
        return module

    def uses(self, name: str) -> list[References]:
        """Return what each statement of a definition uses."""
        if name not in self._uses:
            self._uses[name] = [References.of(statement, self) for statement in self.statements(name)]
        return self._uses[name]

    def binds(self, name: str) -> bool:
        """Whether a name of the module is something of it, not a variable or a built-in."""
        return name in self.definitions or name in self.imports

    def imported(self, statement: ast.AST) -> dict[str, Import]:
        """Return what the imports in a statement bind; those in functions are the functions' own."""
        found = {}
        for node in _outside_functions(statement):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    first = alias.name if alias.asname else alias.name.partition(".")[0]
                    found[alias.asname or first] = Import(first, [])
            elif isinstance(node, ast.ImportFrom):
                parents = self.package.split(".")
                start = parents[: len(parents) + 1 - node.level] if node.level else []
                origin = ".".join([*start, *([node.module] if node.module else [])])
                found |= {alias.asname or alias.name: Import(origin, [alias.name]) for alias in node.names}
        return found

    def statements(self, name: str) -> list[ast.stmt]:
        """Return the statements of a definition; a class comes without its functions, which are definitions."""
        top, _, function = name.partition(".")
        found = self.definitions.get(top, [])
        if function:
            return [node for outer in found for node in _functions(outer) if node.name == function]
        return [_without_functions(statement) for statement in found]

    def functions(self, name: str) -> set[str]:
        """Return the names of the functions of a class."""
        return {node.name for statement in self.definitions.get(name, []) for node in _functions(statement)}

    def members(self, name: str) -> set[str]:
        """Return the names that the body of a class binds."""
        classes = [statement for statement in self.definitions.get(name, []) if isinstance(statement, ast.ClassDef)]
        return {bound for node in classes for statement in node.body for bound in _bound(statement)}


class References(ast.NodeVisitor):
    """What a statement uses."""

    def __init__(self, module: Module) -> None:
        self.module = module
        self.tree = ""
        """The statement, as `ast.dump` writes it."""
        self.names: set[str] = set()
        """Dotted: "np.linalg.norm"."""
        self.checked: set[str] = set()
        """Names in the second argument of isinstance."""
        self.attributes: set[str] = set()
        self.strings: set[str] = set()
        self.imports: dict[str, Import] = {}
        """Those of functions."""
        self.bases: set[str] = set()
        """Names of a class's bases."""
        self.annotation: set[str] = set()
        """Names in the annotation of a function's result or of a variable."""

    @classmethod
    def of(cls, statement: ast.AST, module: Module) -> References:
        """Return what a statement uses."""
        used = cls(module)
        used.visit(statement)
        used.tree = ast.dump(statement)
        used.bases = used._names(*getattr(statement, "bases", ()))
        used.annotation = used._names(getattr(statement, "returns", None), getattr(statement, "annotation", None))
        return used

    def _names(self, *expressions: ast.expr | None) -> set[str]:
        inner = References(self.module)
        for expression in expressions:
            if expression is not None:
                inner.visit(expression)
        return inner.names

    def visit_Name(self, node: ast.Name) -> None:
        self.names.add(node.id)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.attributes.add(node.attr)
        dotted = _dotted(node)
        if dotted:
            self.names.add(dotted)
            self.attributes |= set(dotted.split("."))
        else:
            self.visit(node.value)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self.strings.add(node.value)
            self.attributes |= {node.value} if node.value.isidentifier() else set()

    def visit_Call(self, node: ast.Call) -> None:
        if isinstance(node.func, ast.Name) and node.func.id in ("isinstance", "issubclass") and len(node.args) == 2:
            self.visit(node.args[0])
            self.checked |= self._names(node.args[1])
        else:
            self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        for part in (*node.decorator_list, node.args, *node.body):
            self.visit(part)

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_arg(self, node: ast.arg) -> None:
        """Leave the annotation out."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self.visit(node.target)
        if node.value is not None:
            self.visit(node.value)

    def visit_If(self, node: ast.If) -> None:
        if not _only_for_types(node):
            self.generic_visit(node)

    def visit_Import(self, node: ast.Import | ast.ImportFrom) -> None:
        self.imports |= self.module.imported(node)

    visit_ImportFrom = visit_Import


class _Bare(ast.NodeTransformer):
    """Takes docstrings out, those of variables too."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node


def _only_for_types(statement: ast.AST) -> bool:
    """Whether a statement is `if TYPE_CHECKING:`."""
    return isinstance(statement, ast.If) and (_dotted(statement.test) or "").rpartition(".")[2] == "TYPE_CHECKING"


def _dotted(node: ast.AST) -> str | None:
    """Return "a.b.c" if that is all that an expression is."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        inner = _dotted(node.value)
        return inner and f"{inner}.{node.attr}"
    return None


def _outside_functions(statement: ast.AST) -> Iterator[ast.AST]:
    """Return a statement and all in it that runs when it does."""
    yield statement
    if not isinstance(statement, SCOPES):
        for inner in ast.iter_child_nodes(statement):
            yield from _outside_functions(inner)


def _bound(statement: ast.stmt) -> set[str]:
    """Return the names that a statement binds, or whose items or attributes it sets."""
    found = set()
    for node in _outside_functions(statement):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Store):
            while isinstance(node, ast.Attribute | ast.Subscript):
                node = node.value
            found |= {node.id} if isinstance(node, ast.Name) else set()
    return found


def _functions(statement: ast.stmt) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Return the functions of a class."""
    body = statement.body if isinstance(statement, ast.ClassDef) else []
    return [node for node in body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def _without_functions(statement: ast.stmt) -> ast.stmt:
    """Return the statement, a class without its functions."""
    if not isinstance(statement, ast.ClassDef):
        return statement
    without = copy.copy(statement)
    without.body = [node for node in statement.body if node not in _functions(statement)]
    return without
