"""`spheremouse view --url` and `--open`: the owner's address of the page that runs."""

import webbrowser

import pytest


@pytest.mark.parametrize("browser", [True, False])
def test_the_page_opens_in_the_browser_or_its_address_is_printed(spheremouse, tmp_path, monkeypatch, browser):
    token, opened = tmp_path / "token", []
    token.write_text("t" * 43 + "\n")
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or browser)
    address = f"http://127.0.0.1:8765/?token={'t' * 43}"
    assert spheremouse("view", "--url", "--token-file", token) == (0, f"{address}\n", "")
    assert opened == []
    assert spheremouse("view", "--open", "--token-file", token) == (0, "" if browser else f"{address}\n", "")
    assert opened == [address]
