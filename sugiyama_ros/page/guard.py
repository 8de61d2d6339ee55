"""Who may see a page that is served beyond this machine."""

import secrets
from collections.abc import Callable
from typing import Any

from bokeh.server.auth_provider import AuthProvider
from tornado.web import HTTPError

_COOKIE = "sugiyama_token"


class Guard(AuthProvider):  # type: ignore[misc]
    """Admits a browser that gives the right ``?token=``, and afterwards recognises the browser by a cookie."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)
        super().__init__()

    @property
    def get_user(self) -> Callable[[Any], str]:
        """Function that names the user of a request, or answers 403 without the token."""
        return self._user

    @property
    def login_url(self) -> str:
        """Required by Bokeh, but never used: the server redirects no browser."""
        return "/"

    def _user(self, handler: Any) -> str:
        asked = handler.get_query_argument("token", None)
        if not secrets.compare_digest((asked or handler.get_cookie(_COOKIE, "")).encode(), self.token.encode()):
            raise HTTPError(403)
        if asked:
            handler.set_cookie(_COOKIE, asked, httponly=True, samesite="Strict")
        return "user"
