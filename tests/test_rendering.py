"""The picture: what moves does so in the right direction, by the right amount, and hides no word."""

import os
import sys
from functools import partial

import numpy as np
import picture_checks
import pytest
from program import refused

from isd_gym import InputError
from isd_gym._common.errors import how_to_install
from isd_gym.view import rendering
from isd_gym.view.rendering import (
    CarSnapshot,
    CornerSnapshot,
    Renderer,
    backend,
    write_video,
)

pygame = backend.pygame()
LIMIT = 0.02465  # [m], Table 1's deputy stroke at the terminals
# at 640x400: 90 px are a metre, and motions are exaggerated ten times
METRE = 90
PIXELS_PER_METRE = 10 * METRE
WHEEL = 150  # column of the wheel at 640x400


def snapshot(**changes):
    base = {
        "time": 0.0, "body": 0.0, "wheel": 0.0, "piston": 0.0, "joint": 0.0,
        "road_profiles": np.zeros((1, 201)), "road_step": 0.05, "road_behind": 5.0, "speed": 20.0,
        "current": 0.0, "current_limit": 5.0, "body_acceleration": 0.0, "suspension_travel": 0.0,
        "tyre_load": 0.0, "static_tyre_load": 3826.0, "device_travel_limit": LIMIT,
        "cost": 0.9, "label": "MPC",
    }  # fmt: skip
    given = {**base, **changes}
    corner = {
        name: given.pop(name)
        for name in CornerSnapshot.__dataclass_fields__
        if name in given
    }
    return CarSnapshot(
        heave=corner["body"], corners=(CornerSnapshot(**corner),), **given
    )


def passive(**changes):
    nothing = {
        "piston": None,
        "joint": None,
        "current_limit": None,
        "device_travel_limit": None,
    }
    return snapshot(**{**nothing, "label": "passive", **changes})


frame = partial(picture_checks.frame, width=640, height=400)


def where(picture, colour, tolerance=6):
    """Rows and columns of the pixels of (nearly) this colour."""
    rows, columns = np.nonzero(picture_checks.near(picture, colour, tolerance))
    return rows, columns


def scene(picture):
    """The part of a single car's 640x400 picture that is not the panel."""
    return picture[:, :371]


def body_top(picture):
    return int(where(picture, rendering.BLUE)[0].min())


def test_the_body_moves_up_by_the_stated_factor():
    rise = 0.015
    still, risen = frame(snapshot()), frame(snapshot(body=rise, piston=rise))
    moved = body_top(scene(still)) - body_top(scene(risen))
    assert moved == pytest.approx(rise * PIXELS_PER_METRE, abs=1.0)


def arrows(picture, colour):
    """Widths of the thrust arrows, row by row from the uppermost, beside the main cylinder."""
    column = scene(picture)[:, WHEEL - 36 : WHEEL - 14]
    rows, _ = where(column, colour)
    return [int((rows == row).sum()) for row in np.unique(rows)]


def test_thrust_arrows_show_direction_and_size():
    """Positive current is tension (F1 of equation 6): it pulls the terminals together, heads face to face."""
    pull = arrows(frame(snapshot(current=5.0)), rendering.PULL)
    push = arrows(frame(snapshot(current=-5.0)), rendering.PUSH)
    weak = arrows(frame(snapshot(current=1.0)), rendering.PULL)
    assert arrows(frame(snapshot(current=-5.0)), rendering.PULL) == []
    assert arrows(frame(snapshot(current=0.0)), rendering.PULL) == []
    assert len(weak) < 0.6 * len(pull)
    half = len(pull) // 2
    # The head is the widest part of an arrow; in the upper one it is below the shaft when the motor pulls.
    assert int(np.argmax(pull[:half])) > half / 2
    assert int(np.argmax(push[: len(push) // 2])) < len(push) / 4


def test_the_words_state_the_scales(monkeypatch):
    said = picture_checks.listen(monkeypatch)
    frame(snapshot(suspension_travel=0.029, body_acceleration=-2.9))
    assert {"−2", "+2", "−20", "+20", "10 mm, vertical ×10"} <= set(said)
    said.clear()
    frame(
        snapshot(
            suspension_travel=0.031, body_acceleration=-3.1, body=0.05, piston=0.05
        )
    )
    assert {"−4", "+4", "−40", "+40"} <= set(said)
    assert [words for words in said if "vertical" in words] == ["50 mm, vertical ×3"]


@pytest.mark.parametrize("size", [(640, 400), (960, 600), (1280, 500), (700, 800)])
@pytest.mark.parametrize("cars", [1, 2])
def test_words_never_touch_nor_leave_the_picture(size, cars, monkeypatch):
    long = "friction-aware MPC, horizon 20, with road preview"
    poses = [
        snapshot(label=long, time=999.99, cost=12.345, current=-4.44, body_acceleration=-12.0),
        snapshot(label=long, time=999.99, joint=LIMIT, wheel=-0.015, tyre_load=-12345.0, cost=0.1),
        snapshot(time=999.99, joint=-LIMIT, wheel=0.012, current=5.0, body_acceleration=28.0, speed=100.0),
        snapshot(piston=None), passive(cost=804.86, suspension_travel=-0.5),
    ]  # fmt: skip
    picture_checks.check_words(poses, cars, size, monkeypatch)


@pytest.mark.skipif(
    not sys.platform.startswith("linux"),
    reason="a display is told by the environment on Linux",
)
def test_without_a_display_the_answer_is_one_line(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    refused("no display; use render_mode='rgb_array'", Renderer, "human")
    monkeypatch.setenv("DISPLAY", ":987")  # set, and nothing behind it
    for asked in ("", "x11"):
        monkeypatch.setenv("SDL_VIDEODRIVER", asked)
        for open_it in (lambda: Renderer("human"), rendering.check_display):
            refused("cannot open a window", open_it)
            assert (
                os.environ["SDL_VIDEODRIVER"] == asked
                if asked
                else not os.environ.get("SDL_VIDEODRIVER")
            )


def test_the_window_keeps_pace_and_can_be_shut(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    painted = []
    paint = Renderer._paint

    def count(renderer, shots):
        painted.append(shots[0].time)
        paint(renderer, shots)

    monkeypatch.setattr(Renderer, "_paint", count)
    renderer = Renderer("human", width=640, height=400, fps=50)
    for k in range(25):
        assert renderer.draw(snapshot(time=0.005 * k)) is None
    assert painted == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12])
    assert not renderer.closed
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    renderer.draw(snapshot(time=0.2))
    assert renderer.closed
    assert renderer.draw(snapshot(time=0.3)) is None
    assert len(painted) == 8
    renderer.close()


def film(count=5, height=64, width=96):
    frames = [np.full((height, width, 3), 230, np.uint8) for _ in range(count)]
    for k, picture in enumerate(frames):
        picture[:, 10 * k : 10 * k + 10] = rendering.VERMILLION
    return frames


def test_an_mp4_holds_the_frames(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "car.mp4"
    frames = film(6)
    write_video(path, iter(frames), 25)
    back = picture_checks.read_mp4(path, (96, 64))
    assert back.shape == (6, 64, 96, 3)
    assert np.abs(back - frames).mean() < 10
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_that_fails_leaves_what_was_there(tmp_path):
    def breaks():
        yield from film(3)
        raise KeyboardInterrupt

    path = tmp_path / "car.mp4"
    path.write_text("older")
    with pytest.raises(KeyboardInterrupt):
        write_video(path, breaks(), 25)
    assert path.read_text() == "older" and list(tmp_path.iterdir()) == [path]


def test_a_film_that_cannot_be_is_refused_in_one_line(tmp_path, monkeypatch):
    frames = film(2)
    for name, words in (
        ("car.avi", "end the name in .mp4"),
        ("no/car.mp4", "no folder"),
    ):
        refused(words, write_video, tmp_path / name, frames, 25)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError) as caught:
        write_video(tmp_path / "car.mp4", frames, 25)
    assert (
        str(caught.value)
        == f"writing an MP4 needs imageio-ffmpeg: {how_to_install('render')}"
    )
    assert list(tmp_path.iterdir()) == []
