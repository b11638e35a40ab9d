# SPDX-License-Identifier: Apache-2.0
"""Map files: where they are read from, and which are refused."""

from pathlib import Path

import pytest

from edgectl.errors import EdgectlError, FileError, InputError, UsageError
from edgectl.experiments import map_comparison
from edgectl.experiments.map_comparison import compare_maps, read_local_file
from tests.experiments.map_images import a_grey_image, draw_room, encode_pgm, encode_png
from tests.views.fixtures import ROOT

SHEET = b"image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    (tmp_path / "map.pgm").write_bytes(encode_pgm(draw_room()))
    (tmp_path / "world.yaml").write_bytes(SHEET)
    return tmp_path / "world.yaml"


def test_a_sheet_names_its_image_beside_itself(truth: Path) -> None:
    there = {"out/map.yaml": SHEET, "out/map.pgm": encode_pgm(draw_room())}
    assert compare_maps("out/map.yaml", there.__getitem__, truth) == pytest.approx(1.0)
    absolute = {
        "out/map.yaml": SHEET.replace(b"map.pgm", b"/srv/m.pgm"),
        "/srv/m.pgm": encode_pgm(draw_room()),
    }
    assert compare_maps("out/map.yaml", absolute.__getitem__, truth) == pytest.approx(1.0)


def test_images_are_compared_as_they_are(truth: Path) -> None:
    assert compare_maps(
        "map.PNG", lambda _: encode_png(a_grey_image(draw_room())), truth.parent / "map.pgm"
    ) == pytest.approx(1.0)


def test_what_is_fetched_and_fails_is_told_as_it_is(truth: Path) -> None:
    def gone(name: str) -> bytes:
        raise FileError(f"{name} is not there")

    with pytest.raises(FileError, match=r"out/map\.yaml is not there"):
        compare_maps("out/map.yaml", gone, truth)


def test_files_that_cannot_be_compared(truth: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = truth.parent
    (directory / "bad.yaml").write_bytes(b"image: 5\n")
    cases: list[tuple[str, Path, type[EdgectlError], str]] = [
        ("map.tiff", truth, UsageError, "map.tiff is not a map file"),
        (str(truth), directory / "none.yaml", FileError, "none.yaml cannot be read: No such file"),
        (
            str(truth),
            directory / "bad.yaml",
            InputError,
            r"bad\.yaml:1:1: a map needs resolution \(and 2 more\)",
        ),
    ]
    for file, other, kind, words in cases:
        with pytest.raises(kind, match=words) as caught:
            compare_maps(file, read_local_file, other)
        assert caught.value.hint or kind is InputError
    monkeypatch.setattr(map_comparison, "MAX_MAP_BYTES", 10)
    with pytest.raises(FileError, match="is larger than"):
        compare_maps(str(truth), read_local_file, truth)


def test_a_truth_is_checked_before_anything_is_done(truth: Path) -> None:
    map_comparison.check_truth_map(truth)
    truth.with_name("map.pgm").write_bytes(b"P5")
    with pytest.raises(FileError, match="not a readable image"):
        map_comparison.check_truth_map(truth)


def test_the_maps_of_the_page_are_as_it_says() -> None:
    examples = ROOT / "docs" / "examples"
    found = compare_maps(str(examples / "map.yaml"), read_local_file, examples / "world.yaml")
    assert f"{found:.4f}" in (ROOT / "docs" / "concepts" / "ssim.md").read_text()
