"""Saves frames as an animated GIF, whose frames share one palette."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from rover_bags.views.perspective import Rgb

_PALETTE: Final = 96
_SEEN: Final = 9  # frames whose colours the palette is made from
_SWATCH: Final = 24  # width of a colour in the sheet that gives the palette [pixel]


def save_gif(
    path: Path, frames: Sequence[Image.Image], colours: Sequence[Rgb], shown: int, last: int
) -> None:
    """Save frames as an animation that repeats.

    Args:
        path: file to write.
        frames: of one size.
        colours: of small things, which a palette of the large ones would lose.
        shown: time of each frame [ms].
        last: time of the last one [ms].
    """
    palette = _palette(frames, colours)
    flat = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    duration = [shown] * (len(flat) - 1) + [last]
    flat[0].save(
        path, save_all=True, append_images=flat[1:], duration=duration, loop=0, optimize=True
    )


def _palette(frames: Sequence[Image.Image], colours: Sequence[Rgb]) -> Image.Image:
    """Colours of frames spread over the animation, and of small things."""
    chosen = list(_spread(frames))
    width, height = chosen[0].size
    sheet = Image.new("RGB", (width + _SWATCH * len(colours), height * len(chosen)))
    for k, each in enumerate(chosen):
        sheet.paste(each, (0, k * height))
    for k, colour in enumerate(colours):
        left = width + _SWATCH * k
        sheet.paste(colour, (left, 0, left + _SWATCH, sheet.height))
    return sheet.quantize(_PALETTE)


def _spread(frames: Sequence[Image.Image]) -> Iterator[Image.Image]:
    for k in np.linspace(0, len(frames) - 1, _SEEN).round().astype(int):
        yield frames[int(k)]
