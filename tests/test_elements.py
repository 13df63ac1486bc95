"""The laws of the elements against formulas of their own, and what each class says of itself."""

import string
from dataclasses import replace

import numpy as np
import pytest
from builders import cart, channel, damper, element, network
from program import refused

from isd_gym import ISDSuspensionEnv, Network, Table, linearise, simulate
from isd_gym.diagnosis import Hypothesis
from isd_gym.diagnosis._estimation.structure import add, base_structure, free_of
from isd_gym.diagnosis._planning.excitation import infer_rig
from isd_gym.diagnosis._records.reading import read_record
from isd_gym.physics import elements as el
from isd_gym.physics.fmu import Running
from isd_gym.physics.simulate import effective_current


def library():
    return {
        k: cls
        for k, cls in el.TYPES.items()
        if cls.__module__.startswith("isd_gym.physics.elements")
    }


def test_every_class_of_the_library_tells_kind_source_units_and_a_test_that_could_refute_it():
    places = {"sensor": "channel", "drive": "element"}
    for kind, cls in library().items():
        assert "mechanism" in vars(cls), kind  # declared, not inherited
        assert cls.place == places.get(cls.mechanism, "between") or kind == "motor", (
            kind
        )
        assert cls.equation and cls.source and cls.signature, kind
        parameters = {f.name: f.metadata for f in el.parameter_fields(cls)}
        for name, about in parameters.items():
            assert about["range"][0] < about["range"][1] and about["unit"], (kind, name)
        assert bool(cls.test) == (kind != "motor")
        assert {
            field for _, field, _, _ in string.Formatter().parse(cls.test) if field
        } <= set(parameters), kind
    assert {cls.mechanism for cls in library().values()} == set(el.MECHANISMS)


def test_a_kind_that_is_none_of_the_list_is_refused():
    class Odd(el.Element):
        type = "test_odd"
        mechanism = "magic"

    refused("mechanism must be one of dry_friction, viscous", el.register, Odd)
    assert "test_odd" not in el.TYPES


GUIDE = damper("cart", "ground", 3.0, "guide")
MOTOR = cart(
    element("drive", "motor", "cart", "ground", thrust_constant=5.0),
    GUIDE,
    inputs=[channel("current", "current", element="drive")],
    outputs=["speed velocity cart", channel("thrust", "force", element="drive")],
    uncertainty={"cart.mass": 0.05, "guide.damping": 0.3},
)


def with_effects(*effects):
    model = {**MOTOR, "elements": [*MOTOR["elements"]]}
    model["elements"] += [{"name": f"x{k}", **e} for k, e in enumerate(effects)]
    return Network.load(model)


COMMAND = np.array([0.0, 0.3, -0.3, 1.0, -1.0, 2.5, -2.5, 0.0])


def test_a_thrust_may_be_the_square_of_the_current():
    square = {
        "type": "quadratic_thrust",
        "element": "drive",
        "reference": 2.0,
        "form": "square",
    }
    assert effective_current(
        with_effects(square), "drive", COMMAND, 0.01
    ) == pytest.approx(COMMAND**2 / 2.0)


def test_a_drives_effects_act_in_the_order_of_the_signal_whatever_the_order_in_the_file():
    zone = {"type": "drive_dead_zone", "element": "drive", "threshold": 0.5}
    square = {"type": "quadratic_thrust", "element": "drive", "reference": 2.0}
    iron = {"type": "thrust_saturation", "element": "drive", "current": 1.5}
    column = COMMAND[:, None]
    one = effective_current(with_effects(zone, square, iron), "drive", column, 0.01)
    two = effective_current(with_effects(iron, square, zone), "drive", column, 0.01)
    left = np.sign(column) * np.maximum(np.abs(column) - 0.5, 0.0)
    assert one == pytest.approx(1.5 * np.tanh(left * np.abs(left) / 2.0 / 1.5))
    assert np.array_equal(one, two)


def test_a_drive_effect_of_a_users_own_acts_too():
    class Halved(el.Element):
        type = "test_halved"
        place = "element"

        def apply(self, signal, step):
            return 0.5 * signal

    el.register(Halved)
    try:
        net = with_effects({"type": "test_halved", "element": "drive"})
        assert np.array_equal(
            effective_current(net, "drive", COMMAND, 0.01), 0.5 * COMMAND
        )
    finally:
        el.TYPES.pop("test_halved")


def test_a_sensor_may_be_late_or_lead():
    time = np.arange(2000) * 1e-3
    signal = np.sin(7 * time)
    for delay in (0.0123, -0.0123, 0.02, -0.02):
        seen = el.SensorDelay("x", ("y",), delay=delay).apply(signal, 1e-3)
        inside = (time > 0.03) & (time < time[-1] - 0.03)
        # straight lines between samples: their error is below step^2 w^2 / 8
        assert np.abs(seen - np.sin(7 * (time - delay)))[inside].max() < 7e-6
    # past the last sample the signal goes on with its slope: its error is of second order in the lead
    assert np.abs(seen - np.sin(7 * (time + 0.02))).max() < 49 * 0.02**2
    for delay in (-0.3, -9.0):
        short = el.SensorDelay("x", ("y",), delay=delay).apply(signal[:5], 0.1)
        assert short.shape == (5,) and np.isfinite(short).all()


@pytest.mark.parametrize(
    ("effect", "where", "values", "limits"),
    [
        ("sensor_delay", "speed", {"delay": 26.0}, (-0.3, 0.3)),
        ("sensor_gain", "speed", {"gain": 40.0}, (0.2, 5.0)),
        ("actuator_delay", "drive", {"delay": 26.0}, (0.0, 0.3)),
        ("actuator_lag", "drive", {"time_constant": 26.0}, (0.0, 0.5)),
        ("thrust_saturation", "drive", {"current": 2.0}, (0.1, 40.0)),
    ],
)
def test_faults_stay_within_what_is_plausible(effect, where, values, limits):
    built = add(base_structure(with_effects()), Hypothesis(effect, (where,)), values)
    (free,) = [f for f in built.free if f.owner >= 0]
    low, high = (free.back(x) for x in (free.low, free.high))
    assert (low, high) == pytest.approx(limits, rel=1e-9, abs=1e-4)
    # a start beyond the range is moved into it
    assert free.low <= built.start[-1] <= free.high
    # a model file may hold any value
    key = "channel" if effect.startswith("sensor") else "element"
    assert with_effects({"type": effect, key: where, **values})


def test_a_search_proposes_no_value_that_the_element_refuses():
    law = el.TYPES["stribeck_friction"](
        "x", ("a", "b"), level=2.0, static_level=3.0, stribeck_velocity=1e5
    )
    for free in free_of(law, 0):
        replace(law, **{free.path.partition(".")[2]: free.back(free.high)})


def setting(where, samples, **options):
    return el.Setting(
        with_effects(), where, None, 1.0, float(np.std(samples)), 0.05, options, samples
    )


def test_drive_laws_are_not_tried_where_every_command_has_one_size():
    bang = np.sign(np.sin(np.arange(500) * 0.1)) * 1.5
    rich = 1.5 * np.sin(np.arange(500) * 0.1)

    def squares(command, form):
        return el.QuadraticThrust.starts(setting(("drive",), command, form=form))

    assert not el.DriveDeadZone.starts(setting(("drive",), bang))
    assert el.DriveDeadZone.starts(setting(("drive",), rich))
    assert squares(rich, "signed") and not squares(bang, "signed")
    # a command of one sign cannot tell the square from the signed square
    assert squares(np.abs(rich), "signed") and not squares(np.abs(rich), "square")
    # the start is the square that comes nearest to proportion
    (_, start, _) = squares(rich, "signed")
    grid = np.linspace(0.5, 3, 400)
    errors = [np.sum((rich * np.abs(rich) / r - rich) ** 2) for r in grid]
    nearest = grid[int(np.argmin(errors))]
    assert start.values["reference"] == pytest.approx(nearest, abs=0.01)


def test_sensor_laws_are_tried_where_the_samples_show_their_trace():
    rng = np.random.default_rng(3)
    wave = np.sin(np.arange(4000) * 0.02)
    noise = 0.003 * rng.normal(size=4000)
    assert not el.SensorMagnitude.starts(setting(("speed",), wave + noise))
    assert el.SensorMagnitude.starts(setting(("speed",), np.abs(wave) + noise))
    random = np.convolve(rng.normal(size=4000), np.ones(30) / 30, "same")
    for whole in (wave + noise, random, np.abs(wave) + noise):
        assert not el.SensorDeadZone.starts(setting(("speed",), whole))
    resting = np.sign(wave) * np.maximum(np.abs(wave) - 0.1, 0.0)
    assert el.SensorDeadZone.starts(setting(("speed",), resting + noise))


def test_laws_of_a_sensor_need_a_zero_that_is_known():
    net = with_effects()
    assert el.SensorMagnitude.stands(net, ("speed",)) and el.SensorDeadZone.stands(
        net, ("speed",)
    )
    outputs = [{**MOTOR["outputs"][0], "offset": "free"}]
    free = Network.load({**MOTOR, "outputs": outputs})
    assert not el.SensorMagnitude.stands(
        free, ("speed",)
    ) and not el.SensorDeadZone.stands(free, ("speed",))


def cogging(**values):
    return el.CoggingForce("x", ("a", "b"), amplitude=2.0, **values)


def test_cogging_of_a_turn_has_a_whole_number_of_periods():
    angle = np.linspace(-9.0, 9.0, 50)
    near = 2 * np.pi / 14.2
    # a pitch of more than a turn is a turn
    for pitch, turn, count in ((near, "whole", 14), (near, "any", 14.2), (50.0, "whole", 1)):  # fmt: skip
        seen = cogging(pitch=pitch, phase=0.3, turn=turn).curve(angle)
        assert seen == pytest.approx(2.0 * np.sin(count * angle + 0.3))
    turning = Hypothesis("cogging_force", ("cart", "ground"), (("turn", "whole"),))
    values = {"amplitude": 1.0, "pitch": 0.5, "phase": 0.0}
    built = add(base_structure(with_effects()), turning, values)
    (pitch,) = (f for f in built.free if f.path == "cogging_force.pitch")
    assert pitch.low == pitch.mean == pitch.high == np.log(0.5)  # reported, not moved


def test_whole_turns_are_tried_where_the_nodes_turn():
    bearing = damper("arm", "ground", 3.0)
    arm = network(
        "arm", [bearing], [], ["speed angular_velocity arm"], inertias={"arm": 0.1}
    )
    assert el.CoggingForce.variants(arm, ("arm", "ground")) == [
        {"turn": "any"},
        {"turn": "whole"},
    ]
    assert el.CoggingForce.variants(with_effects(), ("cart", "ground")) == [
        {"turn": "any"}
    ]


def test_a_degressive_damper_takes_the_place_of_the_linear_one():
    net, place = with_effects(), ("cart", "ground")
    guess = Network.load({**MOTOR, "uncertainty": {"guide.damping": 1.0}})
    assert el.DegressiveDamping.stands(net, place)
    assert not el.DegressiveDamping.stands(net.without_element("guide"), place)
    assert not el.DegressiveDamping.stands(guess, place)
    v = 0.4 * np.sin(np.arange(2000) * 0.01)
    at = el.Setting(net, place, el.Motion(v, v, v), 1.0)
    for start in el.DegressiveDamping.starts(at):
        law = el.DegressiveDamping("x", place, **start.values)
        # force of the replaced damper
        assert el.rms(law.curve(v)) == pytest.approx(3.0 * el.rms(v))
        level = law.curve(np.array([el.rms(v)]))[0]
        for kind, name, factor in (("linear_damping", "damping", el.rms(v)), ("coulomb_friction", "level", 1.0)):  # fmt: skip
            special = el.DegressiveDamping.special(kind, start.values, at.motion)
            assert special[name] * factor == pytest.approx(level)
    built = add(base_structure(net), Hypothesis("degressive_damping", place), start.values)  # fmt: skip
    # a knee far below the typical rate would be dry friction with round corners
    (knee,) = (f for f in built.free if f.path == "degressive_damping.knee")
    limits = [knee.back(knee.low), knee.back(knee.high)]
    assert limits == pytest.approx([el.rms(v), 9 * el.rms(v)])
    assert "guide" not in {e.name for e in built.network.elements}
    # the only element of a rig may be replaced, too, and a force cell then reads what stands there
    parts, place = [damper("rod", "ground", 3.0, "guide")], ("rod", "ground")
    force, known = channel("force", "force", element="guide"), {"guide.damping": 0.1}
    alone = network("", parts, ["stroke displacement rod"], [force], uncertainty=known)
    built = add(base_structure(alone), Hypothesis("degressive_damping", place), start.values)  # fmt: skip
    assert [e.name for e in built.network.elements] == ["degressive_damping"]
    assert built.network.outputs[0].elements == ("degressive_damping",)


OIL = channel("oil", "temperature", unit="degC")


def logged(*effects, inputs=(OIL,)):
    more = (
        {"name": f"x{k}", "between": ["cart", "ground"], **e}
        for k, e in enumerate(effects)
    )
    return cart(
        GUIDE,
        *more,
        inputs=["push force cart", *inputs],
        uncertainty={"guide.damping": 0.3},
    )


THINS = {
    "type": "scheduled_damping",
    "channel": "oil",
    "slope": -0.05,
    "reference": 20.0,
}
UNTOLD = {k: v for k, v in THINS.items() if k != "channel"}


def test_a_logged_channel_beside_a_current_and_a_record_without_it_is_the_same_to_the_last_bit():
    time = np.arange(0, 2, 2e-3)
    given = {"current": np.sin(5 * time)}
    plain = simulate(MOTOR, time, given)
    motor, guide = MOTOR["elements"]
    damped = {**MOTOR, "elements": [motor, {**guide, "damping": 3.0 + 0.05 * 20.0}]}
    exact = simulate(damped, time, given)["speed"]
    thins = {"name": "thins", "between": ["cart", "ground"], **THINS}
    # before and after the current in the list of inputs
    for inputs in ([*MOTOR["inputs"], OIL], [OIL, *MOTOR["inputs"]]):
        model = {**MOTOR, "inputs": inputs}
        seen = simulate(model, time, given | {"oil": 20.0 + time})
        assert all(np.array_equal(seen[n], plain[n]) for n in plain)
        model["elements"] = [motor, guide, thins]
        cold = simulate(model, time, given | {"oil": 0.0 * time})["speed"]
        assert np.abs(cold - exact).max() < 1e-4 * np.abs(cold).max()


def test_the_linear_model_has_the_damping_at_the_reference():
    space = linearise(logged(THINS))
    assert space.inputs == ("push", "oil")
    # the speed per newton at 0.5 Hz is that of the mass and the damper of 3 N s/m; the temperature alone moves nothing
    answer = space.response(np.array([0.5]))[0, 0]
    assert (
        answer[0] == pytest.approx(1 / (2j * np.pi * 0.5 * 2.0 + 3.0))
        and answer[1] == 0
    )


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (
            logged({**THINS, "channel": "oi"}),
            r"'x0': \"channel\" must name an input that acts on no node \(oil\)",
        ),
        (logged(UNTOLD), "must name an input that acts on no node"),
        (logged(THINS, inputs=()), "there is none\\); add one, such as"),
        (
            logged({**THINS, "channel": "push"}),
            "must name an input that acts on no node",
        ),
        (logged(inputs=[OIL | {"at": "cart"}]), "'oil': a temperature acts on no node"),
        (logged(inputs=[OIL | {"unit": "bar"}]), "unit 'bar' cannot be converted"),
        (
            {**logged(), "outputs": [OIL | {"name": "t", "at": "cart"}]},
            "a temperature cannot be an output",
        ),
    ],
)
def test_bad_use_of_a_logged_channel_is_one_line(model, says):
    refused(says, Network.load, model)


def test_a_channel_that_was_not_logged_is_one_line_that_says_what_helps():
    time = np.arange(0, 10, 0.01)
    table = Table(time, {"push": np.sin(time), "speed": np.cos(time)}, "run.csv")
    refused(
        r"oil.*leave the input and the elements that read it out",
        read_record,
        table,
        Network.load(logged(THINS)),
        [],
    )


CAR = Network.load("quarter-car-isd")
EARLY = {"name": "early", "type": "sensor_delay", "delay": -0.01}
ZONE = {"name": "zone", "type": "drive_dead_zone", "element": "motor", "threshold": 0.5}


@pytest.mark.parametrize(
    ("words", "use", "model"),
    [
        ("'zone': the environment's drive has no drive_dead_zone", ISDSuspensionEnv, CAR.with_element(ZONE)),
        ("'early': no sensor of an environment can lead", ISDSuspensionEnv, CAR.with_element({**EARLY, "channel": CAR.outputs[0].name})),
        ("'early': no sensor of a running model can lead", Running, with_effects().with_element({**EARLY, "channel": "speed"})),
        ("the environment has no logged channels", ISDSuspensionEnv, replace(CAR, inputs=(*CAR.inputs, Network.load(logged()).inputs[1]))),
    ],
)  # fmt: skip
def test_who_cannot_do_what_a_model_asks_says_so_in_a_line(words, use, model):
    refused(words, use, model)


def test_laws_of_a_logged_channel_are_tried_where_it_changes():
    net = Network.load(logged())
    assert infer_rig(net, []) is None
    assert el.ScheduledDamping.variants(net, ("cart", "ground")) == [{"channel": "oil"}]
    assert el.ScheduledDamping.variants(with_effects(), ("cart", "ground")) == []
    v = np.sin(np.arange(3000) * 0.01)
    motion = el.Motion(v, v, v)

    def starts(kind, samples):
        at = el.Setting(
            net,
            ("cart", "ground"),
            motion,
            10.0,
            options={"channel": "oil"},
            samples=samples,
        )
        return kind.starts(at)

    warming = 20.0 + 0.01 * np.arange(3000)
    for kind in (el.ScheduledDamping, el.ScheduledFriction):
        assert not starts(kind, np.full(3000, 40.0))
        assert starts(kind, warming)
    (start,) = starts(el.ScheduledDamping, warming)
    force = start.values["slope"] * (warming - start.values["reference"]) * v
    assert el.rms(force) == pytest.approx(el.PROBE * 10.0)
    warms = Hypothesis("scheduled_damping", ("cart", "ground"), (("channel", "oil"),))
    built = add(base_structure(net), warms, start.values)
    assert [f.path for f in built.free if f.owner >= 0] == ["scheduled_damping.slope"]
