"""The camera by which tests find the pixel of a point, against projections known in advance."""

from __future__ import annotations

import numpy as np
import pytest

from tool_input.browser.camera import Camera

# Down from z = 3 with x to the right: half a turn about x.
DOWN = {
    "position": [0.0, 0.0, 3.0],
    "wxyz": [0.0, 1.0, 0.0, 0.0],
    "fov": np.pi / 2,
    "image_width": 900,
    "image_height": 600,
}


def test_what_the_camera_looks_at_is_in_the_middle_and_the_field_of_view_ends_at_the_edge() -> None:
    camera = Camera.told(DOWN)
    # At a distance of 3 a field of view of 90 degrees shows 3 upwards and 3 downwards.
    points = [[0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, -3.0, 0.0], [3.0, 0.0, 0.0], [0.5, 0.0, 2.0]]
    expected = [[450, 300], [450, 0], [450, 600], [750, 300], [600, 300]]
    np.testing.assert_allclose(camera.pixels(points), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_ray_of_a_points_pixel_goes_through_the_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=4)
    camera = Camera.told({**DOWN, "wxyz": turn / np.linalg.norm(turn), "fov": 1.2})
    point = camera.position + camera.axes @ (rng.uniform(-1, 1, 3) + np.array([0, 0, 3.0]))
    way = point - camera.position
    ray = camera.ray(camera.pixels([point])[0])
    np.testing.assert_allclose(ray, way / np.linalg.norm(way), atol=1e-12)
