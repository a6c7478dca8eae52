"""Generates the reference of the command line from the commands themselves, while the site is built."""

from __future__ import annotations

import typer
from typer.main import get_command

from mimesh.cli import app
from mimesh.evaluate.markdown import markdown_table


def command_reference() -> str:
    """Return one Markdown section per command: description, usage, arguments, and options with their defaults."""
    group = get_command(app)
    context = typer.Context(group, info_name="mimesh")
    return "\n\n".join(_section(command, context) for command in group.commands.values())


def _section(command, parent) -> str:
    context = typer.Context(command, info_name=command.name, parent=parent)
    usage = " ".join(command.collect_usage_pieces(context)).replace("{", "").replace("}", "")
    parts = [f"## mimesh {command.name}", _text(command.help), f"```text\nmimesh {command.name} {usage}\n```"]
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option"]
    if arguments:
        parts.append(
            markdown_table(["takes", ""], [[f"`{p.metavar or p.name.upper()}`", _text(p.help)] for p in arguments])
        )
    parts.append(markdown_table(["option", "", "unless given"], [_option(p) for p in options]))
    return "\n\n".join(part for part in parts if part)


def _option(option) -> list[str]:
    """Return the row of an option: names and value, help, default."""
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    takes = "" if option.is_flag else f" `{option.metavar or option.type.name.upper().split()[0]}`"
    return [names + takes, _text(option.help), _default(option)]


def _default(option) -> str:
    if option.default is None or option.default == "" or option.default == []:
        return "required" if option.required else ""
    if option.is_flag:
        return f"`{(option.opts if option.default else option.secondary_opts)[0]}`" if option.secondary_opts else ""
    return f"`{option.default}`"


def _text(text: str | None) -> str:
    """Return a help text as the content of a table cell; vertical bars would end the cell."""
    return (text or "").replace("|", "\\|").strip()
