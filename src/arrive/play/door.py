"""Decides which requests may open the page.

Any web page can make the browser send requests to 127.0.0.1. So the `Host` header must be a name of this machine and
`Origin` must be this page. If other machines can reach the page, a request also needs a token: in the address the first
time, later in a cookie.
"""

import hmac
import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers

from arrive.errors import ArriveError

LOOPBACK = ("localhost", "127.0.0.1", "::1")
PARAMETER = "token"
TOKEN_BYTES = 16
HOST = re.compile(r"(?:\[(?P<address>[0-9A-Fa-f:.]+)\]|(?P<name>[\w.-]+))(?::[0-9]{1,5})?", re.ASCII)
"""A Host header: a name or an address, with or without a port."""
SAFE_HEADERS = {"X-Frame-Options": "SAMEORIGIN", "Referrer-Policy": "no-referrer"}
"""No other page may show this one in a frame, or receive its address with the token."""


@dataclass(frozen=True)
class Door:
    """The rules for one address."""

    host: str
    """Address that the page is served on."""
    port: int
    names: frozenset[str]
    """Host names that a request may use. With `--host 0.0.0.0`, IP addresses are allowed too."""
    token: str
    """Token that a request must have; empty if only this machine can reach the page."""

    @property
    def address(self) -> str:
        """The address to open in a browser."""
        shown = socket.gethostname() if _is_wildcard(self.host) else self.host
        shown = f"[{shown}]" if ":" in shown else shown
        return f"http://{shown}:{self.port}" + (f"/?{PARAMETER}={self.token}" if self.token else "")

    @property
    def cookie(self) -> str:
        """Name of the cookie with the token. Browsers share cookies between ports, so the name has the port."""
        return f"arrive_{self.port}"

    def refusal(self, headers: Headers, path: str) -> str:
        """Why a request is refused; empty if it is allowed."""
        host = _single(headers, "Host")
        if not self._is_named(_host_name(host)):
            return f"this page is not served as {host!r}"
        upgrade = any("websocket" in value.lower() for value in headers.get_all("Upgrade"))
        origin = _single(headers, "Origin")
        if (upgrade or headers.get_all("Origin")) and origin.lower() not in _origins(host):
            return f"requests from {origin!r} are refused"
        if self.token and not self._has_token(headers, path):
            return "open the address that `arrive play` printed, with its token"
        return ""

    def welcome(self, path: str) -> dict[str, str]:
        """Headers of the response to an allowed request."""
        if self.token and self._matches(_parameter(path)):
            return SAFE_HEADERS | {"Set-Cookie": f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"}
        return SAFE_HEADERS

    def _is_named(self, name: str) -> bool:
        return name in self.names or (_is_wildcard(self.host) and _is_literal(name))

    def _has_token(self, headers: Headers, path: str) -> bool:
        jar = SimpleCookie()
        try:
            jar.load("; ".join(headers.get_all("Cookie")))
        except CookieError:
            jar.clear()
        known = jar[self.cookie].value if self.cookie in jar else ""
        return self._matches(known) or self._matches(_parameter(path))

    def _matches(self, token: str) -> bool:
        # A request may contain bytes that are not UTF-8.
        return hmac.compare_digest(token.encode(errors="backslashreplace"), self.token.encode())


def door_of(host: str, port: int) -> Door:
    """The rules for a page that is served on this address.

    Raises:
        ArriveError: the host is empty, which would mean all addresses.
    """
    if not host.strip():
        raise ArriveError("--host is empty: write 127.0.0.1 for this machine alone, 0.0.0.0 for all its addresses")
    if _is_local(host):
        return Door(host, port, frozenset({*LOOPBACK, host.lower()}), "")
    own = socket.gethostname().lower()
    names = {host.lower(), *LOOPBACK, own, f"{own}.local", socket.getfqdn().lower()}
    return Door(host, port, frozenset(names), secrets.token_urlsafe(TOKEN_BYTES))


def _is_local(host: str) -> bool:
    """Whether only this machine can reach the address."""
    try:
        places = {place[4][0] for place in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):
        return False
    return bool(places) and all(ipaddress.ip_address(str(place).partition("%")[0]).is_loopback for place in places)


def _is_wildcard(host: str) -> bool:
    return _is_literal(host) and ipaddress.ip_address(host).is_unspecified


def _is_literal(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _single(headers: Headers, name: str) -> str:
    """The value of a header; empty if it is missing or repeated."""
    values = headers.get_all(name)
    return values[0].strip() if len(values) == 1 else ""


def _host_name(host: str) -> str:
    """The name in a Host header without port and brackets; empty if the header is malformed."""
    match = HOST.fullmatch(host)
    return (match["address"] or match["name"]).lower() if match else ""


def _origins(host: str) -> set[str]:
    """The valid `Origin` headers for a host. https is for a proxy in front of this server."""
    return {f"{scheme}://{host.lower()}" for scheme in ("http", "https")}


def _parameter(path: str) -> str:
    """The token in an address; empty if there is none."""
    try:
        return parse_qs(urlsplit(path).query).get(PARAMETER, [""])[0]
    except ValueError:
        return ""
