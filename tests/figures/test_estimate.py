"""Pictures of an estimate: files, views, what they show."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from estimate_samples import constants, sample_result
from matplotlib.quiver import Quiver

from palpate.estimation import LikelihoodMap
from palpate.figures import (
    budget_figure,
    displacement_figure,
    errors_figure,
    likelihood_figure,
    predictions_figure,
    probings_figure,
)
from palpate.figures.displacement import best_direction, make_view, projected
from palpate.figures.estimate import _panel_limits as panel_limits, refined_likelihood, write_plots
from palpate.figures.modulus import modulus_figure
from palpate.figures.style import STYLE
from palpate.geometry import TriangleMesh
from palpate.records import (
    CONSTANT_NAMES,
    BudgetEntry,
    ErrorEstimate,
    FieldEstimate,
    ModulusMap,
    Status,
    StiffPart,
    read_session,
)
from palpate.solids import make_solid


@pytest.fixture
def session(cube_session):
    return read_session(cube_session)


@pytest.fixture
def result(session):
    return sample_result(session)


def png_size(path):
    """Width and height [pixel] from the file's head."""
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG")
    return struct.unpack(">II", data[16:24])


def test_all_pictures_are_written(tmp_path, session, result):
    written = write_plots(tmp_path, session, result)
    names = [str(path.relative_to(tmp_path)) for path in written]
    drawings = [f"{name}.{kind}" for name in ("likelihood", "probings") for kind in ("png", "svg")]
    assert names == [*drawings, "displacement/n01.png"]
    for path in written:
        if path.suffix == ".svg":
            assert path.read_text(encoding="utf-8").startswith("<?xml")
            continue
        width, height = png_size(path)
        # Wide enough to read, small enough for a page.
        assert 500 <= width <= 1600
        assert 200 <= height <= 1200


def test_a_field_of_moduli_is_drawn_in_sections(tmp_path, session, result):
    solid = make_solid(session.mesh, edge=0.012)
    centre = solid.nodes[solid.elements[:, :4]].mean(axis=1)
    above = centre[:, 2] > 0.02
    shown = ModulusMap(
        solid.nodes, solid.elements[:, :4], np.where(above, 0.5, -0.5),
        np.full(len(above), 0.1), centre[:, 0] > 0.01, np.zeros((0, len(above))),
    )  # fmt: skip
    part = StiffPart((0.02, 0.02, 0.03), 0.02, np.e, 2.0, 3.0)
    figure = modulus_figure(shown, FieldEstimate(0.4, 0.01, 50.0, 0.7, (part,)))
    # Half way from the rest, either half, to the part.
    assert [axes.get_title() for axes in figure.axes[:4]] == [
        "z = 30 mm", "y = 20 mm", "x = 20 mm", "1 times its mean"
    ]  # fmt: skip
    front = figure.axes[1]
    ratio = front.images[1].get_array()
    rows, columns = ratio.shape
    # Above the middle exp(0.5), below its inverse.
    assert ratio[-rows // 4, -columns // 4] == pytest.approx(np.exp(0.5))
    assert ratio[rows // 8, -columns // 4] == pytest.approx(np.exp(-0.5))
    # Elements whose centres lie at the left are not known.
    assert 0.15 < ratio.mask.mean() < 0.35
    estimate = replace(
        result.estimate, status=Status.HETEROGENEOUS, field=FieldEstimate(0.4, 0.01, 50.0, 0.7)
    )
    written = write_plots(tmp_path, session, replace(result, estimate=estimate, map=shown))
    assert tmp_path / "modulus.png" in written


def test_a_constant_that_is_not_identifiable_can_be_drawn(tmp_path, session, result):
    lost = constants(known=False)
    probe = replace(result.estimate.probes[0], **lost)
    estimate = replace(
        result.estimate,
        status=Status.POISSON_RATIO_NOT_IDENTIFIABLE,
        identifiable={"shear_modulus": True, "poisson_ratio": False, "young_modulus": True},
        probes=(probe,),
    )
    assert len(write_plots(tmp_path, session, replace(result, estimate=estimate))) == 5


def test_outliers_only_can_be_drawn(tmp_path, session, result):
    fit = replace(result.probes[0], weight=np.zeros_like(result.probes[0].weight))
    assert len(write_plots(tmp_path, session, replace(result, probes=(fit,)))) == 5


def test_nothing_measured_gives_no_picture(tmp_path, session, result):
    probing = session.probings[0]
    nothing = replace(probing.displacement, displacement=probing.displacement.points * np.nan)
    empty = replace(session, probings=(replace(probing, displacement=nothing),))
    assert len(write_plots(tmp_path, empty, result)) == 4


def test_a_name_with_dollars_is_not_mathematics(tmp_path, session, result):
    name = "cost $x^ and_$"
    named = replace(session, probings=(replace(session.probings[0], name=name),))
    estimate = replace(result.estimate, probes=(replace(result.estimate.probes[0], name=name),))
    fit = replace(result.probes[0], name=name)
    written = write_plots(tmp_path, named, replace(result, estimate=estimate, probes=(fit,)))
    assert len(written) == 5


def test_a_folder_that_is_not_there_is_an_error(tmp_path, session, result):
    with pytest.raises(OSError, match="none"):
        write_plots(tmp_path / "none", session, result)


def test_the_view_faces_the_points():
    rng = np.random.default_rng(1)
    for normal in np.eye(3)[[0, 1, 2]].tolist():
        normals = np.array(normal) + 0.1 * rng.normal(size=(40, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        direction = best_direction(normals, np.array(normal))
        assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-12)
        assert (normals @ direction > 0).all()


def test_the_projection_is_a_rotation_and_shows_the_front(session):
    mesh: TriangleMesh = session.mesh
    direction = np.array([0.6, 0.0, 0.8])
    view = make_view(mesh, direction)
    rotation = view.R_view_object
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(projected(view, direction), [0, 0, 1], atol=1e-12)
    # Of the cube's six faces two are turned to the viewer: a third of the triangles, and in the
    # picture plane they cover 0.04^2 (0.6 + 0.8) square metres.
    assert len(view.polygons) == len(mesh.triangles) // 3
    a, b, c = view.polygons.transpose(1, 0, 2)
    (p, q), (r, s) = (b - a).T, (c - a).T
    assert 0.5 * (p * s - q * r).sum() == pytest.approx(0.04**2 * 1.4, rel=1e-9)


def limits(values, ends, joint=(2.0, (1.9, 2.1))):
    return panel_limits(np.array([*values, joint[0], *joint[1]]), np.array(ends))


def test_a_panel_shows_all_values_and_ends_of_usual_intervals():
    low, high = limits([1.5, 2.5], [[1.2, 1.8], [2.2, 2.8]])
    # A margin of 4 % of what is shown on both sides.
    assert (low, high) == pytest.approx((1.2 - 0.04 * 1.6, 2.8 + 0.04 * 1.6))


def test_a_hopelessly_wide_interval_does_not_squeeze_the_others():
    low, high = limits([1.5, 2.5], [[-50.0, 70.0], [2.2, 2.8]])
    # Twice the range of the values beyond them, and the margin of what is shown.
    assert (low, high) == pytest.approx((1.5 - 2.0 - 0.2, 2.5 + 2.0 + 0.2))


def test_unknown_values_have_no_say_in_the_limits():
    low, high = limits([1.5, np.nan, 2.5], [[1.5, 1.5], [-np.inf, np.inf], [2.5, 2.5]])
    assert (low, high) == pytest.approx((1.46, 2.54))


def test_the_likelihood_is_refined_between_its_nodes():
    nu, shear = np.linspace(0.1, 0.3, 41), np.linspace(1.0, 3.0, 31)
    quadratic = 5e4 * (nu[:, None] - 0.2) ** 2 + 26 * (shear - 2.0) ** 2
    fine_nu, fine_shear, fine = refined_likelihood(LikelihoodMap(nu, shear, quadratic))
    # Shown is what is below a deviance of 16, and two nodes more.
    assert (fine_nu[0], fine_nu[-1]) == pytest.approx((0.175, 0.225))
    assert (fine_shear[0], fine_shear[-1]) == pytest.approx((2.0 - 13 / 15, 2.0 + 13 / 15))
    expected = 5e4 * (fine_nu - 0.2) ** 2 + 26 * (fine_shear[:, None] - 2.0) ** 2
    # Cubic splines hold a quadratic to rounding.
    np.testing.assert_allclose(fine, expected, atol=1e-9)


def texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_the_printed_intervals_are_drawn_beside_the_region(result):
    figure = likelihood_figure(result)
    (axes,) = figure.axes
    assert "each alone, 95 %: as printed" in texts(figure)
    ends = [np.sort(np.asarray(line.get_xdata())) for line in axes.lines]
    # The sample's interval of Poisson's ratio: 0.3, 4 % on either side.
    assert any(end[:2] == pytest.approx([0.288, 0.312], abs=1e-12) for end in ends)
    assert "estimate" in texts(figure)


def test_what_is_not_determined_has_no_best_dot(result):
    lost = {"shear_modulus": True, "poisson_ratio": False, "young_modulus": False}
    estimate = replace(result.estimate, identifiable=lost, status=Status.from_identifiable(lost))
    figure = likelihood_figure(replace(result, estimate=estimate))
    assert "estimate" not in texts(figure)
    assert "not determined: possible range" in texts(figure)
    assert not any(line.get_marker() == "o" for line in figure.axes[0].lines)


def test_residuals_are_drawn_in_sigmas(session, result):
    fit = replace(result.probes[0], sigma=np.full_like(result.probes[0].predicted, 5e-5))
    figure = displacement_figure(session.mesh, session.probings[0], fit)
    labels = [axes.get_xlabel() for axes in figure.axes]
    assert "difference (sigmas)" in labels
    # Half of (0.3, 0, -0.4) mm over 0.05 mm: rms over three components.
    dots = figure.axes[2].collections[1].get_array()
    np.testing.assert_allclose(dots, np.sqrt(25 / 3), rtol=1e-9)
    # The force is named.
    assert "1.2 N" in [text.get_text() for text in figure.axes[0].texts]


def test_the_support_is_drawn_darker(session, result):
    def darkest(held):
        figure = displacement_figure(session.mesh, session.probings[0], result.probes[0], held=held)
        return figure.axes[0].collections[0].get_facecolors()[:, :3].mean(axis=1).min()

    upper = np.flatnonzero(
        (session.mesh.vertices[session.mesh.triangles][:, :, 2] > 0.0).all(axis=1)
    )
    assert darkest(upper) < darkest(np.zeros(0, dtype=int)) - 0.1


def test_errors_are_drawn_in_their_own_sigmas(result):
    errors = (
        ErrorEstimate("gain of the force sensor", "", 0.004, 0.008, 0.01),
        ErrorEstimate("shift of the object along x", "m", -1.1e-3, 5e-5, 2e-4),
    )
    figure = errors_figure(replace(result.estimate, errors=errors))
    (axes,) = figure.axes
    # The names have the room that they take.
    for long in (errors, (replace(errors[0], name="W" * 54),)):
        drawn = errors_figure(replace(result.estimate, errors=long))
        # As it is written: letters are wider there by a twentieth.
        drawn.set_dpi(STYLE["savefig.dpi"])
        drawn.draw_without_rendering()
        starts = [label.get_window_extent().x0 for label in drawn.axes[0].get_yticklabels()]
        assert 0.0 < min(starts) < 0.05 * drawn.bbox.width
    dots = axes.containers[0].lines[0]
    # The farthest first.
    np.testing.assert_allclose(dots.get_xdata(), [-5.5, 0.4], rtol=1e-12)
    assert axes.get_yticklabels()[0].get_text() == errors[1].name
    assert errors_figure(result.estimate) is None


def test_a_truth_is_drawn_however_far_it_is(result):
    estimate = result.estimate
    truth = {name: 2.0 * getattr(estimate, name).value for name in CONSTANT_NAMES}
    for axes, name in zip(
        probings_figure(estimate, truth=truth).axes,
        ("poisson_ratio", "shear_modulus", "young_modulus"),
        strict=True,
    ):
        factor = 1.0 if name == "poisson_ratio" else 1e3
        assert axes.get_xlim()[1] > truth[name] / factor


def test_arrows_stay_in_their_panels(session, result):
    fit = result.probes[0]
    figure = displacement_figure(session.mesh, session.probings[0], fit)
    for axes in figure.axes[:3]:
        (arrows,) = [
            collection for collection in axes.collections if isinstance(collection, Quiver)
        ]
        ends = arrows.get_offsets() + np.stack([arrows.U, arrows.V], axis=1)
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert (ends > [left, low]).all()
        assert (ends < [right, high]).all()


def test_a_budget_shows_each_source_and_the_whole(result):
    budget = (
        BudgetEntry("gain of the force sensor", 0.03, 0.0, 0.03),
        BudgetEntry("noise of the points", 0.01, 3e-3, 0.04),
        BudgetEntry("pose of the object", 1e-4, 4e-3, 1e-4),
        BudgetEntry("contact radii", 1e-5, 1e-5, 1e-5),
    )
    figure = budget_figure(replace(result.estimate, budget=budget))
    young, ratio = figure.axes
    # Of a hundredth of the largest nothing would be seen.
    names = [entry.source for entry in budget[:3]]
    assert [tick.get_text() for tick in young.get_yticklabels()] == names
    assert [bar.get_width() for bar in young.patches] == pytest.approx([3.0, 4.0, 0.01])
    assert [bar.get_width() for bar in ratio.patches] == pytest.approx([0.0, 3e-3, 4e-3])
    wholes = [axes.lines[0].get_xdata()[0] for axes in (young, ratio)]
    # 3-4-5, and what is too small to be seen.
    assert wholes == pytest.approx([5.0, 5e-3], rel=1e-4)
    open_ratio = {"shear_modulus": True, "poisson_ratio": False, "young_modulus": True}
    estimate = replace(
        result.estimate, budget=budget, identifiable=open_ratio,
        status=Status.from_identifiable(open_ratio),
    )  # fmt: skip
    assert len(budget_figure(estimate).axes) == 1
    assert budget_figure(result.estimate) is None


def test_predictions_are_drawn_along_their_direction(session, result):
    fit = result.probes[0]
    foretold = np.zeros_like(fit.predicted) + np.array([0.0, 0.0, -2e-4])
    drawn = predictions_figure(
        session, replace(result, probes=(replace(fit, left_out_predicted=foretold),))
    )
    dots = drawn.axes[0].lines[1]
    # 168 points moved by (0.3, 0, -0.4) mm: along z 0.4 where 0.2 mm were foretold.
    np.testing.assert_allclose(dots.get_xdata(), 0.2, rtol=1e-12)
    np.testing.assert_allclose(dots.get_ydata(), 0.4, rtol=1e-12)
    assert len(dots.get_xdata()) == 168
