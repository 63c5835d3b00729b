"""RealSense cameras, by pyrealsense2: the left infrared picture, whose shutter does not roll.

Tried against a stand-in with the same calls, not with a camera.
"""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from palpate.bench.cameras import LiveCamera, picture_size
from palpate.optional_imports import late_import
from palpate.records import TomlTable

# Rate [Hz], and the longest time between two pictures [ms].
_RATE, _NEXT = 30, 5000
_USUAL = (640, 480)


def realsense_pictures(serial: str, size: tuple[int, int]) -> Iterator[Any]:
    """Pictures of a camera as they come, as `live_pictures`; its projector is off.

    Parameters
    ----------
    serial : str                    number of the camera
    size : (columns, rows)
    """
    rs = late_import("pyrealsense2", extra="realsense", purpose="a RealSense camera")
    config, pipeline = rs.config(), rs.pipeline()
    config.enable_device(serial)
    config.enable_stream(rs.stream.infrared, 1, *size, rs.format.y8, _RATE)
    device = pipeline.start(config).get_device()
    device.first_depth_sensor().set_option(rs.option.emitter_enabled, 0.0)
    while True:
        frame = pipeline.wait_for_frames(_NEXT).get_infrared_frame(1)
        yield np.array(frame.get_data(), dtype=np.uint8), time.monotonic()


def realsense_camera(table: TomlTable) -> LiveCamera:
    """The camera of its table in bench.toml."""
    table.check_keys(("name", "driver", "source", "size"))
    size = picture_size(table) or _USUAL
    return LiveCamera(table.text("name"), realsense_pictures, table.text("source"), size)
