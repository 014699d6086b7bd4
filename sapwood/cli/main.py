"""The entry points ``reconstruct`` and ``sapwood``: parse, call, and turn errors into exit codes."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

# One thread per process: results must not depend on how many cores there are, and the maths libraries'
# spinning threads cost small problems more than they bring. Read when NumPy is first imported.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import typer  # noqa: E402

from sapwood.cli import options as o  # noqa: E402
from sapwood.cli.adapt import adapt  # noqa: E402
from sapwood.cli.classify import classify  # noqa: E402
from sapwood.cli.compare import compare  # noqa: E402
from sapwood.cli.decode import decode  # noqa: E402
from sapwood.cli.doctor import doctor  # noqa: E402
from sapwood.cli.fit import fit  # noqa: E402
from sapwood.cli.grow import grow  # noqa: E402
from sapwood.cli.info import info  # noqa: E402
from sapwood.cli.preview import preview  # noqa: E402
from sapwood.cli.reconstruct import REPORT_IT, reconstruct  # noqa: E402
from sapwood.cli.scan import scan  # noqa: E402
from sapwood.cli.species import species_build, species_list, species_show  # noqa: E402
from sapwood.cli.terminal import Terminal  # noqa: E402
from sapwood.cli.train import species_train  # noqa: E402
from sapwood.text import one_line  # noqa: E402

__all__ = ["COMMANDS", "main", "make_app", "reconstruct_main", "sapwood_main"]

OURS, THEIRS, INTERRUPTED = 1, 2, 130

COMMANDS: dict[str, Callable[..., int]] = {
    "reconstruct": reconstruct,
    "decode": decode,
    "preview": preview,
    "info": info,
    "grow": grow,
    "adapt": adapt,
    "scan": scan,
    "compare": compare,
    "fit": fit,
    "classify": classify,
    "species list": species_list,
    "species show": species_show,
    "species build": species_build,
    "species train": species_train,
    "doctor": doctor,
}

GROUPS = {"species": "The library of species."}
"""Commands of two words, by their first."""


def make_app(program: str) -> typer.Typer:
    """The command line of ``reconstruct`` alone, or of ``sapwood`` with all commands."""
    app = typer.Typer(
        add_completion=False,
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["--help", "-h"]},
    )
    if program == "reconstruct":
        app.command()(reconstruct)
        return app
    groups: dict[str, typer.Typer] = {}
    for name, command in COMMANDS.items():
        group, _, word = name.rpartition(" ")
        if group and group not in groups:
            groups[group] = typer.Typer(no_args_is_help=True, help=GROUPS[group])
            app.add_typer(groups[group], name=group)
        groups.get(group, app).command(word)(command)
    app.callback(no_args_is_help=True)(_sapwood)
    return app


def _sapwood(version: o.Version = False) -> None:
    """A LiDAR scan of a tree becomes a compact living tree.

    \b
    Example:  sapwood reconstruct oak.laz -o out
              sapwood decode out/oak.lobes -o oak.obj
    """


def main(program: str, arguments: Sequence[str]) -> int:
    """Run a command and return its exit code: 0, 1 (our fault), 2 (input), 3 (some failed) or 130."""
    terminal = Terminal(
        as_json="--json" in arguments, verbose="-v" in arguments or "--verbose" in arguments, quiet=False
    )
    try:
        code = typer.main.get_command(make_app(program)).main(
            list(arguments), prog_name=program, standalone_mode=False
        )
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except SystemExit:  # typer's answer when the reader of its help has gone: `reconstruct --help | head -1`
        code = 0
    except Exception as error:  # noqa: BLE001 - the top: whatever it is becomes one line and an exit code
        return _explain(terminal, program, arguments, error)
    if code == INTERRUPTED:
        terminal.error("interrupted; what was not finished has been removed.")
    return int(code or 0)


def _explain(terminal: Terminal, program: str, arguments: Sequence[str], error: Exception) -> int:
    """Say what went wrong in one line and return the exit code."""
    from treegraph.errors import FitError, FormatError, InputError

    command = _command_of(program, arguments)
    text, trace, code = one_line(error), "", THEIRS
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}."
    elif isinstance(error, MemoryError):
        text = "memory ran out; thin the scan with --max-points."
    elif _is_usage(error):
        message: Any = error
        text = " ".join(message.format_message().split()) or "Missing command."
        whole = f"{program} {command}" if command else program
        text = f"{text} (`{whole} --help` lists the options)"
    elif not isinstance(error, InputError | FormatError | FitError):
        trace = "".join(traceback.format_exception(error))
        text, code = f"{type(error).__name__}: {text} ({REPORT_IT})", OURS
    terminal.error(text, trace)
    terminal.json(command or program, error={"message": text, "exit_code": code})
    return code


def _command_of(program: str, arguments: Sequence[str]) -> str | None:
    """The command that is meant: of one word or, in a group, of two; else the group."""
    words = (" ".join(arguments[:n]) for n in (2, 1) if program == "sapwood")
    return next((word for word in words if word in COMMANDS or word in GROUPS), None)


def _is_usage(error: Exception) -> bool:
    """Whether the command line could not be parsed; the class has another home in each version of typer."""
    return hasattr(error, "format_message") and getattr(error, "exit_code", None) is not None


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _open_closed_streams() -> None:
    """Lead standard streams that were closed (``2>&-``) nowhere, lest the next file opened becomes one."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
            os.set_inheritable(number, True)
            stream = os.fdopen(number, "w" if number else "r", encoding="utf-8", closefd=False)
            setattr(sys, name, stream)


def _run(program: str) -> None:
    signal.signal(signal.SIGTERM, _interrupt)
    _open_closed_streams()
    sys.exit(main(program, sys.argv[1:]))


def reconstruct_main() -> None:
    """Entry point of ``reconstruct``."""
    _run("reconstruct")


def sapwood_main() -> None:
    """Entry point of ``sapwood``."""
    _run("sapwood")
