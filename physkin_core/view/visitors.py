"""Who may talk to the page: browsers that show it, under a name of this machine; no other website that they show."""

from __future__ import annotations

import contextlib
import ipaddress
import platform
from collections.abc import Iterator, Mapping
from urllib.parse import urlsplit

__all__ = ["only_visitors", "refusal"]

FORBIDDEN = 403
"""HTTP's word for it."""


def refusal(headers: Mapping[str, str], served_as: str) -> str:
    """Why a request is refused, by its headers, "" where it is not. served_as: the address that the page listens at.

    A website of somebody else's cannot choose these headers. `Origin` tells on one that connects to this page, `Host`
    on one whose own name has been made to lead here. An address in numbers is nobody's name.
    """
    host = headers.get("Host", "")
    if not _is_ours(host, served_as):
        return f"the page is not served under that name; open it as {platform.node()}, localhost, or by an address"
    origin = headers.get("Origin")
    if origin is not None and origin.partition("://")[2].lower() != host.lower():
        return "the page takes no requests of other websites"
    return ""


def _is_ours(host: str, served_as: str) -> bool:
    """host: a name or address with or without a port."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    machine = platform.node().lower()
    if name in {"localhost", served_as.lower(), machine, f"{machine}.local"} - {""}:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


@contextlib.contextmanager
def only_visitors(served_as: str) -> Iterator[None]:
    """A viser server that is made inside refuses all others, which it has no setting for."""
    import websockets.asyncio.server as serving

    serve = serving.serve

    def guarded(*arguments, process_request, **options):
        def answer(connection, request):
            try:
                reason = refusal(request.headers, served_as)
            except LookupError:  # a header twice
                reason = "a header comes twice"
            if reason:
                return connection.respond(FORBIDDEN, reason)
            return process_request(connection, request)

        return serve(*arguments, process_request=answer, **options)

    serving.serve = guarded
    try:
        yield
    finally:
        serving.serve = serve
