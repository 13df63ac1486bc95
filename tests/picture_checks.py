"""Pixels and words of rendered pictures, for the tests of the rendering."""

from __future__ import annotations

import itertools
import subprocess
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym.view.rendering import Renderer, backend
from isd_gym.view.rendering.canvas import Canvas

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def frame(*shots: Any, width: int, height: int) -> np.ndarray:
    """Return the picture of the shots."""
    picture = Renderer("rgb_array", width=width, height=height, cars=len(shots)).draw(
        *shots
    )
    assert picture is not None
    return picture


def near(
    picture: np.ndarray, colour: tuple[int, int, int], tolerance: int = 6
) -> np.ndarray:
    """Return the pixels of nearly this colour."""
    return (np.abs(picture.astype(int) - colour) <= tolerance).all(axis=2)


def listen(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that gets the words of later pictures, in the order in which they are set."""
    said: list[str] = []
    typeset = Canvas._typeset

    def hear(canvas: Canvas, words: str, *style: Any) -> Any:
        said.append(words)
        return typeset(canvas, words, *style)

    monkeypatch.setattr(Canvas, "_typeset", hear)
    return said


def read_mp4(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Return the frames of a film of this width and height."""
    import imageio_ffmpeg

    encoder = imageio_ffmpeg.get_ffmpeg_exe()
    command = [
        encoder,
        "-loglevel",
        "error",
        "-i",
        str(path),
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, size[1], size[0], 3).astype(int)


def check_words(
    poses: list[Any], cars: int, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that the words of each pose are inside the picture and do not touch."""
    placed: list[Any] = []
    finish = Canvas.finish

    def remember(canvas: Any) -> None:
        placed[:] = [
            surface.get_rect(topleft=place) for surface, place in canvas._texts
        ]
        finish(canvas)

    monkeypatch.setattr(Canvas, "finish", remember)
    box = backend.pygame().Rect((0, 0), size)
    for pose in poses:
        frame(*[pose] * cars, width=size[0], height=size[1])
        assert len(placed) > 15
        assert all(box.contains(words) for words in placed)
        # the boxes of full height may graze each other; the words themselves then do not
        tight = [words.inflate(0, -0.3 * words.height) for words in placed]
        assert not [
            pair
            for pair in itertools.combinations(tight, 2)
            if pair[0].colliderect(pair[1])
        ]
