"""The check of requests to the page: each is allowed or refused with a reason, and none raises."""

import itertools
import random

import pytest
from websockets.datastructures import Headers

from arrive.play.door import LOOPBACK, Door, door_of

HERE = door_of("127.0.0.1", 8080)
ABROAD = Door("0.0.0.0", 8080, frozenset({"box", *LOOPBACK}), "secret")
NO_TEXT = "\udcff"
"""A byte that is no text, as a server hands it over."""
HOSTS = ("127.0.0.1:8080", "localhost", "[::1]:8080", "box", "[::1", "[", "]", "a@127.0.0.1", "127.0.0.1@evil",
         "evil.com", "127.0.0.1.evil.com", "127.1", "2130706433", "", "127.0.0.1:x", "127.0.0.1:80:80", "localhost.",
         "localhost%00", "127.0.0.1#", "127.0.0.1/..", "[fe80::1%25eth0]", "localhost,evil", "http://127.0.0.1",
         "127.0.0.1\\\\@evil", "1" * 5000, "127.0.0.1:99999999")  # fmt: skip
PATHS = ("/", "/?token=secret", "/?token=", "/?token=%ff", f"/?token={NO_TEXT}", "//[", "http://[/?token=secret",
         "/?token=secr\u00e9t", "/?" + "a=1&" * 2000, "/?token=secret%00", "*", "")  # fmt: skip
COOKIES = (None, "arrive_8080=secret", "arrive_8080=", "arrive_8080", "=;=;", "a" * 10_000, '"', "[]=1",
           "arrive_8080=secr\u00e9t", "arrive_8080=sec; arrive_8080=ret")  # fmt: skip


def request(host, origin=None, upgrade=None, cookie=None) -> Headers:
    headers = Headers()
    for name, value in (("Host", host), ("Origin", origin), ("Upgrade", upgrade), ("Cookie", cookie)):
        if value is not None:
            headers[name] = value
    return headers


def test_three_thousand_requests_are_allowed_or_refused():
    rng = random.Random(24)
    origins = ("null", *(f"{scheme}{host}" for scheme in ("http://", "file://", "") for host in HOSTS))
    let_in = set()
    for _ in range(3000):
        host, path, cookie = rng.choice(HOSTS), rng.choice(PATHS), rng.choice(COOKIES)
        origin = rng.choice((None, f"http://{host}", rng.choice(origins)))
        upgrade, door = rng.choice((None, "websocket", "h2c")), rng.choice((HERE, ABROAD))
        refusal = door.refusal(request(host, origin, upgrade, cookie), path)
        door.welcome(path)
        if not refusal:
            let_in.add(host)
            assert origin == f"http://{host}" or (origin is None and upgrade != "websocket")
            assert door is HERE or path == "/?token=secret" or cookie == "arrive_8080=secret"
    assert let_in == {"127.0.0.1:8080", "localhost", "[::1]:8080", "box"}


@pytest.mark.parametrize("host", [host for host in HOSTS if host not in ("127.0.0.1:8080", "localhost", "[::1]:8080")])
def test_other_hosts_are_refused(host):
    assert HERE.refusal(request(host), "/").startswith("this page is not served as")


@pytest.mark.parametrize(
    "origin", ["http://evil.com", "file://localhost", "null", "", "http://[", "http://localhost:99", "localhost"]
)
def test_a_websocket_is_opened_by_the_page_itself(origin):
    assert HERE.refusal(request("localhost", "http://localhost", "websocket"), "/") == ""
    assert HERE.refusal(request("LOCALHOST", "http://localhost", "websocket"), "/") == ""
    assert "are refused" in HERE.refusal(request("localhost", origin, "websocket"), "/")
    assert "are refused" in HERE.refusal(request("localhost", None, "websocket"), "/")


def test_requests_from_other_machines_need_the_token():
    for path, cookie in itertools.product(PATHS, COOKIES):
        refusal = ABROAD.refusal(request("box", cookie=cookie), path)
        right = path == "/?token=secret" or cookie == "arrive_8080=secret"
        assert (refusal == "") == right, (path, cookie)
