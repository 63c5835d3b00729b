"""The command `palpate`, also as `python -m palpate`.

Until the command line can say so in a line, a signal ends the process without a word.
"""

import signal
import sys

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from palpate.app.cli import main

if __name__ == "__main__":
    sys.exit(main())
