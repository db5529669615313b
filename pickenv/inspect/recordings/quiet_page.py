"""The viewer's page for a browser on this machine, which may ask nobody else: no telemetry, no fonts, no news.

rerun serves the page; what stands here hands it on with a content security policy that names the recording's own server
and no other, and only to who asks for this machine by name, so that no foreign site can reach it by a name of its own.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

HANDED_ON = ("content-type", "content-encoding", "cache-control")
PATIENCE = 30.0
"""How long to wait for the viewer's own server, s."""


@contextmanager
def quiet_page(host: str, viewer: int, data: int) -> Iterator[int]:
    """Serve the page of a viewer that serves itself at a port; gives the port of the page to open.

    Args:
        host: This machine's own address, 127.0.0.1.
        viewer: Port at which rerun serves its page.
        data: Port at which it serves the recording.
    """
    policy = (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; "
        f"connect-src 'self' blob: data: http://{host}:{data}"
    )

    class Page(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            if self.headers.get("Host") not in (f"{host}:{port}", f"localhost:{port}"):
                self.send_error(403)
                return
            asked = {name: self.headers[name] for name in ("Accept", "Accept-Encoding") if name in self.headers}
            connection = HTTPConnection(host, viewer, timeout=PATIENCE)
            try:
                connection.request("GET", self.path, headers=asked)
                found = connection.getresponse()
                content = found.read()
            except OSError:
                self.send_error(502)
                return
            finally:
                connection.close()
            self.send_response(found.status)
            for name, value in found.getheaders():
                if name.lower() in HANDED_ON:
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Content-Security-Policy", policy)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing is said of what is asked for."""

    with ThreadingHTTPServer((host, 0), Page) as server:
        port = server.server_address[1]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield port
        finally:
            server.shutdown()
