"""Who may talk to the page."""

from __future__ import annotations

import platform
import threading

import pytest

from physkin_core.view.visitors import refusal

OWN = "the page is not served under that name"
OTHER = "requests of other websites"


@pytest.mark.parametrize(
    ("host", "origin", "told"),
    [
        ("localhost:8080", None, ""),
        ("localhost:8080", "http://localhost:8080", ""),
        ("LOCALHOST:8080", "http://localhost:8080", ""),
        ("127.0.0.1:8080", "http://127.0.0.1:8080", ""),
        ("[::1]:8080", "http://[::1]:8080", ""),
        ("192.168.3.7", "https://192.168.3.7", ""),
        (platform.node() + ":8080", None, ""),
        (platform.node() + ".local", None, ""),
        ("avatars.example:8080", "http://avatars.example:8080", ""),
        ("localhost:8080", "http://evil.example", OTHER),
        ("localhost:8080", "http://localhost:9999", OTHER),
        ("localhost:8080", "http://localhost:8080.evil.example", OTHER),
        ("localhost:8080", "null", OTHER),
        ("localhost:8080", "", OTHER),
        ("evil.example:8080", "http://evil.example:8080", OWN),
        ("localhost.evil.example:8080", None, OWN),
        ("127.0.0.1.evil.example", None, OWN),
        ("localhost@evil.example", None, OWN),
        ("[::1", None, OWN),
        ("", None, OWN),
    ],
)
def test_host_and_origin_are_checked(host, origin, told):
    """By its own names or any address, from a page of its own; "avatars.example" is where it is asked to listen."""
    headers = {"Host": host} | ({} if origin is None else {"Origin": origin})
    reason = refusal(headers, "avatars.example")
    assert told in reason and bool(told) == bool(reason)


@pytest.fixture(scope="module")
def page():
    """A page that listens."""
    pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")
    from physkin_core.view.page import Page

    page = Page(port=8396)
    yield page
    page.server.stop()


def test_another_website_cannot_connect(page):
    """Over a real socket; the page's own can."""
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    port = page.server.get_port()
    how = {"subprotocols": [f"viser-v{viser.__version__}"], "max_size": None, "compression": None}
    with connect(f"ws://localhost:{port}", origin=f"http://localhost:{port}", **how) as socket:
        assert socket.recv(timeout=20)
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://localhost:{port}", origin="http://evil.example", **how)


def test_a_name_that_leads_here_is_not_served(page):
    import http.client

    for host, status in (("localhost", 200), ("evil.example", 403)):
        connection = http.client.HTTPConnection("127.0.0.1", page.server.get_port(), timeout=20)
        connection.request("GET", "/", headers={"Host": f"{host}:{page.server.get_port()}"})
        assert connection.getresponse().status == status
        connection.close()


def test_no_browser_can_have_a_tunnel_opened(page, monkeypatch):
    """What asks for one ends in a function of the page's own, which opens none."""
    import msgspec
    import viser
    from websockets.sync.client import connect

    assert page.server.request_share_url() is None
    asked = threading.Event()
    monkeypatch.setattr(page.server, "request_share_url", asked.set)
    how = {"subprotocols": [f"viser-v{viser.__version__}"], "max_size": None, "compression": None}
    with connect(f"ws://localhost:{page.server.get_port()}", **how) as socket:
        socket.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
        assert asked.wait(20)
