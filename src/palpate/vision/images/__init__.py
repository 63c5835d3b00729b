"""Pictures from files, prepared for searching and matching.

Purpose    : grey levels from picture files, or a message about what is wrong with a file;
             normalised pictures, their features, and interpolation between pixels.
Takes      : picture files, a `Rig`.
Gives      : `Pictures`, `NormalisedImage`, `PreparedPictures`, `SplinePicture`.
Depends on : `records`.
Read first : `pictures.py`, then `spline.py`.
"""

from palpate.vision.images.features import (
    Matches as Matches,
    PreparedPictures as PreparedPictures,
    match_features as match_features,
    nearest_descriptors as nearest_descriptors,
    prepare_pictures as prepare_pictures,
)
from palpate.vision.images.normalisation import (
    WINDOW as WINDOW,
    NormalisedImage as NormalisedImage,
    cropped as cropped,
    make_normalised_image as make_normalised_image,
    moments as moments,
    point_spread_variance as point_spread_variance,
)
from palpate.vision.images.pictures import (
    Pictures as Pictures,
    picture_path as picture_path,
    read_grey as read_grey,
    read_pictures as read_pictures,
    read_stored as read_stored,
)
from palpate.vision.images.spline import (
    PADDING as PADDING,
    TAPS as TAPS,
    SplinePicture as SplinePicture,
    interpolate as interpolate,
    make_spline_picture as make_spline_picture,
    noise_fraction_kernel as noise_fraction_kernel,
    sample_kernel as sample_kernel,
    slope_gain as slope_gain,
    smoothing_gain as smoothing_gain,
    spline_pictures as spline_pictures,
    spline_weights_kernel as spline_weights_kernel,
)
from palpate.vision.images.video import (
    VIDEO_SUFFIXES as VIDEO_SUFFIXES,
    open_video as open_video,
    video_frames as video_frames,
)
