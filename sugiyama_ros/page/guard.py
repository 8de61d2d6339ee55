"""Who may see the live page: who asks the server by its own name and, beyond this machine, has the token."""

import logging
import secrets
import time
from collections.abc import Awaitable, Callable, Collection
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from bokeh.server.auth_provider import AuthProvider
from tornado.web import HTTPError

_HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
#: Lines that the server may log in a minute, and characters of each.
_LINES, _CHARACTERS = 10, 200


class Guard(AuthProvider):  # type: ignore[misc]
    """Admits requests for this server that come from its own page.

    A page of another site that a name in the DNS leads here asks for another host, and is refused. With a token, the
    guard admits a browser that gives ``?token=``, and afterwards recognises the browser by a cookie.

    names: names of the server; port: port of the server; open_to_others: whether other machines reach the server; it
    then also answers to numeric addresses, and asks for the token.
    """

    def __init__(self, names: Collection[str], port: int, open_to_others: bool) -> None:
        self.token = secrets.token_urlsafe(24) if open_to_others else ""
        self._names = {name.lower() for name in names}
        self._port = port
        super().__init__()

    @property
    def get_user_async(self) -> Callable[[Any], Awaitable[str]]:
        """Function that names the user of a request, or answers 403."""
        return self._user

    @property
    def login_url(self) -> str:
        """Required by Bokeh, but never used: the server redirects no browser."""
        return "/"

    async def _user(self, handler: Any) -> str:
        request = handler.request
        origin = request.headers.get("Origin")
        if not self._is_here(request.host) or (origin is not None and _netloc(origin) != request.host):
            raise HTTPError(403)
        if self.token:
            self._check_token(handler)
        for name, value in _HEADERS.items():
            handler.set_header(name, value)
        return "user"

    def _is_here(self, host: str) -> bool:
        """Whether a request for ``host``, a name or an address with a port, is meant for this server."""
        try:
            parts = urlsplit(f"//{host}")
            name, port = (parts.hostname or "").lower(), parts.port
        except ValueError:
            return False
        return port == self._port and (name in self._names or (bool(self.token) and _is_address(name)))

    def _check_token(self, handler: Any) -> None:
        """Answer 403 without the token. Servers on other ports of the machine have cookies of other names."""
        cookie = f"sugiyama_token_{self._port}"
        asked = handler.get_query_argument("token", None)
        if not secrets.compare_digest((asked or handler.get_cookie(cookie, "")).encode(), self.token.encode()):
            raise HTTPError(403)
        if asked:
            handler.set_cookie(cookie, asked, httponly=True, samesite="Strict")


def _netloc(origin: str) -> str:
    """Host and port of an origin; empty if it is not an address."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


class _Quiet(logging.Handler):
    """Prints few and short lines of a server's log: what strangers send is not repeated whole, nor as often."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._printer = logging.StreamHandler()
        self._minute, self._printed = 0, 0

    def emit(self, record: logging.LogRecord) -> None:
        """Print the first characters of a record, unless there were too many records in this minute."""
        minute = int(time.monotonic() / 60.0)
        if minute != self._minute:
            self._minute, self._printed = minute, 0
        self._printed += 1
        if self._printed <= _LINES:
            text = repr(record.getMessage()[:_CHARACTERS])[1:-1]
            self._printer.emit(logging.LogRecord(record.name, record.levelno, "", 0, text, None, None))


def log_quietly() -> None:
    """Let the loggers of the web server print few and short lines from now on."""
    quiet = _Quiet()
    for name in ("bokeh", "tornado"):
        logger = logging.getLogger(name)
        logger.handlers, logger.propagate = [quiet], False
