"""The answer from a table of sets of laws: how many laws, which law of a kind, which sets stay open."""

from dataclasses import replace

import numpy as np
import pytest

from isd_gym.diagnosis import CRITERIA
from isd_gym.diagnosis._selection.answer import answer_of
from isd_gym.diagnosis._selection.held_out_table import Blocks, Member, Row

PLACE = ("ground", "mass")
COULOMB = Member("coulomb_friction", PLACE, "dry_friction", "between")
STRIBECK = replace(COULOMB, effect="stribeck_friction")
DRAG = replace(COULOMB, effect="quadratic_damping", mechanism="viscous")
CUBIC = replace(COULOMB, effect="cubic_stiffness", mechanism="elastic")
GAIN = Member("sensor_gain", ("position",), "sensor", "channel")
NOISE = np.array([0.002])
LEAST = np.array([0.01])


def row(error, *members, parameters=3, contradiction=""):
    """Return a row with an error on every block of records of a channel with deviation 1."""
    each = error * np.random.default_rng(0).uniform(0.8, 1.2, (20, 1))
    blocks = Blocks(each**2, np.full(20, 100.0))
    errors = np.array([error])
    return Row(
        None, None, members, parameters, errors, errors, errors, blocks, blocks, np.maximum(errors, LEAST), np.ones(1), contradiction
    )  # fmt: skip


def answer(*rows, criteria=CRITERIA):
    return answer_of(rows, LEAST, NOISE, criteria)


#: friction is a member of both sets of the band
SHARED = answer(
    row(0.5),
    row(0.2, COULOMB),
    row(0.050, COULOMB, CUBIC),
    row(0.052, COULOMB, DRAG),
)


def effects(found):
    return [m.effect for row in found.band[:1] for m in row.members]


def test_where_no_law_lowers_the_error_by_the_width_none_is_missing():
    found = answer(row(0.012), row(0.010, COULOMB), row(0.009, GAIN))
    assert not found.band and found.certain == ()


def test_the_simplest_law_of_a_kind_is_the_law_unless_another_leaves_a_small_share():
    found = answer(row(0.145), row(0.017, COULOMB), row(0.012, STRIBECK, parameters=5))
    assert effects(found) == ["coulomb_friction"] and found.certain == (True,)
    found = answer(row(0.145), row(0.06, COULOMB), row(0.005, STRIBECK, parameters=5))
    assert effects(found) == ["stribeck_friction"]


def test_sets_of_other_kinds_within_the_width_leave_the_kind_open():
    found = answer(row(0.3), row(0.060, COULOMB), row(0.062, DRAG), row(0.2, CUBIC))
    assert [[m.effect for m in r.members] for r in found.band] == [
        ["coulomb_friction"],
        ["quadratic_damping"],
    ]
    assert found.certain == (False,)
    assert (
        sum(found.weights) == pytest.approx(1.0) and found.weights[0] > found.weights[1]
    )


def test_a_member_of_every_set_of_the_band_is_certain():
    assert effects(SHARED) == ["coulomb_friction", "cubic_stiffness"]
    assert SHARED.certain == (True, False)


def test_a_rival_with_more_parameters_must_predict_better():
    """A stop with a clearance does what play does; play has one parameter less."""
    found = answer(row(0.3), row(0.05, CUBIC, parameters=4), row(0.05, COULOMB))
    assert effects(found) == ["coulomb_friction"] and found.certain == (True,)


def test_each_of_several_laws_must_remove_its_share():
    """Three laws that together leave half of the power are a curve fit."""
    assert not answer(
        row(0.26), row(0.22, COULOMB), row(0.17, COULOMB, CUBIC, DRAG)
    ).band
    three = answer(row(0.26), row(0.22, COULOMB), row(0.05, COULOMB, CUBIC, DRAG))
    assert len(effects(three)) == 3


def test_a_second_law_must_lower_the_error_by_more_than_the_width():
    found = answer(
        row(0.5), row(0.050, COULOMB), row(0.045, COULOMB, CUBIC, parameters=4)
    )
    assert effects(found) == ["coulomb_friction"]


def test_a_sensor_is_blamed_where_every_force_leaves_far_more():
    assert effects(answer(row(0.3), row(0.05, COULOMB), row(0.03, GAIN))) == [
        "coulomb_friction"
    ]
    assert effects(answer(row(0.3), row(0.25, COULOMB), row(0.03, GAIN))) == [
        "sensor_gain"
    ]


def test_contradictions_and_two_laws_of_a_kind_at_one_place_are_no_answer():
    found = answer(
        row(0.3),
        row(0.05, COULOMB),
        row(0.01, STRIBECK, contradiction="its values contradict its name"),
        row(0.01, COULOMB, STRIBECK),
    )
    assert effects(found) == ["coulomb_friction"]
