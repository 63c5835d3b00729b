"""The command `palpate`, also as `python -m palpate`."""

import signal
import sys
from importlib import import_module


def main() -> int:
    """Run the command line of the process; gives its exit code.

    Until the command line can say so in a line, a signal ends the process without a word.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    code: int = import_module("palpate.app.cli").main()
    return code


if __name__ == "__main__":
    sys.exit(main())
