"""Error classes of Palpate. Bad input raises; a numerical outcome is data (`Status`)."""


class PalpateError(Exception):
    """Anything that Palpate raises on purpose; its text says what to do."""


class InputError(PalpateError, ValueError):
    """A value given by the caller is out of its range or of the wrong shape."""


class MeshError(InputError):
    """A triangle surface that is not the closed boundary of one solid."""


class RecordError(InputError):
    """A file (session, displacement, estimate) that cannot be read as what it claims to be."""


class CalibrationError(InputError):
    """Camera parameters that are contradictory or do not fit their images."""


class SingularSystemError(PalpateError):
    """The linear system of the model has no unique solution, e.g. too small a support."""


class NotConvergedError(PalpateError):
    """An iteration stopped before it reached its tolerance."""
