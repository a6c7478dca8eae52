"""Module names until version 0.1 still work, and say what they are called now."""

import importlib
import sys

import pytest

from mimesh.old_names import ELSEWHERE, MOVED, RENAMED


@pytest.fixture(autouse=True)
def not_yet_imported():
    for name in MOVED:
        sys.modules.pop(f"mimesh.{name}", None)


@pytest.mark.parametrize("old", MOVED)
def test_an_old_module_is_the_new_one_with_a_warning(old):
    new = importlib.import_module(f"mimesh.{MOVED[old]}")
    with pytest.warns(DeprecationWarning, match="is now") as found:
        module = importlib.import_module(f"mimesh.{old}")
    assert any(f"mimesh.{old} is now mimesh.{MOVED[old]};" in str(each.message) for each in found)
    public = [name for name in vars(new) if not name.startswith("_") and (old, name) not in RENAMED]
    assert public
    assert all(getattr(module, name) is getattr(new, name) for name in public)


@pytest.mark.parametrize(("old", "name"), [*RENAMED, *ELSEWHERE])
def test_an_old_name_is_found_where_it_is_now(old, name):
    with pytest.warns(DeprecationWarning, match="the old name goes"):
        module = importlib.import_module(f"mimesh.{old}")
    home = importlib.import_module(f"mimesh.{ELSEWHERE.get((old, name), MOVED[old])}")
    assert getattr(module, name) is getattr(home, RENAMED.get((old, name), name))


def test_a_module_that_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("mimesh.meshes")


def test_importing_from_an_old_package_imports_its_module():
    with pytest.warns(DeprecationWarning, match="is now"):
        from mimesh.view import sheet  # pyright: ignore[reportMissingImports]
    assert sheet.strip is importlib.import_module("mimesh.render.sheet").strip
