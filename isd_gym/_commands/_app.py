"""The typer application: the group of all commands, and a class for commands with repeated options."""

from __future__ import annotations

import math
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from .._common.errors import InputError

#: commands by purpose, in the order of the help; commands without a group come last
GROUPS = {
    "Drive and score": (
        "score",
        "show",
        "card",
        "policies",
        "networks",
        "sweep",
        "reproduce",
    ),
    "Train": ("train", "convert"),
    "Find missing physics": ("diagnose", "simulate"),
    "Data": ("inspect", "export"),
}


class CommandGroup(TyperGroup):
    """Lists of commands by purpose, each command with its whole first sentence."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        texts = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            texts[name] = " ".join(
                (command.help or "" if command else "").split("\n\n")[0].split()
            )
        for title, names in GROUPS.items():
            rows = [(name, texts.pop(name)) for name in names if name in texts]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
        if texts:
            with formatter.section("Other commands"):
                formatter.write_dl(list(texts.items()))


class FiniteCommand(TyperCommand):
    """Command whose options are finite numbers: a range accepts inf and NaN."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        left = super().parse_args(ctx, args)
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            for x in value if isinstance(value, list | tuple) else (value,):
                if isinstance(x, float) and not math.isfinite(x):
                    raise InputError(
                        f"{parameter.opts[0]} must be a finite number, not {x}"
                    )
        return left


class SeveralValuesCommand(FiniteCommand):
    """Command whose repeatable options also take several values at once: ``--validate a.csv b.csv``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        several = {
            o for p in self.params if getattr(p, "multiple", False) for o in p.opts
        }
        out: list[str] = []
        option = ""
        for i, arg in enumerate(args):
            if arg == "--":
                out += args[i:]
                break
            name, joined, _ = arg.partition("=")
            if arg.startswith("-"):
                option = name if name in several else ""
                # the first value follows the option as typed
                fresh = bool(option) and not joined
            elif option:
                if not fresh:
                    out.append(option)
                fresh = False
            out.append(arg)
        return super().parse_args(ctx, out)


app = typer.Typer(
    name="isd-gym",
    cls=CommandGroup,
    help="Vehicle suspension with a hydraulic electric inerter: score and train controllers, simulate networks, and find "
    "missing physics of a model.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version
        from platform import platform, python_version

        typer.echo(
            f"isd-gym {version('isd-gym')}, Python {python_version()}, {platform()}"
        )
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Print the versions of program, Python and system.",
        ),
    ] = False,
) -> None: ...
