"""The command line's words: which commands there are, and what is run."""

import re
import sys
from collections.abc import Sequence
from math import isfinite
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from cyclopts import (
    App,
    CycloptsError,
    CycloptsPanel,
    Group,
    MissingArgumentError,
    Parameter,
    Token,
    convert,
)
from rich.console import Console

from palpate.app.process import BAD_INPUT, Output, output_as, versions
from palpate.errors import InputError

# Numbers as options take them.
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_INTEGER = re.compile(r"[-+]?[0-9]+")
# Name: where it is, and what its help says.
_COMMANDS = {
    "fit": (
        "fit:fit",
        "Estimate shear modulus, Poisson's ratio and Young's modulus from a session.",
    ),
    "check": (
        "fit:check",
        "Check a session without fitting it: files, units, forces, contacts, pictures.",
    ),
    "flow": (
        "flow:flow",
        "Measure how the surface moved, from the pictures of calibrated cameras.",
    ),
    "poke": (
        "use:poke",
        "Press a tool on a session's object: how deep it goes, and where it strains.",
    ),
    "compression": (
        "compression:compression",
        "Young's modulus from compression tests of cylinders.",
    ),
    "mesh": (
        "surface:mesh",
        "Repair and remesh a surface: closed, with even triangles, compared with the original.",
    ),
    "scan": (
        "surface:scan",
        "Build an object's mesh from scans or depth maps taken from several viewpoints.",
    ),
    "record": (
        "sessions:record",
        "Build a session from videos of presses and a force gauge's log.",
    ),
    "measure": (
        "measure:measure",
        "Measure an object live: cameras, a gauge or a scale, pushes by hand or by an arm.",
    ),
    "init": (
        "sessions:init",
        "Write a commented session.toml from the files in a folder.",
    ),
    "plan": (
        "planning:plan",
        "Suggest where to push next so that the constants become most certain.",
    ),
    "report": (
        "fit:report",
        "Write a result's report again, as one self-contained HTML file.",
    ),
    "view": (
        "use:view",
        "View a session or a result in the browser: turn it, touch it, query its model.",
    ),
    "export": (
        "use:export",
        "Write an estimated object for a simulator: MuJoCo, CalculiX, FEBio, SOFA, OpenUSD, ...",
    ),
    "compile": (
        "fit:compile_kernels",
        "Compile the numerical kernels once, so that the first fit need not wait.",
    ),
    "reproduce": (
        "lab:reproduce",
        "Repeat an experiment of the paper on the virtual bench, beside the published numbers.",
    ),
}
# Commands with commands of their own; the first of them is meant where no word says which, as in
# `palpate lab CONFIG.toml OUT`.
_GROUPS = {
    "import": (
        "Make sessions of what others measured: displacements of other programs, a robot's pokes.",
        {
            "displacements": (
                "import_results:import_displacements",
                "Import displacements from another program into a session.",
            ),
            "pokes": (
                "import_pokes:import_pokes",
                "Build a session from a table of pokes: position and force of a tool.",
            ),
        },
    ),
    "lab": (
        "Virtual measurements with known truth, and plans; list the benches: palpate lab --list",
        {
            "make": (
                "lab:lab",
                "Measure a virtual specimen: pictures, forces and the truth as a session.",
            ),
            "tutorial": (
                "lab:tutorial",
                "Record the tutorial's calibration board, turntable and presses.",
            ),
            "plan": (
                "planning:plan_pictures",
                "Predict what a session's cameras will see, and the precision to expect.",
            ),
        },
    ),
    "campaign": (
        "Fit many sessions, on this machine's cores or on many machines.",
        {
            "run": (
                "campaign:run",
                "Fit every session in a list or folder; resumes where it was stopped.",
            ),
            "status": ("campaign:status", "Show a campaign's progress, also while it runs."),
            "table": ("campaign:table", "Print or write a campaign's table."),
            "plot": ("campaign:plot", "Plot the constants of all sessions."),
        },
    ),
    "calibrate": (
        "Calibrate cameras from pictures of a flat target, and print the target.",
        {
            "rig": ("calibrate:calibrate", "Calibrate one or more cameras from pictures."),
            "board": ("calibrate:board", "Draw a ChArUco board in true size, with a ruler."),
            "object": (
                "calibrate:calibrate_object",
                "Locate a known object in a rig's view, and refine the rig by its texture.",
            ),
        },
    ),
}
# The help lists commands in this order: those of a measurement as one needs them, rare ones last.
_HEADINGS = {
    "Measure": "measure init calibrate scan mesh record import flow check plan",
    "Estimate": "fit compression campaign report",
    "Use": "view poke export",
    "Laboratory": "lab",
    "Also": "compile completion reproduce",
}
_HELP_WORDS = ("--help", "-h", "--version")
# Said of every command, wherever they stand in the line.
_JSON_WORDS, _VERBOSE_WORDS = ("--json",), ("-v", "--verbose")
_FLAGS_HELP = (
    "With any command: --json prints its tables and sentences as one JSON document; -v tells every"
    " stage of long work with its time. Exit codes: 0 done, 2 bad input, 3 an estimate that is not"
    " ok."
)


def make_app() -> App:
    """The command line; a subcommand's module is imported when it is called, not before.

    Returns
    -------
    App                             that knows all subcommands by name
    """
    app = App(
        name="palpate",
        help_epilogue=_FLAGS_HELP,
        # Nobody wants a list with nothing in it, nor a flag that says what is so without it.
        default_parameter=Parameter(
            negative_iterable=(),
            negative_bool=(),
            converter=_convert_option,
            show_default=_shown_default,
        ),
        help="Elastic constants of a soft object, with intervals, from probings with a known"
        " force.",
        version=versions_text,
        version_format="plaintext",
        help_format="markdown",
        error_console=Console(stderr=True),
        suppress_keyboard_interrupt=False,
    )
    placed = _places_in_help()
    for flag in ("--help", "--version"):
        app[flag].group = placed["completion"]["group"]
        app[flag].sort_key = len(placed)
    for name, (location, text) in _COMMANDS.items():
        app.command(f"palpate.app.commands.{location}", name=name, help=text, **placed[name])
    for group, (summary, commands) in _GROUPS.items():
        inner = App(name=group, help=summary, **placed[group])
        for name, (location, text) in commands.items():
            inner.command(f"palpate.app.commands.{location}", name=name, help=text)
        app.command(inner)

    @app.command(**placed["completion"])
    def completion(shell: Literal["bash", "zsh", "fish"], /) -> int:
        """Print what a shell needs to complete commands and options.

        To be written once, for bash, zsh (with `fpath+=~/.zfunc` before `compinit`) or fish:

        - `palpate completion bash > ~/.local/share/bash-completion/completions/palpate`
        - `palpate completion zsh > ~/.zfunc/_palpate`
        - `palpate completion fish > ~/.config/fish/completions/palpate.fish`

        Parameters
        ----------
        shell
            The one that completes.
        """
        sys.stdout.write(app.generate_completion(shell=shell))
        return 0

    return app


def _places_in_help() -> dict[str, dict[str, Any]]:
    """Heading and rank of every command in the help."""
    places = {}
    for k, (heading, names) in enumerate(_HEADINGS.items()):
        group = Group(heading, sort_key=k)
        for rank, name in enumerate(names.split()):
            places[name] = {"group": group, "sort_key": rank}
    return places


def _shown_default(default: Any) -> str | None:
    """The default of an option as its help has it; none of a flag."""
    return None if default is None or isinstance(default, bool) else str(default)


def versions_text() -> str:
    """Versions of Palpate and of what its numbers depend on, a line each."""
    return "\n".join(f"{name} {number}" for name, number in versions().items())


def expanded_words(words: list[str]) -> list[str]:
    """The words of a command line without those that any command may have, and with the command
    of a group that is meant where none is said.

    Parameters
    ----------
    words : list of str             `lab bench.toml out`

    Returns
    -------
    list of str                     `lab make bench.toml out`
    """
    words = [word for word in words if word not in (*_JSON_WORDS, *_VERBOSE_WORDS)]
    if words[1:] and words[0] in _GROUPS:
        first, *others = _GROUPS[words[0]][1]
        if words[1] not in (first, *others, *_HELP_WORDS):
            return [words[0], first, *words[1:]]
    return words


def _convert_option(type_: Any, tokens: Sequence[Token]) -> Any:
    """What the words of an option mean, with numbers written as people write them.

    Python reads 1_0 as ten, nan and infinity as numbers; the parser rounds 1.5 where it wants a
    whole number.
    """
    wanted = _plain_types(type_)
    for token in tokens:
        word = token.value
        if float in wanted and not (_NUMBER.fullmatch(word) and isfinite(float(word))):
            raise InputError(f'{_option_name(token)} is "{word}"; must be a finite number')
        if wanted == {int} and not _INTEGER.fullmatch(word):
            raise InputError(f'{_option_name(token)} is "{word}"; must be a whole number')
    return convert(type_, tokens)


def _option_name(token: Token) -> str:
    return token.keyword or "a number"


def _plain_types(type_: Any) -> set[Any]:
    """The types of a union or of a tuple's places, or the type itself."""
    if get_origin(type_) in (Union, UnionType, tuple):
        return set(get_args(type_)) - {type(None)}
    return {type_}


def run(words: list[str]) -> int:
    """Run a command.

    Parameters
    ----------
    words : list of str             of the command line, without the program's name

    Returns
    -------
    int                             exit code; 2 where the words are no command

    Raises
    ------
    PalpateError                    bad input
    BrokenPipeError                 nobody reads what is printed
    """
    wanted = Output(
        json=any(word in words for word in _JSON_WORDS),
        verbose=any(word in words for word in _VERBOSE_WORDS),
    )
    with output_as(wanted, words):
        return _call(expanded_words(words))


def _call(words: list[str]) -> int:
    """Run the work of a command."""
    try:
        outcome = make_app()(
            words, exit_on_error=False, print_error=False, result_action="return_value"
        )
    except MissingArgumentError as error:
        raise InputError(_missing_text(error)) from None
    except CycloptsError as error:
        # What our own readers of options say needs no frame.
        if isinstance(error.__cause__, InputError):
            raise error.__cause__ from None
        Console(stderr=True).print(CycloptsPanel(error))
        return BAD_INPUT
    except SystemExit as error:
        # How rich ends where nobody reads what it prints.
        if isinstance(error.__context__, BrokenPipeError):
            raise error.__context__ from None
        raise
    return outcome if isinstance(outcome, int) else 0


def _missing_text(error: MissingArgumentError) -> str:
    """What a command still needs, and which of its words it does not know."""
    argument: Any = error.argument
    name, count = error.keyword or argument.name, argument.token_count()[0]
    given = len(error.tokens_so_far) % max(count, 1)
    if given:
        text = f"{name} takes {count} values, not {given}"
    else:
        text = f"{name} is missing" if count <= 1 else f"give {name} with {count} values"
        unknown = [word for word in error.unused_tokens or () if word.startswith("--")]
        text += f" ({', '.join(unknown)}: no such option)" if unknown else ""
    return f"{text}; see palpate {' '.join(error.command_chain or ())} --help"
