"""A browser, and a page of a service on a film."""

import shutil

import pytest
from view_world import Service

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="session")
def browser():
    """Return a browser of the system."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine; on Debian: apt-get install chromium")
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--disable-gpu", "--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def service(browser, tmp_path_factory):
    """Return a service that tracks a film, with its page process; it tracks until the last test of a module ends."""
    service = Service(tmp_path_factory.mktemp("view"))
    service.reach(state="tracking")
    yield service
    service.close()


@pytest.fixture
def open_page(browser, service):
    """Return a function that opens the page; checks at the end that it had no error and left this host alone."""
    opened, troubles = [], []

    def open_page(width=1280, height=800, scheme="dark", owner=True):
        page = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme).new_page()
        opened.append(page)
        page.set_default_timeout(20000)
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("request", lambda request: troubles.extend([] if service.owns(request.url) else [request.url]))
        page.goto(service.owner_url if owner else service.url)
        page.get_by_text("tracking", exact=True).wait_for()
        return page

    yield open_page
    for page in opened:
        page.context.close()
    service.ask("resume")
    service.reset()
    assert not troubles


@pytest.fixture
def page(open_page):
    """Return the page in a desktop's window."""
    return open_page()
