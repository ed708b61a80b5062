"""The output `ws`, as a page in a browser receives it."""

import socket

from reporting import report

from spheremouse.output import open_output

CONNECT = """port => new Promise(resolve => {
  const socket = new WebSocket(`ws://127.0.0.1:${port}`);
  window.samples = [];
  socket.onmessage = message => samples.push(JSON.parse(message.data));
  socket.onopen = resolve;
})"""


def test_a_page_gets_each_sample(browser):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with open_output(f"ws:{port},origin=null") as output, browser.new_page() as page:  # an empty page has no origin
        page.evaluate(CONNECT, port)
        for x in (3, 4):
            output.send(report(x, -2, 1))
        page.wait_for_function("samples.length == 2")
        assert [sample["counts"] for sample in page.evaluate("samples")] == [[3, -2, 1], [4, -2, 1]]
