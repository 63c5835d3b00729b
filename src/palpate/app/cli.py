"""The command `palpate`: names its subcommands, turns errors into one line and an exit code."""

import sys
from collections.abc import Sequence

from cyclopts import App, CycloptsError
from rich.console import Console

from palpate import __version__
from palpate.app.guard import guarded
from palpate.errors import NotConvergedError, PalpateError

BAD_INPUT = 2
NOT_OK = 3
_INTERRUPTED = 130
# Name: where it is, and what its help says.
_COMMANDS = {
    "fit": (
        "fit:fit",
        "Estimate shear modulus, Poisson's ratio and Young's modulus from a session.",
    ),
    "check": ("check:check", "Say everything about a session that can be said without solving."),
    "flow": (
        "flow:flow",
        "Measure how the surface moved, from the pictures of calibrated cameras.",
    ),
    "import": (
        "import_results:import_displacements",
        "Take displacements measured by another program into a session.",
    ),
    "poke": (
        "poke:poke",
        "Press a tool on a session's object: how far it gives way, and where it strains.",
    ),
    "compression": (
        "compression:compression",
        "Young's modulus from compression tests of cylinders.",
    ),
    "reproduce": (
        "reproduce:reproduce",
        "Repeat an experiment of the paper on the virtual bench, its own numbers beside.",
    ),
}
# What `palpate lab` does where no word says it: `palpate lab CONFIG.toml OUT`.
_MAKE = "make"
_LAB_COMMANDS = {
    _MAKE: ("lab:lab", "Measure a virtual specimen: pictures, forces and the truth as a session."),
    "plan": (
        "plan:plan",
        "Say what the cameras of a session will see, and what precision to expect of it.",
    ),
}
_LAB_WORDS = (*_LAB_COMMANDS, "--help", "-h", "--version")


def make_app() -> App:
    """The command line; a subcommand's module is imported when it is called, not before.

    Returns
    -------
    App                             that knows all subcommands by name
    """
    app = App(
        name="palpate",
        help="Elastic constants of a soft object, with intervals, from probings with a known"
        " force.",
        version=__version__,
        help_format="plaintext",
        error_console=Console(stderr=True),
    )
    for name, (place, text) in _COMMANDS.items():
        app.command(f"palpate.app.commands.{place}", name=name, help=text)
    lab = App(name="lab", help="Virtual measurements: made with their truth, or planned.")
    for name, (place, text) in _LAB_COMMANDS.items():
        lab.command(f"palpate.app.commands.{place}", name=name, help=text)
    app.command(lab)
    return app


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str or None     None: those of the process

    Returns
    -------
    int                             0; 2 bad input, said in one message; 3 an estimate that is not
                                    ok; 70 memory ran out, or an error of the program, reported in a
                                    file; 130 interrupted
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["lab"] and words[1:2] and words[1] not in _LAB_WORDS:
        words.insert(1, _MAKE)
    try:
        outcome = make_app()(
            words,
            exit_on_error=False,
            print_error=True,
            result_action="return_value",
        )
    except CycloptsError:
        return BAD_INPUT
    except PalpateError as error:
        print(f"palpate: {error}", file=sys.stderr)
        return NOT_OK if isinstance(error, NotConvergedError) else BAD_INPUT
    except KeyboardInterrupt:
        print("palpate: interrupted; nothing was written", file=sys.stderr)
        return _INTERRUPTED
    return outcome if isinstance(outcome, int) else 0
