"""Films: frames written as an MP4."""

from __future__ import annotations

import itertools
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ..._common.files import whole
from .backend import extra

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray


def write_video(
    path: str | Path, frames: Iterable[NDArray[np.uint8]], fps: float
) -> None:
    """Write frames (height, width, 3) uint8 of equal, even size as an .mp4 film, atomically."""
    path = Path(path)
    if path.suffix.lower() != ".mp4":
        raise InputError(f"cannot write a film to '{path}': end the name in .mp4")
    with whole(path) as temporary:
        if not _write_mp4(temporary, iter(frames), fps):
            raise InputError(
                f"cannot write '{path}': the encoder did not finish the film (is the disk full?)"
            )


def _write_mp4(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> bool:
    """Write the film, and return whether the file holds every frame: the library ignores how the encoder ends."""
    encoder = extra("imageio_ffmpeg", "writing an MP4", "imageio-ffmpeg")
    first = next(frames)
    height, width = first.shape[:2]
    given = 0
    film = encoder.write_frames(
        str(path), (width, height), fps=fps, quality=None, macro_block_size=2, ffmpeg_log_level="error",
        output_params=["-crf", "18", "-movflags", "+faststart"],
    )  # fmt: skip
    try:
        with closing(film):
            film.send(None)
            for frame in itertools.chain([first], frames):
                film.send(np.ascontiguousarray(frame))
                given += 1
    except OSError as error:
        lines = str(error).strip().splitlines()
        raise InputError(
            f"the film could not be encoded: {lines[-1] if lines else 'the encoder failed'}"
        ) from None
    try:
        return bool(encoder.count_frames_and_secs(str(path))[0] == given)
    except RuntimeError:  # the film cannot be read
        return False
