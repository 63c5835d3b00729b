"""The report as a reader's browser has it: whole in itself, true to the result, escaped."""

import base64
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from browser_help import browser as browser
from estimate_relaxation import sample_relaxation
from estimate_samples import constants, sample_result

from palpate.api import Result
from palpate.errors import RecordError
from palpate.pipeline import read_fitted_surface
from palpate.records import (
    Constant,
    LoadDependence,
    Status,
    check_fit_result,
    read_estimate,
    write_estimate,
)
from palpate.report import write_report
from palpate.report.scene import scene


class Page(HTMLParser):
    """Addresses, texts and the data of a page."""

    def __init__(self, file):
        super().__init__()
        self.addresses, self.texts, self.scripts, self.styles, self.tags = [], [], [], [], []
        self.within = ""
        self.feed(file.read_text(encoding="utf-8"))
        self.text = " ".join(" ".join(self.texts).split())

    def handle_starttag(self, tag, attrs):
        self.within = tag
        self.tags.append(tag)
        self.addresses += [
            value for key, value in attrs if key in ("src", "href", "data", "srcset")
        ]

    def handle_endtag(self, tag):
        self.within = ""

    def handle_data(self, data):
        {"script": self.scripts, "style": self.styles}.get(self.within, self.texts).append(data)


def page_of(folder):
    return Page(folder / "report.html")


def unpacked(packed, width=3):
    numbers = np.frombuffer(base64.b64decode(packed["data"]), "<i2").astype(float)
    numbers[numbers == -32768] = np.nan
    return (numbers * packed["unit"]).reshape(-1, width) if width > 1 else numbers * packed["unit"]


def test_nothing_is_asked_of_another_host(saved):
    page = page_of(saved)
    assert page.addresses
    assert [address for address in page.addresses if not address.startswith("data:")] == []
    style = "".join(page.styles)
    assert "url(" not in style
    assert "@import" not in style
    script = page.scripts[-1]
    for word in ("fetch", "XMLHttpRequest", "import(", "WebSocket", "http:", "https:", "eval("):
        assert word not in script
    assert not {"link", "iframe", "object", "embed"} & set(page.tags) - {"link"}


# A4 less its margins, at 96 to the inch; and a phone.
@pytest.mark.parametrize(("media", "width"), [("print", 688), ("screen", 390)])
def test_nothing_is_cut_at_the_right(session, tmp_path, browser, media, width):
    plain = sample_result(session)
    figures = {
        "prediction_error": 1e-3,
        "homogeneous_error": 2e-3,
        "prediction_score": 1.2,
        "prediction_within": 0.9,
    }
    probes = tuple(replace(probe, **figures) for probe in plain.estimate.probes)
    result = replace(plain, estimate=replace(plain.estimate, probes=probes))
    saved = Result(session, result).save(tmp_path / "saved")
    assert "within 95 % (%)" in page_of(saved).text
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.emulate_media(media=media)
    page.goto((saved / "report.html").as_uri())
    # On a screen wide tables scroll within the page.
    wide = "table" if media == "print" else "body"
    ends = f"[...document.querySelectorAll('{wide}')].map(x => x.getBoundingClientRect().right)"
    assert max(page.evaluate(ends)) <= width
    page.close()


def test_the_verdict_comes_first_and_all_parts_are_there(saved):
    page = page_of(saved)
    parts = [
        "Determined", "All three constants are determined", "Measured and simulated",
        "Each probing alone", "Likelihood", "Errors that" , "What was excluded", "To repeat it",
    ]  # fmt: skip
    places = [page.text.find(part) for part in parts if part != "Errors that"]
    assert -1 not in places
    assert places == sorted(places)
    # The sample's E of 60 kPa, 4 % on either side, and its points: 20 of 21 measured.
    assert "60.0 ± 1.2 kPa" in page.text
    assert "57.6 to 62.4" in page.text
    assert "1 (5 %)" in page.text


def test_the_budget_is_there_where_it_is_known(saved, tmp_path):
    title = "Where the uncertainty comes from"
    assert title not in page_of(saved).text
    entry = {"source": "<gain>", "shear_modulus": 0.0123, "poisson_ratio": None}
    root = json.loads((saved / "estimate.json").read_text(encoding="utf-8"))
    root["budget"] = [entry | {"young_modulus": 0.0456}]
    (saved / "estimate.json").write_text(json.dumps(root), encoding="utf-8")
    write_report(saved, tmp_path / "again.html")
    text = Page(tmp_path / "again.html").text
    assert f"{title} The squares" in text
    assert "<gain> 4.6 1.2 \N{EN DASH}" in text


def test_probings_are_shown_in_the_order_of_the_session(saved, tmp_path):
    pictures = saved / "displacement"
    shutil.copy(pictures / "n01.png", pictures / "a00.png")
    write_report(saved, tmp_path / "again.html")
    text = (tmp_path / "again.html").read_text(encoding="utf-8")
    assert 0 < text.find("displacement of n01") < text.find("displacement of a00")


def test_what_repeats_it_is_there(saved):
    text = page_of(saved).text
    for line in (saved / "inputs.txt").read_text(encoding="utf-8").splitlines():
        assert line.split()[0] in text
    assert "session.toml" in text


def test_a_constant_that_is_not_determined_has_no_number(tmp_path, session):
    result = sample_result(session)
    lost = {"shear_modulus": True, "poisson_ratio": False, "young_modulus": True}
    estimate = replace(
        result.estimate, status=Status.POISSON_RATIO_NOT_IDENTIFIABLE, identifiable=lost,
        poisson_ratio=replace(constants()["poisson_ratio"], ci95=(0.0, 0.5)),
    )  # fmt: skip
    folder = Result(session, replace(result, estimate=estimate)).save(tmp_path / "lost")
    text = page_of(folder).text
    assert "Partly determined Poisson's ratio is not determined by the data." in text
    assert "not determined possible: 0.0" in text
    assert "What to do. Measure displacement vectors" in text
    assert not re.search(r"\bnu\b", text)
    assert "0.3000" not in text


def test_the_view_holds_what_was_measured_and_predicted(saved, session):
    shown = json.loads(page_of(saved).scripts[0])
    (probing,) = shown["probings"]
    mesh, field = session.mesh, session.probings[0].displacement
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    seen = np.isfinite(field.displacement).all(axis=1)
    # Half a step of 1 / 32767 of the largest component [mm].
    exact = {"atol": 0.5 * 40.0 / 32767}
    np.testing.assert_allclose(unpacked(shown["vertices"]), 1e3 * (mesh.vertices - middle), **exact)
    np.testing.assert_allclose(
        unpacked(probing["points"]), 1e3 * (field.points[seen] - middle), **exact
    )
    np.testing.assert_allclose(
        unpacked(probing["measured"]), 1e3 * field.displacement[seen], **exact
    )
    np.testing.assert_allclose(
        unpacked(probing["predicted"]), 0.5e3 * field.displacement[seen], **exact
    )
    triangles = np.frombuffer(base64.b64decode(shown["triangles"]), "<u4").reshape(-1, 3)
    np.testing.assert_array_equal(triangles, mesh.triangles)
    held = np.frombuffer(base64.b64decode(shown["held"]), np.uint8)
    np.testing.assert_array_equal(np.flatnonzero(held), session.held_triangles)
    # Rows as a person counts them; the first was not measured.
    assert probing["rows"][0] == 2
    assert probing["force"] == [0.0, 0.0, -1.2]


def test_residuals_are_in_sigmas(tmp_path, session):
    result = sample_result(session)
    sigma = np.full_like(result.probes[0].predicted, 5e-5)
    fits = (replace(result.probes[0], sigma=sigma),)
    folder = Result(session, replace(result, probes=fits)).save(tmp_path / "sigmas")
    (probing,) = json.loads(page_of(folder).scripts[0])["probings"]
    # Left over is half of (0.3, 0, -0.4) mm: 3, 0 and -4 sigmas, their rms over three components.
    np.testing.assert_allclose(unpacked(probing["sigmas"], 1), np.sqrt(25 / 3), rtol=1e-4)


def test_many_large_probings_stay_below_five_megabytes(saved):
    surface = read_fitted_surface(saved)
    (probing,) = surface.probings
    rows = np.arange(4000) % len(probing.points)
    large = replace(
        probing, points=probing.points[rows], displacement=probing.displacement[rows],
        predicted=probing.predicted[rows], sigma=probing.sigma[rows], weight=probing.weight[rows],
    )  # fmt: skip
    shown = scene(replace(surface, probings=(large,) * 60))
    assert len(json.dumps(shown)) < 2.5e6
    # What there is no room for is counted.
    assert 0 < shown["left_out"] == 60 - len(shown["probings"])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "surface.npz").unlink(), r"surface.npz: missing.*half copied"),
        (
            lambda folder: (folder / "estimate.json").write_text("{}"),
            r"estimate.json: changed.*half copied",
        ),
        (lambda folder: (folder / "contents.txt").unlink(), "no result of this version"),
    ],
)
def test_a_result_that_is_not_whole_is_refused(saved, spoil, message):
    spoil(saved)
    with pytest.raises(RecordError, match=message):
        check_fit_result(saved)


def test_a_damaged_surface_is_one_message(saved, tmp_path):
    file = saved / "surface.npz"
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(RecordError, match=r"surface.npz: is damaged"):
        write_report(saved, tmp_path / "report.html")


@pytest.mark.parametrize(
    ("name", "value"), [("triangles", -1), ("triangles", 10**6), ("held", -1), ("vertices", np.nan)]
)
def test_a_surface_of_impossible_numbers_is_refused(saved, tmp_path, name, value):
    with np.load(saved / "surface.npz") as stored:
        arrays = dict(stored)
    arrays[name].ravel()[0] = value
    np.savez_compressed(tmp_path / "surface.npz", **arrays)
    with pytest.raises(RecordError, match=rf"surface\.npz: {name} has .*; fit the session"):
        read_fitted_surface(tmp_path)


@pytest.mark.parametrize(("name", "read"), [("palpate-surface/1", True), ("palpate-mesh/1", False)])
def test_surfaces_of_earlier_results_are_read(saved, tmp_path, name, read):
    """They bore the name that the mesh of a scan had, too; another name is another file."""
    with np.load(saved / "surface.npz") as stored:
        arrays = {**stored, "format": np.array(name)}
    np.savez_compressed(tmp_path / "surface.npz", **arrays)
    if read:
        again = read_fitted_surface(tmp_path)
        np.testing.assert_array_equal(again.vertices, read_fitted_surface(saved).vertices)
    else:
        with pytest.raises(RecordError, match=r"'palpate-mesh/1', not 'palpate-fitted-surface/1'"):
            read_fitted_surface(tmp_path)


def test_the_report_is_made_again_from_the_folder_alone(saved, tmp_path):
    write_report(saved, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_bytes() == (saved / "report.html").read_bytes()


def test_pictures_are_drawings_of_the_result(saved):
    pictures = re.findall(
        r'src="data:image/(svg\+xml|webp);base64,([^"]+)"',
        (saved / "report.html").read_text(encoding="utf-8"),
    )
    assert [kind for kind, _ in pictures] == ["svg+xml", "svg+xml", "webp"]
    assert base64.b64decode(pictures[0][1]) == (saved / "probings.svg").read_bytes()
    assert base64.b64decode(pictures[2][1]).startswith(b"RIFF")


def test_a_body_that_creeps_and_stiffens_says_so(saved, tmp_path):
    folder = tmp_path / "creeping"
    shutil.copytree(saved, folder)
    assert "Over time" not in page_of(saved).text
    estimate = read_estimate(folder / "estimate.json")
    relaxation = sample_relaxation(2e4)
    stiffening = Constant(3.0, 0.2, (2.6, 3.4))
    load = LoadDependence(Constant(-0.12, 0.03, (-0.18, -0.06)), (0.5, 2.0), (1.1, 0.9))
    changed = replace(estimate, relaxation=relaxation, stiffening=stiffening, load=load)
    write_estimate(folder / "estimate.json", changed)
    write_report(folder, folder / "report.html")
    text = page_of(folder).text
    assert "stiffening C2 / C1" in text
    assert "2.60 to 3.40" in text
    assert "Stiffness falls with load: " in text
    assert "falls with load, as force to the -0.120 \u00b1 0.030 95 % interval" in text
    assert "Over time" in text
    assert "The constants above are those at 12 s after contact." in text
    assert relaxation.remarks[0] in text
    assert "G at 10 s 14.45 \u00b1 0.29" in text
