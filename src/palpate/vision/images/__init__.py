"""images."""

from palpate.vision.images.features import (
    Matches as Matches,
    PreparedPictures as PreparedPictures,
    matched as matched,
    prepare_pictures as prepare_pictures,
)
from palpate.vision.images.normalisation import (
    WINDOW as WINDOW,
    NormalisedImage as NormalisedImage,
    cropped as cropped,
    make_normalised_image as make_normalised_image,
    moments as moments,
)
from palpate.vision.images.pictures import Pictures as Pictures, read_pictures as read_pictures
from palpate.vision.images.spline import (
    SplinePicture as SplinePicture,
    interpolate as interpolate,
    make_spline_picture as make_spline_picture,
    noise_share_kernel as noise_share_kernel,
    sample_kernel as sample_kernel,
    smoothing_gain as smoothing_gain,
    spline_pictures as spline_pictures,
)
