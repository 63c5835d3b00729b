"""The devices of a bench, played by a process of their own: cameras that serve what they see as
MJPEG on loopback, and a gauge on a pty.

    python -m bench.played_bench FOLDER

writes bench.toml, rig and mesh into a folder, says "ready", and obeys on its standard input:
"aim X Y Z" [mm] solves a push at a place and says "aimed F" with its force [N], "press" presses
there, "lift" lifts off.
"""

import os
import pty
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomlkit
from bench.drawn_world import hand_bench

from palpate.geometry import closest_points, unit_normals
from palpate.records import Rig, write_rig

# Rates of cameras and gauge [Hz]; time of the way down and up [s], over so many pictures; depth
# over that of the largest force that the virtual arm may press with.
FRAMES, READINGS, RISE, STAGES, DEPTH = 12.0, 50.0, 0.5, 6, 0.8
WEIGHT, NOISE = 0.2, 1e-3
CAMERAS = 2
G = 9.80665


class Player:
    """What the object, the tool and the person's hand are doing."""

    def __init__(self, folder: Path) -> None:
        self.bench = hand_bench(folder)
        self.world = self.bench.cameras[0]._world
        self.pressed, self.lifted = np.inf, np.inf
        self.stages = [self.world.drawn(0.0)]
        write_rig(folder / "rig.toml", Rig(self.world.rig.cameras[:CAMERAS], 0, "rig"))

    def aim(self, point: np.ndarray) -> None:
        """Solve the push at a place of the surface, and draw it on its way."""
        mesh = self.world.config.specimen.mesh
        triangle = closest_points(mesh, point[None]).triangle[0]
        inward = -unit_normals(mesh)[triangle]
        self.world.position = point - 0.02 * inward
        self.world.aim_at(point, inward)
        self.stages = [self.world.drawn(d) for d in DEPTH * np.linspace(0.0, 1.0, STAGES + 1)]

    def share(self) -> float:
        """How far the tool is down now, of the way to where it is held."""
        now = time.monotonic()
        down = np.clip((now - self.pressed) / RISE, 0.0, 1.0)
        return float(max(down - np.clip((now - self.lifted) / RISE, 0.0, 1.0), 0.0))

    def picture(self, camera: int, rng: np.random.Generator) -> bytes:
        """What a camera sees now, as JPEG."""
        stage = round(self.share() * (len(self.stages) - 1))
        grey = self.stages[stage][camera]
        noisy = grey + self.world.config.pictures.noise * rng.standard_normal(grey.shape)
        picture = np.clip(np.rint(noisy), 0.0, 255.0).astype(np.uint8)
        return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 98])[1])

    def reading(self, rng: np.random.Generator) -> bytes:
        """What an HX711 board sends now."""
        force = float(self.world.force_at(np.array([DEPTH * self.share()]))[0])
        grams = 1e3 * (force + WEIGHT + NOISE * rng.standard_normal()) / G
        return f"{grams:.3f} gf\r\n".encode()


def serve_cameras(player: Player) -> str:
    """Serve a stream for each camera; their address."""

    class Stream(BaseHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

        def do_GET(self) -> None:
            camera = int(self.path.strip("/"))
            rng = np.random.default_rng(camera)
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            head = "--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n"
            while True:
                picture = player.picture(camera, rng)
                self.wfile.write(head.format(len(picture)).encode() + picture + b"\r\n")
                time.sleep(1.0 / FRAMES)

    server = ThreadingHTTPServer(("127.0.0.1", 0), Stream)
    server.handle_error = lambda *_: None  # type: ignore[method-assign]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_port}"


def play_gauge(player: Player) -> str:
    """Send readings on a pty; its port."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)

    def play() -> None:
        rng = np.random.default_rng(9)
        while True:
            time.sleep(1.0 / READINGS)
            try:
                os.write(ours, player.reading(rng))
            except BlockingIOError:
                # Nobody reads yet.
                continue

    threading.Thread(target=play, daemon=True).start()
    return os.ttyname(theirs)


def main(folder: Path) -> None:
    """Play the bench until standard input ends."""
    player = Player(folder)
    address, port = serve_cameras(player), play_gauge(player)
    cameras = [
        {"name": camera.name, "driver": "opencv", "source": f"{address}/{k}"}
        for k, camera in enumerate(player.world.rig.cameras[:CAMERAS])
    ]
    content = {
        "format": "palpate-bench/1", "name": "played", "rig": {"cameras": "rig.toml"},
        "camera": cameras, "force": {"driver": "serial", "port": port, "gauge": "hx711"},
    }  # fmt: skip
    (folder / "bench.toml").write_text(tomlkit.dumps(content))
    print("ready", flush=True)
    for line in sys.stdin:
        word, *numbers = line.split()
        if word == "aim":
            player.aim(1e-3 * np.array([float(x) for x in numbers]))
            print(f"aimed {player.world.force_at(np.array([DEPTH]))[0]:.5f}", flush=True)
        elif word == "press":
            player.pressed, player.lifted = time.monotonic(), np.inf
        elif word == "lift":
            player.lifted = time.monotonic()


@contextmanager
def played_bench(folder: Path) -> Iterator["subprocess.Popen[str]"]:
    """A process that plays the bench of a folder, once it is ready."""
    command = [sys.executable, "-m", "bench.played_bench", str(folder)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as player:
        try:
            assert player.stdout is not None
            assert player.stdout.readline() == "ready\n"
            yield player
        finally:
            player.kill()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
