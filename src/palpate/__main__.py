"""The command `palpate`, also as `python -m palpate`."""

import gc
import signal
import sys
from importlib import import_module

# Objects that are made before Python looks for cycles again: most belong to modules and stay, and
# looking through them after every 700 takes a twentieth of a short fit.
_BETWEEN_SEARCHES = 50_000


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
    gc.set_threshold(_BETWEEN_SEARCHES)
    code: int = import_module("palpate.app.cli").main()
    return code


if __name__ == "__main__":
    sys.exit(main())
