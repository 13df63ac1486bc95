"""Pictures of half and full cars: the body tilts by its angles, wheels stand on the road, words are legible."""

import re
from functools import partial

import numpy as np
import picture_checks
import pytest
from program import printed, refused

from isd_gym import ISDSuspensionEnv, ISDSuspensionVectorEnv
from isd_gym.view import rendering
from isd_gym.view.rendering import CarSnapshot, CornerSnapshot, renderer
from isd_gym.view.rendering.car import CarScene
from isd_gym.view.rendering.wheel import RUBBER

NETWORKS = {"ISDHalfCar-v0": "half-car-isd", "ISDFullCar-v0": "full-car-isd"}
both = pytest.mark.parametrize("name", NETWORKS)
PLACES = {"front_left": (1.35, 0.76), "front_right": (1.35, -0.76), "rear_left": (-1.35, 0.76), "rear_right": (-1.35, -0.76)}  # fmt: skip
HALF = {"front": (1.2, 0.0), "rear": (-1.5, 0.0)}
#: a lorry with three axles, the rear pair close together
LORRY = {f"{axle}_{side}": (x, y) for axle, x in (("front", 3.0), ("middle", -1.0), ("rear", -2.4)) for side, y in (("left", 1.0), ("right", -1.0))}  # fmt: skip
LIMIT = 0.02465


def corner(name, x, y, body=0.0, **changes):
    base = {
        "name": name, "x": x, "y": y, "body": body, "wheel": 0.0, "piston": body, "joint": 0.0, "current_limit": 5.0,
        "tyre_load": 0.0, "static_tyre_load": 3800.0, "device_travel_limit": LIMIT,
    }  # fmt: skip
    return CornerSnapshot(**{**base, **changes})


def car(places=HALF, /, **changes):
    """A car on an even road, tilted by `pitch` and `roll`."""
    pitch, roll = changes.get("pitch", 0.0), changes.get("roll", 0.0)
    tracks = len({y for _, y in places.values()})
    each = changes.pop("each", {})
    base = {
        "time": 0.0, "heave": 0.0, "pitch": 0.0, "points": {"driver": (0.1, 0.3)},
        "corners": tuple(corner(n, x, y, -x * pitch + y * roll, **each) for n, (x, y) in places.items()),
        "road_profiles": np.zeros((tracks, 301)), "road_step": 0.05, "road_behind": 8.0, "speed": 20.0,
        "body_acceleration": 0.0, "pitch_acceleration": 0.0, "cost": 0.9, "label": "MPC",
    }  # fmt: skip
    if tracks == 2:
        base |= {"roll": 0.0, "roll_acceleration": 0.0}
    return CarSnapshot(**{**base, **changes})


frame = partial(picture_checks.frame, width=960, height=600)


@pytest.fixture
def scenes(monkeypatch):
    made = []

    class Kept(CarScene):
        def __init__(self, *given):
            super().__init__(*given)
            made.append(self)

    monkeypatch.setattr(renderer, "CarScene", Kept)
    return made


@pytest.fixture
def said(monkeypatch):
    return picture_checks.listen(monkeypatch)


def factor(said):
    return float(
        next(
            m[1]
            for words in reversed(said)
            if (m := re.search(r"vertical ×([\d.]+)", words))
        )
    )


def slope(picture, columns):
    """Slope of the body's lower edge [px/px], downwards to the right."""
    blue = picture_checks.near(picture, rendering.BLUE, 30)[:, columns]
    rows = np.array(
        [np.flatnonzero(column).max() if column.any() else -1 for column in blue.T]
    )
    x = np.flatnonzero(rows >= 0)[8:-8]
    return float(np.polyfit(x, rows[x], 1)[0])


def test_the_name_of_a_policy_is_whole(said):
    frame(car(PLACES, label="mpc-wheelbase"))
    assert "mpc-wheel…" not in said


@pytest.mark.parametrize("pitch", [-0.012, 0.0, 0.004, 0.012])
@pytest.mark.parametrize("places", [HALF, PLACES])
def test_the_body_slopes_by_the_stated_factor_times_its_pitch(
    places, pitch, said, scenes
):
    """Nose down is positive, and the nose is at the right."""
    picture = frame(car(places, pitch=pitch))
    side = scenes[0].views[0].window
    found = slope(picture[:400], slice(round(side.left), round(side.right)))
    assert found == pytest.approx(factor(said) * pitch, abs=0.004)


@both
@pytest.mark.parametrize("road", ["E", "pothole", "bump"])
def test_wheels_stand_on_the_road(name, road, scenes):
    """Between hub and ground there is no sky, unless the tyre carries nothing."""
    env = ISDSuspensionEnv(NETWORKS[name], road=road, render_mode="rgb_array")
    env.reset(seed=1)
    checked = 0
    for k in range(260):
        env.step(np.zeros(env.action_space.shape, np.float32))
        if k % 10 or (road != "E" and k < 190):
            continue
        picture = env.render()
        assert picture is not None
        scene = scenes[-1]
        for view in scene.views:
            for each in view.near:
                x, top, foot = view.place(each), scene._hub(each), scene.floor - 1
                foot -= (scene.contacts[each] - scene.lift) * scene.scale
                column = picture[
                    round(top) + 4 : round(foot) + 4,
                    round(x) + (0 if view.is_rear else 2),
                ]
                sky = (column.astype(int).min(axis=1) > 241).sum()
                assert (sky == 0) or each.has_lifted, (view.is_rear, each)
                checked += not each.has_lifted
    assert checked > 10


@both
def test_a_snapshot_is_the_state_of_the_car(name):
    """Travels of the corners are those that are measured, and the road under each wheel is the one that it drives on."""
    env = ISDSuspensionEnv(NETWORKS[name], road="bump", render_mode="rgb_array")
    env.reset(seed=0)
    names = [signal.name for signal in env.task.measured]
    highest = np.zeros(len(env.task.vehicle.corners))
    for _ in range(280):
        obs, *_ = env.step(np.full(env.action_space.shape, 2.0, np.float32))
        shot = env.snapshot()
        assert isinstance(shot, CarSnapshot)
        heights = env.task.batch.road_heights[:, 0]
        highest = np.maximum(highest, heights)
        for each, height in zip(shot.corners, heights, strict=True):
            travel = obs[names.index(f"suspension_travel_{each.name}")]
            assert each.body - each.wheel == pytest.approx(travel, abs=1e-6)
            assert each.body == pytest.approx(shot.height(each.x, each.y), abs=1e-12)
            device = obs[names.index(f"device_travel_{each.name}")]
            assert each.device_travel == pytest.approx(device, abs=1e-6)
            assert each.current == obs[names.index(f"current_{each.name}")]
            profile = shot.road_profiles[int(each.y < 0)]
            place = shot.road_behind + each.x - 1.35
            under = np.interp(place, np.arange(profile.size) * shot.road_step, profile)
            # of a 50 mm bump between points that are 100 mm apart
            assert under == pytest.approx(height, abs=1e-3)
    assert highest == pytest.approx(0.05, abs=1e-3)


def test_the_views_follow_from_the_corners(scenes):
    """An axle alone is seen from behind, three axles from both sides, and a body on one wheel from the side."""
    axle = {"left": (0.0, 0.7), "right": (0.0, -0.7)}
    for places, views in (
        (axle, [True]),
        (LORRY, [False, True]),
        ({"": (0.0, 0.0)}, [False]),
    ):
        scenes.clear()
        picture = frame(car(places, pitch=0.0))
        assert [view.is_rear for view in scenes[0].views] == views
        assert picture_checks.near(picture, RUBBER).sum() > 300
    assert (
        len(near_corners := scenes[0].views[0].near) == 1 and near_corners[0].x == 0.0
    )


@pytest.mark.parametrize("network", ["quarter-car-isd", *NETWORKS.values()])
def test_the_vector_environment_draws_the_single_one_of_each_seed(network):
    many = ISDSuspensionVectorEnv(
        2, network, road="C", render_mode="rgb_array", max_episode_steps=20
    )
    single = ISDSuspensionEnv(network, road="C", render_mode="rgb_array")
    many.reset(seed=4)
    single.reset(seed=5)
    for k in range(15):
        action = np.full(single.action_space.shape, np.sin(k), np.float32)
        many.step(np.stack([action, action]))
        single.step(action)
    pictures = many.render()
    assert pictures is not None and len(pictures) == 2
    assert np.array_equal(pictures[1], single.render())
    assert not np.array_equal(pictures[0], pictures[1])
    for _ in range(6):  # a new episode begins with an empty trail
        many.step(np.zeros((2, *single.action_space.shape), np.float32))
    assert many._onlookers[0].snapshot().road_behind == 0.0
    many.close()


def test_a_snapshot_without_a_picture_is_refused_in_one_line():
    env = ISDSuspensionEnv("half-car-isd")
    env.reset(seed=0)
    refused("render_mode='rgb_array'", env.snapshot)


@pytest.mark.parametrize(
    ("places", "cars", "size"),
    [
        (HALF, 1, (640, 400)), (HALF, 1, (960, 600)), (HALF, 1, (700, 800)), (HALF, 2, (1200, 640)),
        (PLACES, 1, (640, 400)), (PLACES, 1, (960, 600)), (PLACES, 1, (1280, 500)), (PLACES, 2, (1400, 600)),
        (LORRY, 1, (960, 600)),
    ],
)  # fmt: skip
def test_words_never_touch_nor_leave_the_picture(places, cars, size, monkeypatch):
    long = "friction-aware MPC, horizon 20, with road preview"
    heavy = {"tyre_load": -12345.0, "current": -4.44, "joint": LIMIT}
    poses = [
        car(
            places,
            label=long,
            time=999.99,
            cost=12.345,
            body_acceleration=-12.0,
            pitch_acceleration=28.0,
        ),
        car(places, pitch=0.02, each=heavy),
        car(
            places,
            pitch=-0.02,
            each={"current": 5.0, "joint": -LIMIT},
            cost=804.86,
            speed=100.0,
        ),
        car(
            places,
            each={
                "piston": None,
                "joint": None,
                "current_limit": None,
                "device_travel_limit": None,
            },
        ),
        car(
            places,
            heave=0.3,
            points={
                "driver": (0.1, 0.3),
                "passenger": (0.1, -0.3),
                "far_away": (9.0, 4.0),
            },
        ),
    ]
    picture_checks.check_words(poses, cars, size, monkeypatch)


def test_a_bad_snapshot_names_its_field():
    for make, words in (
        (lambda: car(PLACES, heave=np.nan), "heave is nan"),
        (
            lambda: corner("front", 1.0, 0.0, wheel=np.inf),
            "corner 'front': wheel is inf",
        ),
    ):
        refused(words, make)


@pytest.mark.parametrize(
    ("network", "size"), [("half-car-isd", (1200, 640)), ("full-car-isd", (1400, 600))]
)
def test_show_films_cars(tmp_path, network, size):
    pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "film.mp4"
    words = f"show skyhook --against passive --network {network} --seconds 0.4"
    assert "0.4 s of skyhook and passive" in printed(words, "--out", out)
    film = picture_checks.read_mp4(out, size)
    assert len(film) == 21  # 50 a second, and the first
    assert (np.abs(film[-1] - film[0]) > 30).any(axis=2).mean() > 0.01


@pytest.mark.parametrize(
    "network", ["quarter-car-isd", "half-car-isd", "full-car-passive"]
)
def test_show_plays_cars_in_a_window(network, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    printed("show passive --network", network, "--seconds 0.1")
