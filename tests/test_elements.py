"""The laws of the elements against formulas of their own, and what each class says of itself."""

import pytest

from isd_gym import elements as el
from isd_gym.errors import InputError


def library():
    return {k: cls for k, cls in el.TYPES.items() if cls.__module__.startswith("isd_gym.elements")}


def test_every_class_of_the_library_declares_its_kind():
    for kind, cls in library().items():
        assert "mechanism" in vars(cls), kind  # declared, not inherited
        assert cls.mechanism in el.MECHANISMS, kind
    assert {cls.mechanism for cls in library().values()} == set(el.MECHANISMS)
    places = {"sensor": "channel", "drive": "element"}
    for kind, cls in library().items():
        if cls.place != "between":
            assert places[cls.mechanism] == cls.place, kind


def test_a_kind_that_is_none_of_the_list_is_refused():
    class Odd(el.Element):
        type = "test_odd"
        mechanism = "magic"

    with pytest.raises(InputError, match="mechanism must be one of dry_friction, viscous"):
        el.register(Odd)
    assert "test_odd" not in el.TYPES


def test_a_class_of_a_users_own_is_of_another_kind_unless_it_says_so():
    assert el.Element.mechanism == "other"
