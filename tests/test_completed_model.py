"""The completed model where nothing is named: the best candidate, if it errs less on records that took no part in the fit."""

from types import SimpleNamespace

import numpy as np
import pytest

from isd_gym.diagnosis._result_builder import ResultBuilder
from isd_gym.diagnosis._selection.criteria import CRITERIA
from isd_gym.diagnosis._selection.free_force import FreeForce

REFITTED, LAW, TABLE = (SimpleNamespace(name=n, hypotheses=(n,), well_formed=lambda: True) for n in "rlt")


def completes(validation, refit, after, table=None, law=LAW):
    """Whether a law completes a model, by mean squares on validation records and errors on test records."""
    scores = SimpleNamespace(
        refitted=REFITTED, foremost=law, score=lambda c: SimpleNamespace(mean_square=validation[c.name])
    )
    builder = SimpleNamespace(
        scores=scores,
        search=SimpleNamespace(criteria=CRITERIA),
        _errors=lambda c: {"refit": np.array([refit]), "after": np.array([after])},
    )
    return ResultBuilder._is_supported(builder, FreeForce(candidate=table))


@pytest.mark.parametrize(
    ("validation", "test", "answer"),
    [
        ((4.0, 2.0), (0.3, 0.2), True),
        ((4.0, 4.1), (0.3, 0.2), False),  # errs more on validation records
        ((4.0, 2.0), (0.3, 0.31), False),  # errs more on test records
        (
            (4.0, 2.0),
            (0.3, 0.299),
            False,
        ),  # sqrt(0.3^2 - 0.299^2) = 2.4 % of the deviation: nobody would notice
    ],
)
def test_a_law_completes_a_model_that_it_improves_on_validation_and_on_test_records(validation, test, answer):
    assert completes(dict(zip("rl", validation, strict=True)), *test) == answer


def test_the_table_of_a_free_force_and_the_law_compete_on_validation_records():
    assert completes({"r": 4.0, "l": 2.0, "t": 2.5}, 0.3, 0.2, TABLE)
    assert not completes({"r": 4.0, "l": 2.0, "t": 1.5}, 0.3, 0.2, TABLE)


def test_nothing_completes_a_model_without_a_candidate_or_with_values_that_contradict_its_law():
    nobody = SimpleNamespace(name="l", hypotheses=(), well_formed=lambda: True)
    odd = SimpleNamespace(name="l", hypotheses=("l",), well_formed=lambda: False)
    assert not completes({"r": 4.0, "l": 2.0}, 0.3, 0.2, law=nobody)
    assert not completes({"r": 4.0, "l": 2.0}, 0.3, 0.2, law=odd)
