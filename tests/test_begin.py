"""How a model stands at the first sample: told node by node, or fitted to what was measured from there on."""

import numpy as np
import pytest
from builders import QUARTER_CAR as CAR
from builders import STRUT, drive_quarter_car, friction, spring
from program import assert_one_line, run, save_json

from isd_gym import Network, Table, read_table, simulate
from isd_gym.diagnosis.simulation import initial_state, state_of
from isd_gym.diagnosis.simulation._motions import motions_at
from isd_gym.records.data import write_table
from isd_gym.records.loggers import Recording, Signal

NETWORK = Network.load(CAR)
STEP = 2.5e-3
GROUNDED = [
    *STRUT,
    spring("wheel", "ground", 192000.0, "tyre"),
    friction("body", "wheel", 60.0, "seal"),
]
DECAY = CAR | {
    "elements": GROUNDED,
    "inputs": [],
    "outputs": [CAR["outputs"][0], CAR["outputs"][2]],
}
BODY, WHEEL = (
    {"displacement": 0.04, "velocity": -0.3},
    {"displacement": -0.004, "velocity": 0.1},
)
AT_FIRST = {"body": BODY, "wheel": WHEEL}


@pytest.fixture(scope="module")
def moving():
    time, columns = drive_quarter_car()
    return Table(time[1200:], {k: v[1200:] for k, v in columns.items()}, "drive")


def error(said, table):
    """RMS of what is left over the deviation, the worst channel, in the first two seconds."""
    first = slice(0, round(2 / STEP))
    return max(np.std((said[n] - table[n])[first]) / np.std(table[n]) for n in said)


def test_a_record_that_begins_in_mid_motion_is_followed_from_its_first_sample(moving):
    begun = initial_state(moving, NETWORK)
    rest = error(simulate(NETWORK, moving.time, moving.columns), moving)
    fitted = error(
        simulate(NETWORK, begun.time, begun.inputs, initial=begun.state), moving
    )
    assert rest > 1.0
    assert fitted < 0.03  # the sensors' noise is 2 %


def test_a_free_decay_is_fitted_to_one_sensor():
    """Friction, no input, and the body's accelerometer alone: where nodes stood and how they moved is found."""
    network = Network.load(DECAY)
    time = STEP * np.arange(1200)
    start = state_of(network, AT_FIRST, {}, STEP)
    said = simulate(network, time, {}, initial=start)["body_acceleration"]
    noisy = said + 0.01 * said.std() * np.random.default_rng(0).standard_normal(
        len(said)
    )
    begun = initial_state(Table(time, {"body_acceleration": noisy}, "decay"), network)
    found = motions_at(network, begun.state, {}, STEP)
    for node, motion in AT_FIRST.items():
        for key, size in (("displacement", 0.04), ("velocity", 0.3)):
            assert found[node][key] == pytest.approx(motion[key], abs=0.02 * size)


def test_loggers_with_rates_and_clocks_of_their_own_are_fitted_on_their_grid(moving):
    late = 0.012
    logged = {c.name: c.si for c in NETWORK.outputs if c.name != "wheel_acceleration"}
    signals = {
        n: Signal(moving.time + late, moving[n], si, "box", n)
        for n, si in logged.items()
    }
    signals["road"] = Signal(moving.time, moving["road"], "m", "laser", "road")
    begun = initial_state(Recording("run", signals), NETWORK)
    (lag,) = begun.lags
    assert lag.value == pytest.approx(late, abs=5e-4)
    said = simulate(NETWORK, begun.time, begun.inputs, initial=begun.state)
    truth = {
        n: np.interp(begun.time, moving.time, moving[n])
        for n in ("body_acceleration", "travel")
    }
    assert max(np.std((said[n] - y)[:800]) / np.std(y) for n, y in truth.items()) < 0.04


@pytest.fixture
def files(tmp_path, moving):
    save_json(tmp_path / "car.json", CAR)
    columns = {n: moving[n] for n in ("road", "travel")}
    write_table(tmp_path / "drive.csv", Table(moving.time, columns, "drive"))
    write_table(
        tmp_path / "road.csv", Table(moving.time, {"road": moving["road"]}, "road")
    )
    return tmp_path


def simulated(folder, data, more=""):
    return run("simulate car.json --out out.csv --initial fit", data, more, cwd=folder)


def test_simulate_fits_the_initial_state_when_asked(files, moving):
    done = simulated(files, "drive.csv")
    assert "initial state fitted to travel" in done.stdout + done.stderr
    seen = read_table(files / "out.csv")["travel"]
    assert error({"travel": seen}, moving) < 0.03


@pytest.mark.parametrize(
    ("data", "more", "told"),
    [
        ("road.csv", "", "none of the model's outputs"),
        ("drive.csv", "--initial body=0.1", "leave out the other"),
    ],
)
def test_nothing_to_fit_by_and_two_wishes_are_one_line(files, data, more, told):
    assert_one_line(simulated(files, data, more), told)
    assert not (files / "out.csv").exists()
