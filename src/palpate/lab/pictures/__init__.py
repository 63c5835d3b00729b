"""pictures."""

from palpate.lab.pictures.mitsuba_variant import (
    Variant as Variant,
    choose_variant as choose_variant,
)
from palpate.lab.pictures.photographs import (
    Studio as Studio,
    exposure as exposure,
    make_studio as make_studio,
    photographed as photographed,
)
from palpate.lab.pictures.stereo_head import make_head as make_head, misjudged as misjudged
from palpate.lab.pictures.truth_maps import (
    surface_maps as surface_maps,
    truth_map as truth_map,
    write_truth_map as write_truth_map,
)
