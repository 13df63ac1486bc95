"""Changes of the data or of the model's order that say nothing about the rig must not change the verdict of a diagnosis."""

from dataclasses import dataclass, replace
from typing import Any

import builders
import numpy as np
import pytest
from builders import damper, element, spring
from scipy.signal import butter, sosfiltfilt
from threadpoolctl import threadpool_info

from isd_gym import Network, Table, diagnose, simulate
from isd_gym.diagnosis import SearchSettings
from isd_gym.diagnosis._hypotheses import library
from isd_gym.diagnosis._selection import plain_fits

STEP, SAMPLES = 1e-2, 600

#: two masses on a shaken base, as their owner knows them
FOOT = [spring("lower", "base", 4000.0), damper("lower", "base", 20.0)]
MODEL = builders.model(
    "two masses",
    [
        *FOOT,
        spring("upper", "lower", 2500.0, "link"),
        damper("upper", "lower", 8.0, "oil"),
    ],
    ["base displacement base"],
    ["stroke displacement upper lower", "shake acceleration lower"],
    masses={"lower": 1.0, "upper": 2.0},
    uncertainty={"spring.stiffness": 0.1, "oil.damping": 0.3},
)
DRAG = element("drag", "quadratic_damping", "upper", "lower", damping=120.0)


@dataclass(frozen=True)
class Rig:
    """Everything that a diagnosis is given."""

    model: dict[str, Any]
    training: tuple[Table, ...]
    validation: tuple[Table, ...]

    def diagnose(self, jobs=2, **options):
        settings = SearchSettings(jobs=jobs)
        return diagnose(
            self.training,
            self.model,
            validate=self.validation,
            settings=settings,
            **options,
        )

    def with_tables(self, change):
        training, validation = (
            tuple(map(change, side)) for side in (self.training, self.validation)
        )
        return replace(self, training=training, validation=validation)


def measured(hidden):
    """Records of the rig with quadratic damping in it, or without, and noise of one per cent."""
    rng = np.random.default_rng(5)
    true = Network.load(
        {**MODEL, "elements": [*MODEL["elements"], *([DRAG] if hidden else [])]}
    )
    band = butter(2, [0.5, 15.0], "band", fs=1 / STEP, output="sos")

    def table(name):
        base = 0.004 * sosfiltfilt(band, rng.standard_normal(SAMPLES))
        out = simulate(true, STEP * np.arange(SAMPLES), {"base": base})
        noisy = {
            k: y + 0.01 * np.std(y) * rng.standard_normal(SAMPLES)
            for k, y in out.items()
        }
        return Table(STEP * np.arange(SAMPLES), {"base": base, **noisy}, name)

    return Rig(MODEL, (table("first"), table("second")), (table("third"),))


def scaled(table, factors):
    columns = {k: v * factors.get(k, 1.0) for k, v in table.columns.items()}
    return Table(table.time, columns, table.source, table.units)


def records_in_another_order(rig):
    return replace(rig, training=rig.training[::-1])


def channels_in_another_order(rig):
    return replace(rig, model={**rig.model, "outputs": rig.model["outputs"][::-1]})


def elements_in_another_order(rig):
    return replace(rig, model={**rig.model, "elements": rig.model["elements"][::-1]})


def millimetres(rig):
    outputs = [{**rig.model["outputs"][0], "unit": "mm"}, rig.model["outputs"][1]]

    def in_millimetres(t):
        return Table(
            t.time, scaled(t, {"stroke": 1e3}).columns, t.source, units={"stroke": "mm"}
        )

    return replace(rig, model={**rig.model, "outputs": outputs}).with_tables(
        in_millimetres
    )


def mirrored(rig):
    return rig.with_tables(lambda t: scaled(t, dict.fromkeys(t.columns, -1.0)))


def first_record_in_halves(rig):
    first, *others = rig.training
    half = len(first) // 2

    def part(name, s):
        return Table(
            first.time[s] - first.time[s][0],
            {k: v[s] for k, v in first.columns.items()},
            name,
        )

    parts = part("first, one", slice(None, half)), part("first, two", slice(half, None))
    return replace(rig, training=(*parts, *others))


def a_millionth_of_noise(rig):
    rng = np.random.default_rng(9)

    def noisy(t):
        columns = {
            k: v + 1e-6 * np.std(v) * rng.standard_normal(len(v))
            for k, v in t.columns.items()
        }
        return Table(t.time, columns, t.source, t.units)

    return rig.with_tables(noisy)


#: changes that say nothing about the rig, several at once since each diagnosis takes half a minute
CHANGES = {
    "order": (
        records_in_another_order,
        channels_in_another_order,
        elements_in_another_order,
    ),
    "units and signs": (millimetres, mirrored),
    "pieces and noise": (first_record_in_halves, a_millionth_of_noise),
}


def changed(rig, what):
    for change in CHANGES[what]:
        rig = change(rig)
    return rig


def stated(d):
    return d.verdict, {(e.effect, frozenset(e.between or ())) for e in d.effects}


NAMED = ("missing_effect", {("quadratic_damping", frozenset({"upper", "lower"}))})


@pytest.mark.slow
@pytest.mark.parametrize("what", CHANGES)
def test_the_name_does_not_depend_on(what):
    d = changed(measured(hidden=True), what).diagnose()
    assert stated(d) == NAMED
    assert d.effects[0].parameters["damping"].value == pytest.approx(
        DRAG["damping"], rel=0.1
    )


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing():
    d = changed(measured(hidden=False), "pieces and noise").diagnose()
    assert d.verdict in ("no_discrepancy", "parameters_only")


@pytest.mark.slow
def test_the_name_does_not_depend_on_the_order_of_hypotheses(monkeypatch):
    forward = library.hypotheses

    def backward(network):
        return iter(list(forward(network))[::-1])

    monkeypatch.setattr(plain_fits, "hypotheses", backward)
    assert stated(measured(hidden=True).diagnose()) == NAMED


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_number_of_threads():
    rig, pools = (
        measured(hidden=True),
        [],
    )  # sums of linear algebra depend on its threads
    one, three = (
        rig.diagnose(n, progress=lambda _: pools.extend(threadpool_info())).to_dict()
        for n in (1, 3)
    )
    assert {pool["num_threads"] for pool in pools if pool["user_api"] == "blas"} == {1}
    kept = one.keys() - {"seconds", "search", "settings"}
    assert {k: one[k] for k in kept} == {k: three[k] for k in kept}
