"""Films: frames written as an MP4 or a GIF."""

from __future__ import annotations

import itertools
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ..._common.files import whole
from .backend import extra
from .palette import CAR_COLOURS, INK, ORANGE, PULL, PUSH, WHITE, mix

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray


def write_video(path: str | Path, frames: Iterable[NDArray[np.uint8]], fps: float) -> None:
    """Write frames (height, width, 3) uint8 of equal, even size as an .mp4 or a .gif film, atomically; most
    viewers of a GIF show at most 50 frames per second."""
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".mp4", ".gif"):
        raise InputError(f"cannot write a film to '{path}': end the name in .mp4 or .gif")
    with whole(path) as temporary:
        (_write_mp4 if kind == ".mp4" else _write_gif)(temporary, iter(frames), fps)


def _write_mp4(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    encoder = extra("imageio_ffmpeg", "writing an MP4", "imageio-ffmpeg")
    first = next(frames)
    height, width = first.shape[:2]
    film = encoder.write_frames(
        str(path), (width, height), fps=fps, quality=None, macro_block_size=2, ffmpeg_log_level="error",
        output_params=["-crf", "18", "-movflags", "+faststart"],
    )  # fmt: skip
    try:
        with closing(film):
            film.send(None)
            for frame in itertools.chain([first], frames):
                film.send(np.ascontiguousarray(frame))
    except OSError as error:
        lines = str(error).strip().splitlines()
        raise InputError(
            f"the film could not be encoded: {lines[-1] if lines else 'the encoder failed'}"
        ) from None


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    from PIL import Image  # matplotlib depends on this package, too

    # one palette for the whole film, from its beginning and the colours of the picture: static parts keep
    # their pixels, so that the file is small and free of flicker
    opening = list(itertools.islice(frames, 64))
    samples = opening[:: max(1, len(opening) // 8)]
    ramps = [
        mix(a, b, k / 8) for a in (*CAR_COLOURS, PULL, PUSH, ORANGE) for b in (WHITE, INK) for k in range(9)
    ]
    swatch = np.zeros((len(ramps), samples[0].shape[1], 3), np.uint8)
    swatch[:] = np.array(ramps, np.uint8)[:, None]
    master = Image.fromarray(np.concatenate([*samples, swatch])).quantize(256, Image.Quantize.MEDIANCUT)

    def reduced() -> Iterator[Any]:
        for frame in itertools.chain(opening, frames):
            yield Image.fromarray(frame).quantize(palette=master, dither=Image.Dither.NONE)

    images = list(reduced())
    ends = [round(100 * k / fps) for k in range(len(images) + 1)]  # a GIF counts in 10 ms
    durations = [10 * (b - a) for a, b in itertools.pairwise(ends)]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0, disposal=1)
