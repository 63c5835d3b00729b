"""The twenty rows of BENCHMARK.md, each with what it stands beside."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Headline:
    """A row of the page.

    Parameters
    ----------
    what : str                  name of the row in figures.csv
    label : str                 the same in plain English
    beside : tuple              its anchors: texts, or pairs of a label and the name of a row
    """

    what: str
    label: str
    beside: tuple[str | tuple[str, str], ...]


_NOISY = "halfball_probes noisy (3 % outliers, 10 % NaN): error of"
_OWN = "500 repeats of the model's own displacements, also 3 % gross outliers, 10 % missing"
_TABLE, _HOLD = "table 3, all probings", "95 % intervals that hold the truth"
_SPECKLE = "speckle, window 21 px: rms per component, worst case"
_SPEED = "speckle, window 21 px: points per CPU second, slowest case"
_PYVALE = "beside it: pyvale (2-D correlation, affine),"
_ALDIC = "beside it: al-dic (local subsets),"
_DIS = "beside it: opencv-python-headless (DIS, finest scale),"
_TENSION = "real tension test, frames 1-5: median lateral difference from DICe, worst"
_LU = "beside it: LAPACK, one LU of the 3N system, 2562 vertices"
_BEAM = "`palpate fit` of the shipped beam,"
HEADLINES: dict[str, tuple[Headline, ...]] = {
    "Elastic constants": (
        Headline(
            f"{_NOISY} E",
            "error of E: simulated half ball, 17 pushes with noise, 3 % outliers, 10 % missing",
            (
                "truth 52 kPa",
                ("error in claimed standard deviations", f"{_NOISY} E, in claimed sigmas"),
                ("of nu, truth 0.21", f"{_NOISY} nu"),
                ("in claimed standard deviations", f"{_NOISY} nu, in claimed sigmas"),
            ),
        ),
        Headline(
            "half ball from pictures, 17 probings: error of E",
            "error of E: rendered pictures of three cameras, 17 pushes",
            (
                "truth 52 kPa",
                ("of nu, truth 0.21", "half ball from pictures, 17 probings: error of nu"),
            ),
        ),
        Headline(
            f"{_TABLE}: rms error of E",
            "rms error of E: the paper's table 3, repeated on the virtual bench",
            ("the paper is 2.34 % off its compression test",),
        ),
        Headline(
            "beam, 0.510 N: E against linear finite elements at the same nu",
            "E of a real silicone beam: difference from finite elements at the same nu",
            (
                (
                    "from finite elements computed here, same contact",
                    "beam, 0.510 N: E against finite elements computed here, nu 0.30",
                ),
                (
                    "from the authors' own fit",
                    "beam, 0.510 N: reported E against the authors' 264 kPa",
                ),
            ),
        ),
    ),
    "Uncertainty": (
        Headline(
            f"95 % interval of E covers the truth, {_OWN}",
            "95 % intervals of E that hold the truth: 500 repeats of the model, noise and outliers",
            ("nominal 95 %", ("of nu", f"95 % interval of nu covers the truth, {_OWN}")),
        ),
        Headline(
            f"{_TABLE}: {_HOLD}",
            "95 % intervals that hold the truth: table 3, 20 repeats with new noise",
            (
                "nominal 95 %",
                (
                    "calibration and pose a little wrong",
                    f"{_TABLE}, calibration and pose a little wrong: {_HOLD}",
                ),
            ),
        ),
        Headline(
            f"rms error of E over Cramer-Rao bound, {_OWN}",
            "rms error of E over the Cramer-Rao bound: the same repeats",
            ("1 is the least that any unbiased estimate can have",),
        ),
    ),
    "Pictures and cameras": (
        Headline(
            f"analytic speckle, noise 1.5, window 21 px: {_SPECKLE.partition(': ')[2]}",
            "image correlation, speckle whose motion is known, windows of 21 px: rms error",
            (
                ("pyvale", f"{_PYVALE} {_SPECKLE}"),
                ("al-dic", f"{_ALDIC} {_SPECKLE}"),
                ("OpenCV's DIS", f"{_DIS} {_SPECKLE}"),
            ),
        ),
        Headline(
            "refined points per CPU second, window 21 px, one pair",
            "the same speckle: points per CPU second, from starts that are off by up to 0.7 px",
            (
                ("pyvale, search included", f"{_PYVALE} {_SPEED}"),
                ("al-dic, search included", f"{_ALDIC} {_SPEED}"),
                ("OpenCV's DIS, pixels of a dense field", f"{_DIS} {_SPEED}"),
            ),
        ),
        Headline(
            _TENSION,
            "real tension test: median lateral difference from DICe, worst of five frames",
            (("al-dic-3d", f"beside it: al-dic-3d, {_TENSION}"),),
        ),
        Headline(
            "real chessboards, camera 201: rms over OpenCV's own",
            "calibration with real chessboards: rms residual over that of OpenCV's own",
            (
                "1 is OpenCV's",
                ("a second camera", "real chessboards, camera 202: rms over OpenCV's own"),
            ),
        ),
    ),
    "Measuring live": (
        Headline(
            "live displacement, 640 x 480 x 2, one after another, latency 95 %",
            "displacement of 550 points with covariances, two cameras: latency, 95 % of instants",
            (
                (
                    "full precision, 1770 points, three cameras",
                    "full precision, 640 x 480 x 3, one after another",
                ),
            ),
        ),
        Headline(
            "constants after the third push, 651 vertices",
            "constants after the third push, 651 vertices",
            (
                ("after the twentieth", "constants after the twentieth push, 651 vertices"),
                (
                    "pushes to an interval of 3 %, by information over random places",
                    'pushes for "E 3 %", by information over random places',
                ),
            ),
        ),
    ),
    "Time and memory": (
        Headline(
            "separated fields, all pairs, warm, 2562 vertices",
            "all integrals of the boundary elements, 2562 vertices",
            (
                (
                    "bempp-cl, one scalar Laplace operator",
                    "beside it: bempp-cl, scalar Laplace single-layer operator, 2562 vertices",
                ),
                ("one LU of the system", _LU),
            ),
        ),
        Headline(
            "whole fit of 17 probings, 2562 vertices",
            "a whole fit of 17 pushes, 2562 vertices",
            (("one LU of the system", _LU),),
        ),
        Headline(
            "peak memory, 2562 vertices, 17 probings",
            "peak memory of such a fit",
            ("one dense matrix of the system: 0.47 GB",),
        ),
        Headline(
            f"{_BEAM} first process, compilation included",
            "`palpate fit` of the shipped beam, first process, nothing compiled yet",
            (
                ("later processes", f"{_BEAM} later processes"),
                ("`palpate --help`", "`palpate --help`"),
                (
                    "from boards, a turntable, films and a force log, six commands",
                    "from a robot's films and force log to constants, all commands",
                ),
                (
                    "from tables of image correlation, three commands",
                    "from tables of image correlation to constants, all commands",
                ),
            ),
        ),
        Headline(
            "24 sessions of the half ball, two workers over one process",
            "a campaign of 24 sessions, two workers: speed-up over one process",
            ("2 for two workers",),
        ),
    ),
    "Touch and simulation": (
        Headline(
            "ticks per second, tick of a sphere that slides, 2562 vertices",
            "touching with a sphere that slides, 2562 vertices: ticks",
            (
                "haptic devices ask for 1000",
                (
                    "99th percentile of a tick",
                    "99th percentile, tick of a sphere that slides, 2562 vertices",
                ),
            ),
        ),
        Headline(
            "push that was left out of the fit, repeated in calculix: off by",
            "a push left out of the fit, repeated in CalculiX: difference in displacement",
            (("in MuJoCo", "push that was left out of the fit, repeated in mujoco: off by"),),
        ),
    ),
}
