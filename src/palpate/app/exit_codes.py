"""What the command line gives back to the shell."""

# An argument, a file or a disk that does not do.
BAD_INPUT = 2
# An estimate or a measurement that is not ok, or a result that has changed.
NOT_OK = 3
# Memory ran out, or an error of the program itself.
PROGRAM_ERROR = 70
# What a shell makes of signals: this and their number.
BY_SIGNAL = 128
