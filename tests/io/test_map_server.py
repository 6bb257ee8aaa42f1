"""Maps in the format of map_server."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from evalkit.core.errors import BadData
from evalkit.io import map_server

YAML = "image: map.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.5, 2.0, 0]\nnegate: 0\noccupied_thresh: 0.65\n"


def write_map(tmp_path, pgm, yaml=YAML + "free_thresh: 0.196\n"):
    (tmp_path / "map.pgm").write_bytes(pgm)
    path = tmp_path / "map.yaml"
    path.write_text(yaml)
    return path


def test_row_0_of_the_image_is_the_top_of_the_map(tmp_path):
    grid = map_server.read_map(
        write_map(tmp_path, b"P5\n# made by hand\n3 2\n255\n" + bytes([0, 254, 205, 254, 254, 0]))
    )
    assert grid.occupied().tolist() == [[False, False, True], [True, False, False]]
    assert grid.free().tolist() == [[True, True, False], [False, True, False]]
    assert grid.observed.tolist() == [[True, True, True], [True, True, False]]
    assert (grid.resolution_m, grid.origin_x, grid.origin_y) == (0.05, -1.5, 2.0)
    np.testing.assert_allclose(grid.centres(grid.occupied()), [[-1.375, 2.025], [-1.475, 2.075]])


def test_a_text_pgm_equals_the_binary_one(tmp_path):
    binary = map_server.read_map(write_map(tmp_path, b"P5 3 1 255\n" + bytes([0, 205, 254])))
    text = map_server.read_map(write_map(tmp_path, b"P2\n3 1\n255\n0 205 # unknown\n254\n"))
    assert text.log_odds.tolist() == binary.log_odds.tolist()


def test_unknown_stays_unknown_with_the_old_free_threshold(tmp_path):
    grid = map_server.read_map(write_map(tmp_path, b"P5 2 1 255\n" + bytes([205, 254]), YAML + "free_thresh: 0.25\n"))
    assert grid.observed.tolist() == [[False, True]]


def test_scale_is_linear_between_the_thresholds_and_raw_is_percent(tmp_path):
    greys = b"P5 4 1 255\n" + bytes([0, 102, 153, 255])  # occupancy 1, 0.6, 0.4, 0
    thresholds = YAML.replace("occupied_thresh: 0.65", "occupied_thresh: 0.7") + "free_thresh: 0.3\n"
    scaled = map_server.read_map(write_map(tmp_path, greys, thresholds.replace("trinary", "scale")))
    assert scaled.probability().tolist()[0][1:3] == pytest.approx([0.75, 0.25])
    assert (scaled.occupied().tolist(), scaled.free().tolist()) == (
        [[True, True, False, False]], [[False, False, False, True]],
    )  # fmt: skip
    percent = YAML.replace("trinary", "raw") + "free_thresh: 0.2\n"
    raw = map_server.read_map(write_map(tmp_path, b"P5 4 1 255\n" + bytes([0, 40, 100, 101]), percent))
    assert raw.observed.tolist() == [[True, True, True, False]]
    assert raw.probability()[0, 1] == pytest.approx(0.4)


def test_a_rotated_map_comes_with_its_origin(tmp_path):
    path = write_map(tmp_path, b"P5 1 1 255\n\0", YAML.replace("0]", "0.5]") + "free_thresh: 0.2\n")
    grid, map_from_grid = map_server.read_rotated_map(path)
    assert (grid.origin_x, grid.origin_y) == (0.0, 0.0)
    assert map_from_grid.row.tolist() == [-1.5, 2.0, 0.5]


def test_negate_swaps_black_and_white(tmp_path):
    grid = map_server.read_map(
        write_map(tmp_path, b"P5 2 1 255\n" + bytes([0, 255]), YAML.replace("negate: 0", "negate: 1"))
    )
    assert grid.occupied().tolist() == [[False, True]]


def test_sixteen_bit_images_are_big_endian(tmp_path):
    grid = map_server.read_map(write_map(tmp_path, b"P5 2 1 65535\n" + bytes([0, 255, 255, 0])))
    assert grid.occupied().tolist() == [[True, False]]
    assert grid.free().tolist() == [[False, True]]


@pytest.mark.parametrize("mode", ["L", "RGB", "P", "RGBA"])
def test_a_png_equals_the_pgm_with_the_same_grey_values(tmp_path, mode):
    greys = np.array([[0, 254, 205], [254, 254, 0]], dtype=np.uint8)
    image = BytesIO()
    Image.fromarray(greys).convert(mode).save(image, "PNG")
    found = map_server.read_map(write_map(tmp_path, image.getvalue()))
    twin = map_server.read_map(write_map(tmp_path, b"P5 3 2 255\n" + greys.tobytes()))
    assert np.array_equal(found.log_odds, twin.log_odds)
    assert np.array_equal(found.observed, twin.observed)


LAUGHS = "a0: &a0 [ha, ha]\n" + "".join(f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]\n" for k in range(1, 41))
"""Two words, doubled forty times: a terabyte when written out."""
MERGED = "a0: &a0 {x: 1}\n" + "".join(f"a{k}: &a{k} {{<<: [{', '.join(12 * [f'*a{k - 1}'])}]}}\n" for k in range(1, 12))
"""Merge keys multiply: a key is copied 12 to the power of 11 times."""


@pytest.mark.parametrize(
    ("pgm", "yaml", "part"),
    [
        (b"P5 3 2 255\n\0\0", YAML, "2 pixels for 3 x 2"),
        (b"\x89PNG\r\n", YAML, "damaged PNG image"),
        (b"GIF89a", YAML, "not a PGM or PNG image"),
        (b"P2 2 1 255\n0 x", YAML, "damaged pixels"),
        (b"", YAML, "empty"),
        (b"P5 1 1 255\n\0", "image: map.pgm\norigin: [0, 0, 0]\n", "missing key 'resolution'"),
        (b"P5 1 1 255\n\0", YAML.replace("trinary", "grey"), "'grey' is no mode; expected one of trinary, scale, raw"),
        (b"P5 1 1 255\n\0", YAML.replace("2.0, 0]", "2.0, 0.3]"), "rotated by 0.3"),
        (b"P5 1 1 255\n\0", YAML.replace("0.05", "-1"), "expected metres per cell"),
        (b"P5 1 1 255\n\0", YAML.replace("[-1.5, 2.0, 0]", "nowhere"), "origin: found 'nowhere'; expected [x, y, yaw]"),
        (b"P5 1 1 255\n\0", YAML.replace("[-1.5, 2.0, 0]", "'123'"), "origin: found '123'; expected [x, y, yaw]"),
        (b"P5 1 1 255\n\0", YAML.replace("-1.5", "9" * 400), "origin: found 9999"),
        (b"P5 1 1 255\n\0", YAML.replace("0.05", "9" * 400), "resolution: found 9999"),
        (b"P5 1 1 255\n\0", YAML.replace("0.05", ".inf"), "resolution: found inf; expected a finite number"),
        (b"P5 1 1 255\n\0", YAML.replace("0.65", "65"), "occupied_thresh: found 65; expected a probability, 0 to 1"),
        (b"P5 1 1 255\n\0", YAML.replace("0.65", ".nan"), "occupied_thresh: found nan; expected a finite number"),
        (b"P5 1 1 255\n\0", YAML + "free_thresh: -0.1\n", "free_thresh: found -0.1; expected a probability, 0 to 1"),
        (b"P5 1 1 255\n\0", "image: [", "not valid YAML"),
        (b"P5 1 1 255\n\0", "just words", "this is not the YAML file of a map (it has no keys)"),
        (b"P5 1000000000 1000000000 255\n\0", YAML, "1000000000 x 1000000000 pixels; the limit is 67108864"),
        (b"P5 " + b"9" * 5000 + b" 1 255\n\0", YAML, "not a PGM or PNG image"),
        (b"P2 1 1 255\n" + b"9" * 400, YAML, "damaged pixels"),
        (b"P5 1 1 99999\n\0\0", YAML, "white 99999"),
        (b"", YAML.replace("map.pgm", "x" * 300), "cannot be read"),
        (b"P5 1 1 255\n\0", "image: " + "[" * 1000, "not valid YAML"),
        (b"P5 1 1 255\n\0", "#" * 5000 + YAML, "this is not the YAML file of a map ("),
        (b"P5 1 1 255\n\0", "# t x y\n" + "1.5 0 0 0 0 0 0 1\n" * 9, "not the YAML file of a map (it has no keys)"),
        (b"P5 1 1 255\n\0", YAML.replace("map.pgm", "[map.pgm]"), "image: ['map.pgm'] is not a string"),
        (b"P5 1 1 255\n\0", LAUGHS + YAML, "not valid YAML (aliases such as *a0 are not read"),
        (b"P5 1 1 255\n\0", MERGED + YAML, "not valid YAML (aliases such as *a0 are not read"),
    ],
)
def test_an_invalid_map_is_reported_with_the_cause(tmp_path, pgm, yaml, part):
    with pytest.raises(BadData) as caught:
        map_server.read_map(write_map(tmp_path, pgm, yaml))
    assert part in str(caught.value)


def test_a_small_png_of_very_many_pixels_is_not_decoded(tmp_path):
    image = BytesIO()
    Image.new("1", (9000, 9000)).save(image, "PNG")
    assert len(image.getvalue()) < 12_000
    with pytest.raises(BadData, match="9000 x 9000 pixels"):
        map_server.read_map(write_map(tmp_path, image.getvalue()))
