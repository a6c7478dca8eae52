"""Tables are Markdown in files and pipes, and fit the width of a terminal."""

import re
import sys

import pytest

from mimesh.commands.terminal import say_tables

TEXT = "Of one test:\n\n| row | figure [e4] |\n|---|---|\n| `copy` of the driving vertices | 1.5 ± 0.2 |\n\nEnd."


def test_a_table_in_a_pipe_is_markdown(capsys):
    say_tables(TEXT)
    assert capsys.readouterr().out == TEXT + "\n"


@pytest.mark.parametrize("width", [30, 100])
def test_a_table_on_a_terminal_fits_it_and_loses_nothing(width, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(width))
    say_tables(TEXT)
    out = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out)
    assert max(map(len, out.splitlines())) <= width
    assert "|" not in out
    assert {"Of", "End.", "row", "figure", "[e4]", "copy", "vertices", "1.5", "±", "0.2"} <= set(out.split())
