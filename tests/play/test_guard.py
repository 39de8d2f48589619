"""Which requests may open the page of `arrive play`, and which messages of browsers are handled."""

import asyncio
import contextlib
import logging
import math
import random
import time
from collections.abc import Callable

import pytest

pytest.importorskip("viser")

import msgspec
import viser
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus

from arrive.errors import ArriveError
from arrive.play.door import door_of
from arrive.play.guard import LARGEST_MESSAGE, Guard, offers
from arrive.play.playground import DURATIONS_S
from play_pages import CAMERA, CLICK, DRAG, Page, answers, read_all

FUZZED = 1000
HOSTILE = (
    math.nan,
    math.inf,
    -math.inf,
    1e30,
    -1e30,
    2**63 - 1,
    -(2**63),
    0,
    -1,
    "",
    "x" * 500,
    None,
    [],
    {},
    b"",
    True,
)


# The door.


def headers(host: str | None, origin: str | None = None, cookie: str = "", upgrade: bool = True) -> Headers:
    given = {"Host": host, "Origin": origin, "Cookie": cookie or None, "Upgrade": "websocket" if upgrade else None}
    return Headers({name: value for name, value in given.items() if value is not None})


@pytest.mark.parametrize(
    ("host", "origin", "let_in"),
    [
        ("127.0.0.1:8080", "http://127.0.0.1:8080", True),
        ("localhost:8080", "http://localhost:8080", True),
        # Through a tunnel the page is seen on another port, by its host and its origin alike.
        ("localhost:9000", "http://localhost:9000", True),
        ("127.0.0.1:8080", "http://evil.example", False),
        ("127.0.0.1:8080", "http://localhost:8080", False),
        ("127.0.0.1:8080", "http://127.0.0.1:3000", False),
        ("127.0.0.1:8080", "null", False),
        ("127.0.0.1:8080", None, False),
        # A name of someone else's that leads to this machine (DNS rebinding).
        ("evil.example:8080", "http://evil.example:8080", False),
        ("127.0.0.1.evil.example", "http://127.0.0.1.evil.example", False),
        ("", "http://127.0.0.1:8080", False),
        (None, None, False),
        ("[", "http://[", False),
    ],
)
def test_only_requests_of_the_page_are_allowed(host, origin, let_in):
    assert (door_of("127.0.0.1", 8080).refusal(headers(host, origin), "/") == "") == let_in


def test_a_request_with_two_hosts_is_refused():
    both = headers("127.0.0.1:8080", "http://127.0.0.1:8080")
    both["Host"] = "evil.example"
    assert door_of("127.0.0.1", 8080).refusal(both, "/")


def test_a_page_for_other_machines_needs_a_token():
    door = door_of("0.0.0.0", 8080)
    assert len(door.token) >= 20
    assert door.token != door_of("0.0.0.0", 8080).token
    assert door.address.endswith(f"/?token={door.token}")
    page = headers("192.0.2.7:8080", upgrade=False)
    assert "token" in door.refusal(page, "/")
    assert "token" in door.refusal(page, "/?token=guess")
    assert door.refusal(page, f"/?token={door.token}") == ""
    assert door.refusal(headers("evil.example", upgrade=False), f"/?token={door.token}")
    # The page's socket brings the cookie that the page was given.
    cookie = door.welcome(f"/?token={door.token}")["Set-Cookie"].partition(";")[0]
    assert "HttpOnly; SameSite=Strict" in door.welcome(f"/?token={door.token}")["Set-Cookie"]
    assert "Set-Cookie" not in door.welcome("/?token=guess")
    socket_ = headers("192.0.2.7:8080", "http://192.0.2.7:8080", cookie)
    assert door.refusal(socket_, "/") == ""
    assert door.refusal(headers("192.0.2.7:8080", "http://evil.example", cookie), "/")
    assert door.refusal(headers("192.0.2.7:8080", "http://192.0.2.7:8080", 'a="; b'), "/")


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.0.0.2"])
def test_a_page_for_this_machine_needs_no_token(host):
    assert door_of(host, 8080).token == ""


@pytest.mark.parametrize("host", ["", " "])
def test_an_empty_host_is_refused(host):
    with pytest.raises(ArriveError, match="--host is empty"):
        door_of(host, 8080)


# A page that is served.


@pytest.fixture
def page():
    page = Page()
    yield page
    page.close()


def test_other_pages_cannot_reach_the_robot(page):
    assert asyncio.run(answers(page))
    for given in ({"Origin": "http://evil.example"}, {}, {"Origin": page.origin, "Host": "evil.example"}):
        with pytest.raises(InvalidStatus) as refused:
            asyncio.run(answers(page, additional_headers=given))
        assert refused.value.response.status_code == 403


def test_the_token_opens_the_page_beyond_this_machine():
    page = Page("0.0.0.0")
    try:
        with pytest.raises(InvalidStatus):
            asyncio.run(answers(page))
        cookie = f"{page.door.cookie}={page.door.token}"
        assert asyncio.run(answers(page, additional_headers={"Origin": page.origin, "Cookie": cookie}))
    finally:
        page.close()


def spoil(value: object, rng: random.Random) -> object:
    """A value with something hostile in place of it, or of something in it."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(list(value))
        return value | {key: spoil(value[key], rng)}
    if isinstance(value, tuple) and value and rng.random() < 0.7:
        place = rng.randrange(len(value))
        return (*value[:place], spoil(value[place], rng), *value[place + 1 :])
    return rng.choice(HOSTILE)


def fuzzed(page: Page, rng: random.Random) -> bytes:
    """One message: a spoiled one of the page's own, one that only servers send, or noise."""
    kind = rng.random()
    if kind < 0.1:
        return rng.randbytes(rng.randrange(200))
    uuid = rng.choice(list(page.controls()))
    update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": rng.choice(HOSTILE)}}
    if kind < 0.5:
        if rng.random() < 0.2:
            update["updates"] = {rng.choice(("uuid", "removed", "update_cb", "value", "props")): rng.choice(HOSTILE)}
        return msgspec.msgpack.encode(update)
    if kind < 0.6:
        name = rng.choice(
            ("ShareUrlRequest", "RunJavascriptMessage", "GuiFormDirtyMessage", "Message", "FileTransferPart")
        )
        return msgspec.msgpack.encode({"type": name, "uuid": uuid, "source": "alert(1)"})
    whole = rng.choice((CAMERA, CLICK, DRAG, {"type": "CommandTriggerMessage", "uuid": uuid}, update))
    return msgspec.msgpack.encode(spoil(whole, rng))


async def bombard(page: Page, heard: Callable[[], int], rng: random.Random) -> int:
    """Have the server hear hostile messages, through a new connection whenever one was closed.

    Returns:
        How many connections it took.
    """
    connections, end = 0, heard() + FUZZED
    while heard() < end:
        connections += 1
        async with page.connect() as browser:
            listening = asyncio.create_task(read_all(browser))
            await browser.send(msgspec.msgpack.encode(CAMERA))
            with contextlib.suppress(ConnectionClosed):
                while heard() < end:
                    await browser.send(fuzzed(page, rng))
                    await asyncio.sleep(0.0005)
            await listening if listening.done() else listening.cancel()
    return connections


def test_no_message_harms_the_robot_or_other_browsers(page, caplog, monkeypatch):
    heard, admitted = [], Guard.admitted

    def counted(guard: Guard, raw: bytes) -> str:
        heard.append(admitted(guard, raw))
        return heard[-1]

    monkeypatch.setattr(Guard, "admitted", counted)
    with caplog.at_level(logging.WARNING):
        connections = asyncio.run(bombard(page, lambda: len(heard), random.Random(1)))
        assert page.alive()
        assert asyncio.run(answers(page)), "others are not locked out"
    assert len(heard) >= FUZZED
    assert any(heard), "some were harmless by chance, and viser has seen them"
    assert connections > 1, "whoever sends nothing else is turned away"
    for control in page.controls().values():
        assert isinstance(control, viser.GuiButtonHandle) or offers(control, control.value), control
    assert 0.0 <= page.session.pace.factor <= 1.0
    assert DURATIONS_S[0] <= page.session._panel.duration_s <= DURATIONS_S[1]
    assert not [record for record in caplog.records if record.exc_info], "no traceback"


def test_messages_of_the_page_are_handled(page):
    speed = page.session._panel._speed
    uuid = next(uuid for uuid, control in page.controls().items() if control is speed)

    async def use() -> None:
        async with page.connect() as browser:
            await browser.send(msgspec.msgpack.encode(CAMERA))
            await browser.send(msgspec.msgpack.encode(CLICK))
            update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": 0.5}}
            await browser.send(msgspec.msgpack.encode(update))
            end = time.monotonic() + 60.0
            while (page.playground.target is None or page.session.pace.factor == 1.0) and time.monotonic() < end:
                await asyncio.sleep(0.02)

    asyncio.run(use())
    # The page follows the robot, which settles by less than a millimetre between the click and its reading.
    assert page.playground.target.position_w[:2] == pytest.approx((2.0, 0.0), abs=0.01)
    assert page.session.pace.factor == 0.5


def test_a_message_that_is_too_large_ends_its_connection_alone(page):
    async def flood() -> None:
        async with page.connect() as browser:
            await browser.send(b"x" * (LARGEST_MESSAGE + 1))
            while True:
                await asyncio.wait_for(browser.recv(), 10.0)

    with pytest.raises(ConnectionClosed):
        asyncio.run(flood())
    assert page.alive()
    assert asyncio.run(answers(page))


def test_a_ray_without_direction_hits_nothing(page):
    hit = page.playground.hit
    for direction in ((0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (math.inf, 0.0, 0.0)):
        assert hit((0.0, 0.0, 5.0), direction) is None
    assert hit((0.0, 0.0, math.nan), (0.0, 0.0, -1.0)) is None
