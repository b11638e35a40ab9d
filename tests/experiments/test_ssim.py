# SPDX-License-Identifier: Apache-2.0
"""SSIM of images with known values, and refused files."""

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from edgectl.errors import EdgectlError, FileError, UsageError
from edgectl.experiments import ssim
from edgectl.experiments.ssim import MapImage, compute_ssim
from tests.experiments.map_images import (
    Rows,
    a_grey_image,
    a_map_image,
    a_map_metadata,
    draw_room,
    encode_pgm,
    encode_png,
)

ROOM = draw_room()
C1, C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
EXACTLY = pytest.approx(1.0, abs=1e-12)


def by_formula(one: Rows, other: Rows) -> float:
    """Of a single window (Wang et al. 2004), with the unbiased variances that scikit-image takes."""
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    covariance = ((a - a.mean()) * (b - b.mean())).sum() / (a.size - 1)
    top = (2 * a.mean() * b.mean() + C1) * (2 * covariance + C2)
    return float(top / ((a.mean() ** 2 + b.mean() ** 2 + C1) * (a.var(ddof=1) + b.var(ddof=1) + C2)))


def noise(seed: int, size: int = 7) -> np.ndarray[Any, Any]:
    return np.random.default_rng(seed).integers(0, 256, (size, size))


@given(st.integers(0, 1000), st.integers(0, 1000))
@settings(deadline=None, max_examples=30)
def test_one_window_is_the_formula(one: int, other: int) -> None:
    found = compute_ssim(a_map_image(noise(one)), a_map_image(noise(other)))
    assert found == pytest.approx(by_formula(noise(one), noise(other)), abs=1e-9)
    assert -1.0 <= found <= 1.0
    assert found == pytest.approx(compute_ssim(a_map_image(noise(other)), a_map_image(noise(one))))


def test_the_same_is_one_and_the_opposite_is_below_zero() -> None:
    assert compute_ssim(a_map_image(ROOM), a_map_image(ROOM)) == EXACTLY
    assert compute_ssim(a_map_image(noise(1, 40)), a_map_image(255 - noise(1, 40))) < -0.5


@pytest.mark.parametrize(("one", "other"), [(0, 0), (255, 255), (100, 100), (0, 255), (100, 120)])
def test_images_of_one_grey_differ_by_their_brightness_alone(one: int, other: int) -> None:
    found = compute_ssim(a_map_image(np.full((9, 8), one)), a_map_image(np.full((9, 8), other)))
    assert found == pytest.approx((2 * one * other + C1) / (one**2 + other**2 + C1), abs=1e-9)


def test_the_more_is_wrong_the_lower() -> None:
    found = []
    for rows in (0, 2, 5, 9):
        wrong = ROOM.copy()
        wrong[1 : 1 + rows, 10:20] = 0
        found.append(compute_ssim(a_map_image(wrong), a_map_image(ROOM)))
    assert found == sorted(found, reverse=True)
    assert found[0] > found[-1] + 0.2


@pytest.mark.parametrize(
    "image",
    [
        a_grey_image(ROOM),
        a_grey_image(ROOM).convert("RGB"),
        a_grey_image(ROOM).convert("RGBA"),
        a_grey_image(ROOM).convert("LA"),
        a_grey_image(ROOM).quantize(8),
        Image.fromarray((ROOM * 257).astype(np.uint16)),
    ],
    ids=["8 bits", "colours", "alpha", "grey and alpha", "palette", "16 bits"],
)
def test_every_kind_of_png_shows_the_same(image: Image.Image) -> None:
    found = compute_ssim(MapImage(name="map.png", data=encode_png(image)), a_map_image(ROOM))
    assert found == pytest.approx(1.0, abs=1e-6)


def test_ascii_and_16_bit_and_black_and_white_images_are_read() -> None:
    height, width = ROOM.shape
    listed = " ".join(map(str, ROOM.ravel()))
    wide = (ROOM * 257).astype(">u2").tobytes()
    for data in (
        f"P2 {width} {height} 255 {listed}\n".encode(),
        f"P5 {width} {height} 65535\n".encode() + wide,
    ):
        assert compute_ssim(MapImage(name="map.pgm", data=data), a_map_image(ROOM)) == pytest.approx(
            1.0, abs=1e-6
        )
    walls = np.where(ROOM == 0, 0, 255)
    found = compute_ssim(
        MapImage(name="map.png", data=encode_png(a_grey_image(walls).convert("1"))), a_map_image(walls)
    )
    assert found == EXACTLY


def test_sizes_must_agree_where_nothing_says_where_the_images_lie() -> None:
    for one, other in (
        (a_map_image(ROOM[:, :-1]), a_map_image(ROOM)),
        (a_map_image(ROOM[:, :-1], a_map_metadata()), a_map_image(ROOM)),
    ):
        with pytest.raises(UsageError, match=r"map\.pgm has 23x16 pixels, map\.pgm 24x16") as caught:
            compute_ssim(one, other)
        assert ".yaml files of both" in caught.value.hint


def test_less_than_a_window_cannot_be_compared() -> None:
    for lies in (None, a_map_metadata()):
        with pytest.raises(UsageError, match="8x6 pixels, too few"):
            compute_ssim(a_map_image(np.zeros((6, 8)), lies), a_map_image(np.zeros((6, 8)), lies))


def test_maps_are_laid_over_each_other_where_they_lie() -> None:
    """The produced map begins two cells to the left of the truth and one below, and is larger: what it shows of the truth is right."""
    larger = np.full((ROOM.shape[0] + 4, ROOM.shape[1] + 5), 205)
    larger[3:-1, 2:-3] = ROOM
    assert (
        compute_ssim(a_map_image(larger, a_map_metadata(-1.0, -0.5)), a_map_image(ROOM, a_map_metadata()))
        == EXACTLY
    )
    assert (
        compute_ssim(a_map_image(larger, a_map_metadata(-0.5, -0.5)), a_map_image(ROOM, a_map_metadata()))
        < 0.9
    )


def test_what_was_not_seen_is_unknown() -> None:
    half, unseen = ROOM[:, :12], ROOM.copy()
    unseen[:, 12:] = 205
    found = compute_ssim(a_map_image(half, a_map_metadata()), a_map_image(ROOM, a_map_metadata()))
    assert found == pytest.approx(
        compute_ssim(a_map_image(unseen, a_map_metadata()), a_map_image(ROOM, a_map_metadata()))
    )
    assert found < 0.9


@pytest.mark.parametrize("times", [2, 3, 5])
def test_finer_and_coarser_maps_of_the_same_are_alike(times: int) -> None:
    finer = ROOM.repeat(times, axis=0).repeat(times, axis=1)
    assert (
        compute_ssim(
            a_map_image(finer, a_map_metadata(resolution=0.5 / times)), a_map_image(ROOM, a_map_metadata())
        )
        == EXACTLY
    )
    assert (
        compute_ssim(
            a_map_image(ROOM, a_map_metadata()), a_map_image(finer, a_map_metadata(resolution=0.5 / times))
        )
        == EXACTLY
    )


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
@settings(deadline=None, max_examples=50)
def test_it_is_the_same_anywhere_in_the_world(x: float, y: float) -> None:
    shifted = np.roll(ROOM, 1, axis=1)
    here = compute_ssim(a_map_image(shifted, a_map_metadata()), a_map_image(ROOM, a_map_metadata()))
    assert compute_ssim(
        a_map_image(shifted, a_map_metadata(x, y)), a_map_image(ROOM, a_map_metadata(x, y))
    ) == pytest.approx(here)


def test_maps_that_do_not_overlap_are_told() -> None:
    with pytest.raises(UsageError, match="do not overlap") as caught:
        compute_ssim(a_map_image(ROOM, a_map_metadata(x=500.0)), a_map_image(ROOM, a_map_metadata()))
    assert "origin" in caught.value.hint


def test_greys_mean_what_the_sheet_says() -> None:
    """Negated, drawn in pure black and white, or with other greys: the same map."""
    drawn = np.where(ROOM == 254, 255, ROOM)
    negated = np.where(ROOM == 205, 128, 254 - ROOM)
    dull = np.select([ROOM == 0, ROOM == 254], [90, 180], 130)
    truth = a_map_image(ROOM, a_map_metadata())
    assert compute_ssim(a_map_image(drawn, a_map_metadata()), truth) == EXACTLY
    assert compute_ssim(a_map_image(negated, a_map_metadata(negate=True)), truth) == EXACTLY
    assert compute_ssim(a_map_image(dull, a_map_metadata(occupied=0.6, free=0.4)), truth) == EXACTLY
    assert compute_ssim(a_map_image(dull, a_map_metadata()), truth) < 0.5


@pytest.mark.parametrize(
    "data",
    [b"", b"P5", b"P5\n9 9\n255\n", b"P5\n0 0\n255\n", b"P5\n-1 9\n255\n", b"P5\n9 9\n0\n", b"\x89PNG\r\n\x1a\n", b"GIF89a", b"%PDF-1.4", b"\0" * 99,
     b"P5 99999999 99999999 255\n", b"P2 7 7 255 " + b"x " * 49],
)  # fmt: skip
def test_what_is_no_image_is_refused(data: bytes) -> None:
    with pytest.raises(FileError, match=r"broken\.pgm is not a readable image") as caught:
        compute_ssim(MapImage(name="broken.pgm", data=data), a_map_image(ROOM))
    assert caught.value.hint


def test_no_image_is_unfolded_that_is_too_large() -> None:
    for size in ("5000 5000", "12000 12000"):
        with pytest.raises(FileError, match="too many to compare"):
            compute_ssim(MapImage(name="map.pgm", data=f"P5 {size} 255\n".encode()), a_map_image(ROOM))


def test_damage_is_told_or_shown_but_never_raises_otherwise() -> None:
    dice = random.Random(7)
    originals = [
        encode_pgm(ROOM),
        encode_png(a_grey_image(ROOM)),
        encode_png(a_grey_image(ROOM).quantize(8)),
        encode_png(Image.fromarray((ROOM * 257).astype(np.uint16))),
    ]
    for number in range(400):
        data = bytearray(originals[number % len(originals)])
        for _ in range(dice.randint(1, 4)):
            data[dice.randrange(len(data))] = dice.randrange(256)
        try:
            found = compute_ssim(
                MapImage(name="map", data=bytes(data[: dice.choice([len(data), dice.randrange(len(data))])])),
                a_map_image(ROOM),
            )
        except EdgectlError:
            continue
        assert -1.0 <= found <= 1.0 + 1e-12


def test_large_maps_are_compared_strip_by_strip(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = np.roll(ROOM, 2, axis=0)
    whole = compute_ssim(a_map_image(wrong), a_map_image(ROOM))
    for strip in (1, 24 * 3, 24 * 7):
        monkeypatch.setattr(ssim, "_STRIP_PIXELS", strip)
        assert compute_ssim(a_map_image(wrong), a_map_image(ROOM)) == pytest.approx(whole, abs=1e-12)
