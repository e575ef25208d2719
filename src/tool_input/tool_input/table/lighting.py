"""The light in a window: from over the surgeon's shoulder, with some from the other side."""

from __future__ import annotations

import viser

KEY, FILL, AROUND = 2.6, 0.9, 1.0
"""Intensities: light that faces the tissue and what is around add up to about its own colour, so
that a colour in a view is that of its bar."""


def light(api: viser.SceneApi) -> None:
    """Light a window's scene, viser's own lights and surroundings switched off."""
    api.configure_default_lights(enabled=False, cast_shadow=False)
    api.configure_environment_map(None)
    api.add_light_directional("/light/key", intensity=KEY, position=(1.0, -1.5, 2.0))
    api.add_light_directional(
        "/light/fill", color=(214, 226, 255), intensity=FILL, position=(-1.5, 1.5, 0.3)
    )
    api.add_light_hemisphere(
        "/light/around", sky_color=(255, 250, 244), ground_color=(190, 178, 186), intensity=AROUND
    )
