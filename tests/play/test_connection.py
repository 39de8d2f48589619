"""What strangers do to the page's connections: others can use the page meanwhile, and nothing is printed."""

import asyncio
import contextlib
import logging
import math
import random
import socket
import struct
import threading
import time
import warnings

import pytest

pytest.importorskip("viser")

import msgspec
import viser
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus
from websockets.frames import Frame, Opcode

from arrive.play import connection
from arrive.play.connection import MOST_SOCKETS, OTHER_FRAMES_PER_S
from arrive.play.guard import LARGEST_MESSAGE, Guard
from arrive.play.server import open_server
from arrive.play.stick import parse_stick
from play_pages import CAMERA, CLICK, DRAG, PROTOCOL, Page, answers, read_all
from ports import free_port

DROPPED = 2000
PATIENCE_S = 60.0


@pytest.fixture
def page():
    page = Page()
    yield page
    page.close()


@pytest.fixture(autouse=True)
def nothing_is_said(capfd, caplog):
    """No line and no traceback for what strangers do."""
    with caplog.at_level(logging.WARNING):
        yield
    said = capfd.readouterr()
    assert said.out.replace("(viser) Server stopped\n", "") + said.err == ""
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], caplog.text


def packed(message: dict) -> bytes:
    return msgspec.msgpack.encode(message)


def visit(port: int, protocols: list[str] | None = (PROTOCOL,)) -> connect:
    origin = {"Origin": f"http://127.0.0.1:{port}"}
    return connect(f"ws://127.0.0.1:{port}/", subprotocols=protocols, additional_headers=origin)


def is_well(page: Page) -> bool:
    return page.alive() and asyncio.run(answers(page))


def raw(page: Page, data: bytes) -> bytes:
    """The start of the answer to some bytes; empty if the connection is closed without one."""
    with contextlib.suppress(ConnectionError), dialled(page.port) as wire:
        wire.sendall(data)
        return wire.recv(200)
    return b""


def dialled(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)


def test_thousands_of_connections_are_dropped_at_any_moment(page):
    lines = (
        "GET / HTTP/1.1",
        f"Host: 127.0.0.1:{page.port}",
        f"Origin: {page.origin}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        f"Sec-WebSocket-Protocol: {PROTOCOL}",
    )
    request = ("\r\n".join(lines) + "\r\n\r\n").encode()
    assert raw(page, request).startswith(b"HTTP/1.1 101")
    rng = random.Random(5)
    for _ in range(DROPPED):
        with dialled(page.port) as wire, contextlib.suppress(ConnectionError):
            reset = rng.random() < 0.5
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", reset, 0))
            wire.sendall(request[: rng.randrange(len(request) + 200)])
    assert is_well(page)
    assert len(page.server.get_clients()) <= 1


def test_browsers_that_leave_at_once_leave_nothing(page):
    async def come_and_go() -> None:
        for number in range(30):
            browser = await page.connect()
            if number % 3:
                await browser.send(packed(CAMERA))
            if number % 3 == 2:
                await browser.recv()
            browser.transport.abort()

    asyncio.run(come_and_go())
    assert is_well(page)
    end = time.monotonic() + PATIENCE_S
    while page.server.get_clients() and time.monotonic() < end:
        time.sleep(0.05)
    assert not page.server.get_clients()


def test_what_is_sent_to_a_browser_that_has_left_is_dropped_without_a_warning():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        page = Page()
        assert asyncio.run(answers(page))
        met = []
        page.server.on_client_connect(met.append)
        asyncio.run(answers(page))
        end = time.monotonic() + PATIENCE_S
        while (page.server.get_clients() or not met) and time.monotonic() < end:
            time.sleep(0.02)
        page.session._scene.look(met[0], page.playground)
        page.close()
    assert not [str(warning.message) for warning in said if issubclass(warning.category, UserWarning)]


def test_browsers_that_come_and_leave_while_the_page_starts():
    """Also those that still have the page of an earlier start open and connect again by themselves."""
    port = free_port()
    over, met = threading.Event(), []

    async def knock() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError, InvalidStatus, InvalidMessage, ConnectionClosed, TimeoutError):
                async with visit(port) as one:
                    met.append(await one.send(packed(CAMERA)))
                    one.transport.abort()
            await asyncio.sleep(0.01)

    knocking = threading.Thread(target=lambda: asyncio.run(knock()))
    knocking.start()
    try:
        page = Page(port=port)
        end = time.monotonic() + PATIENCE_S
        while len(met) < 5 and time.monotonic() < end:
            time.sleep(0.02)
    finally:
        over.set()
        knocking.join()
    assert len(met) >= 5
    assert is_well(page)
    page.close()


def test_garbage_is_answered_or_closed(page):
    rng = random.Random(8)
    garbage = [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + rng.randbytes(500),  # a browser that tries https
        b"\0" * 5000,
        rng.randbytes(20_000),
        b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 5000 + b"\r\n",
        b"GET /" + b"a" * 50_000 + b" HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"y" * 50_000 + b"\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99999999999\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"GET /../../../../etc/passwd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /%00 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /\xff\xfe HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /" + b"a" * 7000 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    ]
    for data in garbage:
        answer = raw(page, data)
        assert not answer or answer.startswith((b"HTTP/1.1 4", b"HTTP/1.1 5")), (data[:40], answer)
    assert is_well(page)


FRAMES = {
    "pings": Frame(Opcode.PING, b"x").serialize(mask=True) * 2000,
    "pongs": Frame(Opcode.PONG, b"").serialize(mask=True) * 2000,
    "a message without an end": Frame(Opcode.BINARY, b"", fin=False).serialize(mask=True)
    + Frame(Opcode.CONT, b"", fin=False).serialize(mask=True) * 2000,
    "a frame of exabytes": b"\x82\xff" + b"\x7f" + b"\xff" * 7 + b"\0\0\0\0",
    "a frame that is too large": Frame(Opcode.BINARY, b"x" * (LARGEST_MESSAGE + 1)).serialize(mask=True),
    "parts that are too large together": b"".join(
        Frame(opcode, b"x" * 6000, fin=False).serialize(mask=True)
        for opcode in (Opcode.BINARY, Opcode.CONT, Opcode.CONT)
    ),
    "without a mask": Frame(Opcode.BINARY, packed(CAMERA)).serialize(mask=False),
    "an unknown opcode": b"\x8b\x80\0\0\0\0",
    "reserved bits": b"\xf2\x80\0\0\0\0",
    "a ping that is too large": b"\x89\xfe\x10\x00" + bytes(4 + 4096),
    "text that is not UTF-8": Frame(Opcode.TEXT, b"\xff\xfe").serialize(mask=True) * 200,
    "the end of nothing": Frame(Opcode.CONT, b"", fin=True).serialize(mask=True),
    "garbage": random.Random(3).randbytes(5000),
}


@pytest.mark.parametrize("frames", FRAMES.values(), ids=FRAMES)
def test_frames_that_no_browser_sends_end_their_connection_alone(page, frames):
    async def send() -> None:
        async with page.connect(ping_interval=None) as browser:
            await browser.send(packed(CAMERA))
            browser.transport.write(frames)
            await asyncio.wait_for(read_all(browser), PATIENCE_S)

    asyncio.run(send())
    assert is_well(page)


def test_pings_at_a_browsers_rate_are_answered(page):
    async def ping() -> None:
        async with page.connect() as browser:
            reading = asyncio.create_task(read_all(browser))
            for _ in range(OTHER_FRAMES_PER_S // 2):
                await asyncio.wait_for(await browser.ping(), PATIENCE_S)
            reading.cancel()

    asyncio.run(ping())


def test_a_page_of_another_version_is_told_to_load_again(page):
    for protocols in (["viser-v0.0.1"], ["other"], None):

        async def listen(protocols=protocols) -> None:
            async with visit(page.port, protocols) as one:
                await asyncio.wait_for(one.recv(), PATIENCE_S)

        with pytest.raises(ConnectionClosed) as closed:
            asyncio.run(listen())
        assert (closed.value.rcvd.code, "load it again" in closed.value.rcvd.reason) == (1002, True)
    assert is_well(page)


def test_messages_before_the_first_one_of_a_page_change_nothing(page):
    before = {uuid: control.value for uuid, control in page.controls().items()}
    goal = page.playground.goal

    async def hurry() -> None:
        async with page.connect() as browser:
            reading = asyncio.create_task(read_all(browser))
            for uuid, control in page.controls().items():
                for value in (*getattr(control, "options", ()), 1.0, True, "1.00 0.00"):
                    await browser.send(packed({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}))
            for message in (CLICK, DRAG, DRAG | {"type": "TransformControlsDragEndMessage"}):
                await browser.send(packed(message))
            await browser.send(packed(CAMERA))
            await asyncio.sleep(1.0)
            reading.cancel()

    asyncio.run(hurry())
    assert is_well(page)
    assert {uuid: control.value for uuid, control in page.controls().items()} == before
    assert page.playground.goal is goal


def test_the_end_of_a_drag_without_a_start_is_harmless(page):
    async def drag() -> None:
        async with page.connect() as browser:
            reading = asyncio.create_task(read_all(browser))
            end = {"type": "TransformControlsDragEndMessage", "name": DRAG["name"]}
            start = end | {"type": "TransformControlsDragStartMessage"}
            other = {"name": "/world/elsewhere"}
            for message in (CAMERA, end, DRAG, end, end, start, start, DRAG | other, end | other, CAMERA):
                await browser.send(packed(message))
            await asyncio.sleep(1.0)
            reading.cancel()

    asyncio.run(drag())
    assert is_well(page)


def test_browsers_that_stop_reading_cost_nothing_more(page):
    """What is drawn anew replaces what waits for them, so that the server keeps a picture and not a film."""

    async def listen_no_more() -> None:
        deaf = []
        for _ in range(10):
            browser = await page.connect(ping_interval=None)
            await browser.send(packed(CAMERA))
            browser.transport.pause_reading()
            deaf.append(browser)
        kept = page.server._websock_server._broadcast_buffer.message_from_id
        await asyncio.sleep(2.0)
        before, steps = len(kept), page.session._steps
        await asyncio.sleep(4.0)
        assert page.session._steps > steps
        assert len(kept) < before + 100
        for state in list(page.server._websock_server._client_state_from_id.values()):
            assert len(state.message_buffer.message_from_id) < 100
        assert await answers(page)
        for browser in deaf:
            browser.transport.abort()

    asyncio.run(listen_no_more())
    assert is_well(page)


def test_open_connections_that_ask_for_nothing_lock_nobody_out(page):
    with contextlib.ExitStack() as wires:
        for _ in range(2 * MOST_SOCKETS):
            wires.enter_context(dialled(page.port))
        assert asyncio.run(answers(page))
        assert raw(page, f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode()).startswith(b"HTTP/1.1 200")
    assert page.alive()


def test_a_page_beyond_the_limit_replaces_the_one_that_was_silent_longest(page, monkeypatch):
    monkeypatch.setattr(connection, "MOST_PAGES", 3)

    async def crowd() -> None:
        pages, reading = [], []
        for _ in range(3):
            pages.append(await page.connect())
            reading.append(asyncio.create_task(read_all(pages[-1])))
            await pages[-1].send(packed(CAMERA))
            await asyncio.sleep(0.2)
        await pages[0].send(packed(CAMERA))
        await asyncio.sleep(0.2)
        assert await answers(page)
        await asyncio.wait_for(reading[1], PATIENCE_S)
        assert [task.done() for task in reading] == [False, True, False]
        for one, task in zip(pages, reading, strict=True):
            one.transport.abort()
            await task

    asyncio.run(crowd())


NO_NUMBERS = (math.nan, math.inf, -math.inf, 1e300, -1e300, 2**64 - 1, -(2**63), "nan", "inf", None, True, [], {}, b"1")


def everywhere(value: object):
    """Every version of a message with one number replaced by something else."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from (value | {key: other} for other in everywhere(inner))
    elif isinstance(value, tuple):
        for place, inner in enumerate(value):
            yield from ((*value[:place], other, *value[place + 1 :]) for other in everywhere(inner))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield from NO_NUMBERS


@pytest.mark.parametrize("message", [CAMERA, CLICK, DRAG], ids=lambda message: message["type"])
def test_no_number_of_a_message_may_be_anything_else(message):
    guard = Guard()
    assert guard.admitted(packed(message)) == message["type"]
    cases = list(everywhere(message))
    assert len(cases) >= 7 * len(NO_NUMBERS)
    for case in cases:
        assert guard.admitted(packed(case)) == "", case


def test_no_control_takes_what_it_does_not_offer(page):
    guard = Guard()
    guard.server = page.server
    kinds = set()
    for uuid, control in page.controls().items():
        kinds.add(type(control))
        sound = control.value if not isinstance(control, viser.GuiButtonHandle) else True
        for value, admitted in [(sound, True), *((value, False) for value in NO_NUMBERS)]:
            if value is True and isinstance(control, viser.GuiButtonHandle | viser.GuiCheckboxHandle):
                continue
            update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
            assert bool(guard.admitted(packed(update))) == admitted, (control, value)
        if isinstance(control, viser.GuiSliderHandle):
            for value in (control.min - 0.01, control.max + 0.01):
                update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
                assert guard.admitted(packed(update)) == "", (control, value)
    assert {viser.GuiSliderHandle, viser.GuiTextHandle, viser.GuiDropdownHandle} <= kinds


@pytest.mark.parametrize(
    "text",
    ["nan 0", "0 nan", "inf 0", "0 -inf", "1e400 0", "-1.0001 0", "0 2", "0x1 0", "0", "0 0 0", "", " ", "a b", "0,0"],
)
def test_a_stick_is_two_numbers_within_its_range(text):
    assert parse_stick(text) is None


def test_a_server_that_is_not_complete_shows_no_page():
    """A browser connects while viser still starts: it is told to wait, and nothing is printed."""
    answered = []
    started = viser.GuiApi.__init__

    def slow(self, *args, **options):
        if not answered:
            with dialled(port) as wire:
                wire.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
                answered.append(wire.recv(100))
        started(self, *args, **options)

    port = free_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(viser.GuiApi, "__init__", slow)
        server, _ = open_server("127.0.0.1", port)
    server.stop()
    assert answered[0].startswith(b"HTTP/1.1 503")
