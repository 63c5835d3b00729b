"""The command `palpate`, also as `python -m palpate`."""

import signal
import sys
from importlib import import_module


def main() -> int:
    """Run the command line with the arguments of the process.

    Until the command line has installed its own handler, an interrupt ends the process silently,
    without Python's traceback.

    Returns
    -------
    int                             exit code
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    code: int = import_module("palpate.app.cli").main()
    return code


if __name__ == "__main__":
    sys.exit(main())
