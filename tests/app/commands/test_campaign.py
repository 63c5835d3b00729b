"""`palpate campaign` at the terminal: rows in, tables and pictures out."""

import csv
import json

import numpy as np
import pyarrow.parquet as parquet
import pytest
from PIL import Image

from palpate.campaign import Row, Store
from palpate.campaign.store import CampaignItem

FAR = 9


@pytest.fixture
def campaign(tmp_path):
    """Two groups of ten pieces, one of them twice as stiff as the others, and one that failed."""
    rng = np.random.default_rng(3)
    rows = [Row("lost", "b", "failed", message="lost/session.toml: cannot be read")]
    for k in range(20):
        young = float(5e4 * np.exp(0.03 * rng.normal())) * (2.0 if k == FAR else 1.0)
        shear = young / 2.6
        rows.append(
            Row(
                f"part {k}", "ab"[k // 10], "done", "ok", shear, 0.98 * shear, 1.02 * shear, 0.3,
                0.28, 0.32, young, 0.98 * young, 1.02 * young, seconds=2.0, address=f"{k}",
            )
        )  # fmt: skip
    store = Store(tmp_path / "parts-campaign")
    store.begin([CampaignItem(row.session, row.group, tmp_path) for row in rows])
    for row in rows:
        store.set_row(row)
    return store.folder


def test_status_counts_and_names(palpate, campaign):
    code, out, err = palpate("campaign", "status", campaign)
    assert code == 0
    assert err == "palpate: note: lost: lost/session.toml: cannot be read\n"
    assert "Outlier: part 9 (Young's modulus)" in out
    lines = [line.split() for line in out.splitlines()]
    assert ["a", "10", "10", "0", "0"] in [line[:5] for line in lines]
    assert ["all", "21", "20", "1", "0"] in [line[:5] for line in lines]


def test_table_has_every_row(palpate, campaign, tmp_path):
    code, out, _ = palpate("campaign", "table", campaign, "--json")
    rows = json.loads(out)["tables"][0]["rows"]
    assert code == 0
    assert len(rows) == 21
    assert rows[FAR + 1]["outlier"] == "young_modulus"
    for name in ("t.csv", "t.parquet"):
        assert palpate("campaign", "table", campaign, "--out", name)[0] == 0
    with (tmp_path / "t.csv").open() as file:
        cells = list(csv.DictReader(file))
    read = parquet.read_table(tmp_path / "t.parquet").to_pylist()
    known = [row.young_modulus for row in Store(campaign).rows()]
    assert [row["young_modulus"] for row in read] == known
    assert [float(row["young_modulus"] or "nan") for row in cells[1:]] == known[1:]
    assert cells[0]["young_modulus"] == ""
    assert read[FAR + 1]["outlier"] == cells[FAR + 1]["outlier"] == "young_modulus"


def test_picture_shows_the_outlier(palpate, campaign, tmp_path):
    code, out, _ = palpate("campaign", "plot", campaign)
    assert (code, out) == (0, "Picture in parts-campaign.png\n")
    with Image.open(tmp_path / "parts-campaign.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    orange = np.abs(pixels - (0xD5, 0x5E, 0x00)).sum(axis=2) < 30
    blue = np.abs(pixels - (0x00, 0x72, 0xB2)).sum(axis=2) < 30
    # Twice the others' modulus: above them all, in the upper panel.
    assert np.nonzero(orange)[0].max() < np.nonzero(blue)[0].min()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("table", "--out", "t.xlsx"), "ends in '.xlsx'; a table is a .csv or a .parquet file"),
        (("plot", "--out", "t.gif"), "ends in '.gif'; give a .png, .svg or .pdf file"),
    ],
)
def test_other_files_are_refused(palpate, campaign, words, said):
    code, _, err = palpate("campaign", words[0], campaign, *words[1:])
    assert code == 2
    assert said in err


def test_what_is_no_campaign(palpate, tmp_path):
    for command in ("status", "table", "plot"):
        code, _, err = palpate("campaign", command, tmp_path)
        assert code == 2
        assert "holds no campaign.sqlite" in err


def test_a_campaign_of_nothing_good_needs_no_workers(palpate, tmp_path):
    (tmp_path / "list.txt").write_text("nowhere\n")
    code, out, err = palpate("campaign", "list.txt")
    assert code == 3
    assert "nowhere: no such file or folder" in err
    assert "Table in list-campaign/table.csv" in out
    code, _, err = palpate("campaign", "plot", "list-campaign")
    assert code == 2
    assert "no session has a result yet" in err


@pytest.mark.parametrize("words", [("--workers", 0), ("--workers", 2, "--scheduler", "tcp://a:1")])
def test_workers_of_ones_own(palpate, tmp_path, words):
    (tmp_path / "list.txt").write_text("nowhere\n")
    code, _, err = palpate("campaign", "list.txt", *words)
    assert code == 2
    assert "and is for the cluster that the command starts itself" in err
