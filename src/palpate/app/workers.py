"""Workers of the commands that make virtual measurements, whose probings are independent."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from palpate.campaign import started_engine
from palpate.threads import Distribute

_NEEDED = ("distributed", "cryptography")


@contextmanager
def distribution(
    scheduler: str | None, workers: int | None, *, insecure: bool = False, by_default: bool = False
) -> Iterator[Distribute]:
    """`map` on workers for the duration of the block, or in this process.

    Parameters
    ----------
    scheduler, workers, insecure    as in `started_engine`
    by_default : bool               start a cluster of this machine's cores where neither is given
                                    and Dask and what makes certificates are installed

    Yields
    ------
    callable                        as `map`

    Raises
    ------
    InputError                      as in `started_engine`
    """
    asked = scheduler is not None or workers is not None
    if not asked and not (by_default and all(map(find_spec, _NEEDED))):
        yield map
        return
    with started_engine(scheduler, workers, insecure=insecure) as engine:
        yield engine.map
