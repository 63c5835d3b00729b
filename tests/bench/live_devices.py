"""Devices that other processes and threads play: gauges on a pty, an MJPEG stream on loopback."""

import os
import pty
import re
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager

# What each gauge says to a request, or by itself, for a force of 1.5 N.
REPLIES = {
    "mark-10": (rb"\?\r", b"-1.500 N\r\n"),
    "imada": (rb"D\r", b"+1.500NTO\r"),
    "sauter": (rb"9", b"0001.50"),
    "hx711": (rb"", b"152.96 gf\r\n"),
}
SERVER = """
import sys, time, http.server, numpy as np, cv2
class Stream(http.server.BaseHTTPRequestHandler):
    def log_message(self, *_): pass
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        for k in range(int(sys.argv[1])):
            picture = np.full((48, 64), 2 * k % 200 + 20, np.uint8)
            picture[:, :8] = 255
            code = cv2.imencode(".jpg", picture)[1].tobytes()
            head = b"--frame\\r\\nContent-Type: image/jpeg\\r\\nContent-Length: %d\\r\\n\\r\\n"
            self.wfile.write(head % len(code) + code + b"\\r\\n")
            time.sleep(0.03)
server = http.server.HTTPServer(("127.0.0.1", 0), Stream)
print(server.server_port, flush=True)
server.serve_forever()
"""


@contextmanager
def gauge_line(request: bytes, reply: bytes) -> Iterator[str]:
    """The port of a gauge that answers requests, or sends by itself where there is none."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    over = threading.Event()

    def play() -> None:
        while not over.wait(0.01):
            if not request or re.search(request, os.read(ours, 100)):
                os.write(ours, reply)

    player = threading.Thread(target=play, daemon=True)
    player.start()
    try:
        yield os.ttyname(theirs)
    finally:
        over.set()
        # What wakes a player that waits for a request.
        os.write(theirs, b"\n")
        player.join()
        os.close(theirs)
        os.close(ours)


@contextmanager
def mjpeg_stream(frames: int) -> Iterator[str]:
    """The address of a camera of the network that another process plays, for so many pictures."""
    command = [sys.executable, "-c", SERVER, str(frames)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            yield f"http://127.0.0.1:{server.stdout.readline().strip()}/"
        finally:
            server.kill()
