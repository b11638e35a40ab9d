# SPDX-License-Identifier: Apache-2.0
"""Access to the page: everybody on this machine, or who knows the token. Pure."""

import hashlib
import hmac
import ipaddress
import re
from collections.abc import Mapping
from enum import Enum, auto
from http.cookies import CookieError, SimpleCookie

MIN_TOKEN_LENGTH = 16
_TOKEN = re.compile(rf"[A-Za-z0-9._~-]{{{MIN_TOKEN_LENGTH},256}}")
_BEARER = "Bearer "


class Access(Enum):
    """Verdict on a request. ``WRONG_HOST``: its Host is no name of this machine (DNS rebinding)."""

    GRANTED = auto()
    DENIED = auto()
    WRONG_HOST = auto()


def is_token(text: str) -> bool:
    """Whether ``text`` can be a token: long enough, and of characters that need no escape in a URL."""
    return _TOKEN.fullmatch(text) is not None


def is_loopback_address(host: str) -> bool:
    """Whether only this machine can connect to ``host``."""
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return host.lower().rstrip(".") == "localhost"


def derive_cookie(token: str) -> str:
    """What a browser keeps instead of the token, which it does not give away."""
    return hmac.new(token.encode(), b"edgectl serve", hashlib.sha256).hexdigest()


def decide_access(headers: Mapping[str, str], token: str | None, cookie_name: str) -> Access:
    """Judge a request by its headers (keys in lower case); ``token`` None: by its Host alone."""
    if token is None:
        return Access.GRANTED if is_loopback_address(parse_host(headers)) else Access.WRONG_HOST
    bearer = headers.get("authorization", "")
    if bearer.startswith(_BEARER) and is_equal(bearer.removeprefix(_BEARER).strip(), token):
        return Access.GRANTED
    kept = _read_cookie(headers.get("cookie", ""), cookie_name)
    return Access.GRANTED if is_equal(kept, derive_cookie(token)) else Access.DENIED


def is_equal(given: str, wanted: str) -> bool:
    """Compare in constant time."""
    return hmac.compare_digest(given.encode("utf-8", "replace"), wanted.encode())


def parse_host(headers: Mapping[str, str]) -> str:
    """The host of the Host header without its port and brackets."""
    text = headers.get("host", "")
    return text[1:].partition("]")[0] if text.startswith("[") else text.partition(":")[0]


def _read_cookie(text: str, name: str) -> str:
    try:
        found = SimpleCookie(text).get(name)
    except CookieError:
        return ""
    return found.value if found is not None else ""
