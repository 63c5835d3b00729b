"""What the facility's cameras see: textured bodies, light, lenses and image sensors.

Purpose    : render pictures of a body at rest and under load, with the true motion of each pixel.
Takes      : a configuration, a rig, the rendered vertices at one instant or during an exposure.
Gives      : grey pictures of every camera and of boards, truth maps, rigs and rigs with calibration
             errors.
Depends on : `vision`, `records`, `geometry`; Mitsuba for the rendering.
Read first : `studio.py`, then `scene.py`, `sensor.py`, `truth_maps.py`.
"""

from palpate.lab.pictures.board_view import board_picture as board_picture
from palpate.lab.pictures.head import make_head as make_head, miscalibrated as miscalibrated
from palpate.lab.pictures.mitsuba_variant import (
    Variant as Variant,
    choose_variant as choose_variant,
)
from palpate.lab.pictures.studio import (
    Studio as Studio,
    exposure as exposure,
    make_studio as make_studio,
    photograph as photograph,
)
from palpate.lab.pictures.textures import dot_count as dot_count
from palpate.lab.pictures.truth_maps import (
    truth_map as truth_map,
    write_truth_map as write_truth_map,
)
