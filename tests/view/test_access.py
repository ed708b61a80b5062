"""Who may see the page, and who may change something."""

import pytest

from spheremouse.view.access import Access, Visitor

TOKEN = "a-token-of-more-than-32-characters"
HERE, ELSEWHERE = "127.0.0.1", "192.168.1.20"
OWNER, STRANGER = Visitor(True), Visitor(False)


@pytest.fixture
def access():
    return Access(TOKEN, 8765, ["cabinet.museum"])


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765", "10.0.0.7:8765", "Cabinet.Museum:8765"]
)
def test_our_hosts_pass_with_their_own_origin_and_no_other(access, host):
    assert access.visitor(HERE, host, None) == STRANGER
    assert access.visitor(HERE, host, f"http://{host}") == STRANGER
    for origin in ("null", "", f"http://{host}.evil", "http://evil.example", "http://127.0.0.1:1", f"HTTP://{host}x"):
        assert access.visitor(HERE, host, origin, given=TOKEN) is None


@pytest.mark.parametrize(
    "host", ["", "evil.example:8765", "127.0.0.1", "127.0.0.1:80", "localhost:8765.evil", "[::1]", "1.2.3:8765"]
)
def test_a_foreign_name_for_this_computer_is_refused_even_with_the_token(access, host):
    assert access.visitor(HERE, host, None, given=TOKEN) is None


@pytest.mark.parametrize(
    "cookies", ["", "spheremouse=wrong", "spheremouse=", "other=" + TOKEN, "spheremouse=\xe4", "; ;=;"]
)
def test_without_the_token_this_computer_sees_and_others_do_not(access, cookies):
    for here in (HERE, "::1", "127.8.9.1", "::ffff:127.0.0.1"):
        assert access.visitor(here, "127.0.0.1:8765", None, cookies) == STRANGER
    for elsewhere in (ELSEWHERE, "fe80::1", "::ffff:192.168.1.20", "", "localhost"):
        assert access.visitor(elsewhere, "127.0.0.1:8765", None, cookies) is None


def test_the_token_makes_an_owner_in_the_address_or_in_a_cookie(access):
    assert access.visitor(ELSEWHERE, "10.0.0.7:8765", None, given=TOKEN) == OWNER
    assert access.visitor(ELSEWHERE, "10.0.0.7:8765", None, f"a=b; spheremouse={TOKEN}") == OWNER
