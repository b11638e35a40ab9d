# SPDX-License-Identifier: Apache-2.0
import pytest

from edgectl.web.access import Access, decide_access, derive_cookie, is_loopback_address, is_token

TOKEN = "a-token-of-the-lab"
COOKIE = "edgectl-9816"


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost", "LOCALHOST."])
def test_loopback(host: str) -> None:
    assert is_loopback_address(host)


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "192.0.2.1", "lab.example", "localhost.example", "", "127.0.0.1.example"]
)
def test_no_loopback(host: str) -> None:
    assert not is_loopback_address(host)


@pytest.mark.parametrize(
    ("headers", "access"),
    [
        ({"host": "localhost:9816"}, Access.GRANTED),
        ({"host": "127.0.0.1"}, Access.GRANTED),
        ({"host": "[::1]:9816"}, Access.GRANTED),
        ({"host": "rebound.example:9816"}, Access.WRONG_HOST),
        ({}, Access.WRONG_HOST),
    ],
)
def test_without_a_token_the_host_decides(headers: dict[str, str], access: Access) -> None:
    assert decide_access(headers, None, COOKIE) is access


@pytest.mark.parametrize(
    ("headers", "access"),
    [
        ({"authorization": f"Bearer {TOKEN}"}, Access.GRANTED),
        ({"authorization": f"Bearer {TOKEN}x"}, Access.DENIED),
        ({"authorization": TOKEN}, Access.DENIED),
        ({"authorization": "Bearer \u00e9\udcff"}, Access.DENIED),
        ({"cookie": f"other=1; {COOKIE}={derive_cookie(TOKEN)}"}, Access.GRANTED),
        ({"cookie": f"{COOKIE}={TOKEN}"}, Access.DENIED),
        ({"cookie": f"edgectl-1={derive_cookie(TOKEN)}"}, Access.DENIED),
        ({"cookie": "=;[]"}, Access.DENIED),
        ({"host": "localhost"}, Access.DENIED),
    ],
)
def test_with_a_token_it_alone_decides(headers: dict[str, str], access: Access) -> None:
    assert decide_access(headers, TOKEN, COOKIE) is access


def test_tokens() -> None:
    assert is_token(TOKEN)
    assert not is_token("too-short")
    assert not is_token("with a space in it.")
    assert not is_token(TOKEN + "\n")
