"""The palette of an animation keeps the colours of small things in every frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageSequence

from rover_bags.views.animation import tension_colours
from rover_bags.views.gif import save_gif

SMALL = [*tension_colours(), (213, 94, 0)]
COUNT = 41


@pytest.mark.parametrize("shown", [0, 3, COUNT - 1])
def test_what_few_frames_show_keeps_its_colour(tmp_path: Path, shown: int):
    """Large shades of grey fill every frame; small lines of all colours only one."""
    ramp = np.tile(np.linspace(60, 255, 320), (200, 1)).astype(np.uint8)
    frames = [Image.fromarray(ramp).convert("RGB") for _ in range(COUNT)]
    draw = ImageDraw.Draw(frames[shown])
    for k, colour in enumerate(SMALL):
        draw.rectangle((10, 10 * k + 4, 12, 10 * k + 6), fill=colour)
    save_gif(tmp_path / "made.gif", frames, SMALL, 50, 1200)
    with Image.open(tmp_path / "made.gif") as made:
        times = []
        for k, each in enumerate(ImageSequence.Iterator(made)):
            times.append(int(each.info["duration"]))
            if k == min(shown, 1):  # equal frames are joined
                image = np.array(each.convert("RGB"), float)
    assert sum(times) == 50 * (COUNT - 1) + 1200
    for k, colour in enumerate(SMALL):
        assert np.abs(image[10 * k + 5, 11] - colour).max() < 12
