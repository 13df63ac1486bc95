"""Recorders of episodes: Gymnasium's `RecordVideo` with fewer pictures than control steps, in real time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from gymnasium import wrappers

from isd_gym._common.errors import InputError, shown

if TYPE_CHECKING:
    import gymnasium as gym
    from gymnasium.wrappers.vector import RecordVideo as _VectorRecorder
else:
    from gymnasium.wrappers import vector

    #: the recorder of batches; Gymnasium has had one since a version later than the oldest allowed
    _VectorRecorder = getattr(vector, "RecordVideo", object)

FPS = 50.0  # pictures per simulated second


class _EveryNthStep:
    """Mixin of Gymnasium's recorders that keeps the pictures of every n-th step.

    Gymnasium's recorders take a picture at every step, which is 200 per second of a car: more than a screen
    shows, and four times the work.
    """

    metadata: Any
    frames_per_sec: Any
    video_length: Any

    def _set_pace(self, fps: float) -> None:
        """Choose n for the wanted pictures per second, and n times as short a film for a length in steps."""
        steps_per_second = self.metadata.get("render_fps", FPS)
        self._every = max(1, round(steps_per_second / fps))
        self.frames_per_sec = steps_per_second / self._every
        if math.isfinite(self.video_length):
            self.video_length = max(1, round(self.video_length / self._every))
        self._calls = 0

    def start_recording(self, video_name: str) -> None:
        """Start a recording with a picture of the present state.

        Args:
            video_name: Name of the file without its suffix.
        """
        self._calls = 0
        super().start_recording(video_name)  # type: ignore[misc]

    def _capture_frame(self) -> None:
        if self._calls % self._every == 0:
            super()._capture_frame()  # type: ignore[misc]
        self._calls += 1


def _checked(fps: float) -> float:
    if not (isinstance(fps, int | float) and math.isfinite(fps) and fps > 0):
        raise InputError(f"fps must be a positive number of pictures per second, not {shown(fps)}")
    return fps


class RecordVideo(_EveryNthStep, wrappers.RecordVideo):
    """Record episodes of an environment in real time, like `gymnasium.wrappers.RecordVideo` with 50 pictures per second.

    Args:
        env: Environment with render_mode "rgb_array".
        video_folder: Folder of the films.
        fps: Pictures per simulated second; the number of steps per picture is rounded to a whole number.
        options: Further arguments of Gymnasium's wrapper; `video_length` is a number of steps.

    Raises:
        InputError: The frame rate is invalid.
    """

    def __init__(
        self, env: gym.Env[Any, Any], video_folder: str, *, fps: float = FPS, **options: Any
    ) -> None:
        _checked(fps)
        super().__init__(env, video_folder, **options)
        self._set_pace(fps)


class RecordVectorVideo(_EveryNthStep, _VectorRecorder):
    """Record all cars of a vector environment side by side, like `gymnasium.wrappers.vector.RecordVideo` with 50 pictures per second.

    Args:
        env: Vector environment with render_mode "rgb_array".
        video_folder: Folder of the films.
        fps: Pictures per simulated second; the number of steps per picture is rounded to a whole number.
        options: Further arguments of Gymnasium's wrapper; `video_length` is a number of steps.

    Raises:
        InputError: The frame rate is invalid, or the installed Gymnasium has no recorder of batches.
    """

    def __init__(
        self, env: gym.vector.VectorEnv[Any, Any, Any], video_folder: str, *, fps: float = FPS, **options: Any
    ) -> None:
        if not hasattr(_VectorRecorder, "start_recording"):
            raise InputError("this version of gymnasium has no recorder of batches: pip install -U gymnasium")
        _checked(fps)
        super().__init__(env, video_folder, **options)
        self._set_pace(fps)
