"""Cameras of machine vision, by harvesters and the GenTL producer of their maker.

Tried against a stand-in with the same calls, not with a camera.
"""

import time
from collections.abc import Iterator
from typing import Any

from palpate.bench.cameras import LiveCamera
from palpate.optional_imports import late_import
from palpate.records import TomlTable

# Whole bytes, and nothing that changes by itself.
_FIXED = {"PixelFormat": "Mono8", "ExposureAuto": "Off", "GainAuto": "Off"}
# Longest time between two pictures [s].
_NEXT = 5.0


def genicam_pictures(serial: str, producer: str) -> Iterator[Any]:
    """Pictures of a camera as they come, as `live_pictures`.

    Parameters
    ----------
    serial : str                    number of the camera
    producer : str                  path of the maker's .cti
    """
    core = late_import("harvesters.core", extra="genicam", purpose="a GenICam camera")
    harvester = core.Harvester()
    harvester.add_file(producer, check_existence=True)
    harvester.update()
    camera = harvester.create({"serial_number": serial})
    nodes = camera.remote_device.node_map
    for name, value in _FIXED.items():
        if hasattr(nodes, name):
            getattr(nodes, name).value = value
    camera.start()
    while True:
        with camera.fetch(timeout=_NEXT) as buffer:
            part = buffer.payload.components[0]
            picture = part.data.reshape(part.height, part.width).copy()
        yield picture, time.monotonic()


def genicam_camera(table: TomlTable) -> LiveCamera:
    """The camera of its table in bench.toml."""
    table.check_keys(("name", "driver", "source", "producer"))
    producer = str(table.existing_file("producer"))
    return LiveCamera(table.text("name"), genicam_pictures, table.text("source"), producer)
