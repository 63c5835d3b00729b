"""Who may connect to the viewer: only who has the address that was printed.

Every user of this computer can reach its ports, and every web page can have a browser on it do so.
"""

import hmac
import re
from dataclasses import replace
from http import HTTPStatus
from typing import Any

from palpate.errors import PalpateError
from palpate.optional_imports import late_import

# Names that a browser has for this computer, also at the near end of an ssh tunnel. Any other may
# be that of a web page, whose owner has it lead here (DNS rebinding).
_THIS_COMPUTER = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", re.IGNORECASE)
_REFUSAL = "Open the whole address that the viewer printed.\n"


def is_admitted(request: Any, token: str) -> bool:
    """Whether a request is that of a person who was given the address.

    Parameters
    ----------
    request : Request of websockets     for a file or for a websocket
    token : str                         first part of the path of every admitted request

    Returns
    -------
    bool                                False also if the request is for a host that is not this
                                        computer, or comes from a page of another host or port
    """
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    given = request.path.partition("?")[0].removeprefix("/").partition("/")[0]
    return (
        len(hosts) == 1
        and _THIS_COMPUTER.fullmatch(hosts[0]) is not None
        and set(origins) <= {f"http://{hosts[0]}"}
        and hmac.compare_digest(given.encode(errors="surrogateescape"), token.encode())
    )


def guarded_server(token: str, **options: Any) -> Any:
    """Start a server of viser that answers 403 to every request that is not admitted.

    Parameters
    ----------
    token : str                     see `is_admitted`
    options                         of `viser.ViserServer`

    Returns
    -------
    ViserServer

    Raises
    ------
    InputError                      viser is not installed
    PalpateError                    this version of viser starts its server in another way
    """
    viser = late_import("viser", extra="view", purpose="the viewer")
    library: Any = late_import("websockets.asyncio.server", extra="view", purpose="the viewer")
    guarded = []
    # viser offers no check of requests, but hands one of its own to `serve`, before it listens.
    plain = library.serve

    def serve(*arguments: Any, process_request: Any, **others: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            if not is_admitted(request, token):
                return connection.respond(HTTPStatus.FORBIDDEN, _REFUSAL)
            path = request.path.removeprefix(f"/{token}")
            return process_request(connection, replace(request, path=path))

        guarded.append(checked)
        return plain(*arguments, process_request=checked, **others)

    library.serve = serve
    try:
        server = viser.ViserServer(**options)
    finally:
        library.serve = plain
    if not guarded:
        server.stop()
        raise PalpateError(
            f"viser {viser.__version__} does not let Palpate check who connects, so the viewer was"
            " not started; install viser 1.1"
        )
    return server
