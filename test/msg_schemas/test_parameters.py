"""Parameters are typed, finite and in range, or refused with what would be right."""

import math
from dataclasses import dataclass
from typing import Any

import pytest

from msg_schemas.parameters import ParameterError, from_mapping, parameter, rules_of


@dataclass(frozen=True)
class Trial:
    rate: float = parameter(100.0, "Hz", "state rate", 1.0, 1000.0)
    steps: int = parameter(3, "-", "number of steps", 1, 10)
    model: str = parameter("planar", "-", "plant", choices=("planar", "spatial"))
    armed: bool = parameter(False, "-", "may move")


def test_defaults_hold_and_given_values_replace_them():
    made = from_mapping(Trial, {"rate": 50.5, "model": "spatial"})
    assert made == Trial(rate=50.5, model="spatial")


def test_an_integer_is_accepted_as_a_float_but_no_float_as_an_integer():
    assert from_mapping(Trial, {"rate": 50}).rate == 50.0
    assert isinstance(from_mapping(Trial, {"rate": 50}).rate, float)
    with pytest.raises(ParameterError, match=r"steps = 3\.0: should be a whole number at least 1"):
        from_mapping(Trial, {"steps": 3.0})


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"rate": math.nan}, "rate = nan: should be a number .* Hz, and finite"),
        ({"rate": math.inf}, "rate = inf: should be a number .* Hz, and finite"),
        ({"rate": 0.5}, "rate = 0.5: should be a number at least 1 and at most 1000 Hz"),
        ({"rate": "fast"}, "rate = 'fast': should be a number"),
        ({"rate": True}, "rate = True: should be a number"),
        ({"steps": 11}, "steps = 11: should be a whole number at least 1 and at most 10"),
        ({"armed": 1}, "armed = 1: should be true or false"),
        ({"model": "flat"}, "model = 'flat': should be one of planar, spatial"),
        ({"speed": 1.0}, "unknown parameter speed.* known here: rate, steps, model, armed"),
        ({"stepps": 1}, "did you mean 'steps'"),
    ],
)
def test_bad_values_are_refused_with_what_would_be_right(given: dict[str, Any], text: str):
    with pytest.raises(ParameterError, match=text):
        from_mapping(Trial, given)


def test_a_field_made_otherwise_is_a_programming_error():
    @dataclass(frozen=True)
    class Careless:
        rate: float = 1.0

    with pytest.raises(TypeError, match="rate"):
        rules_of(Careless)

    @dataclass(frozen=True)
    class Whole:
        rate: float = parameter(1, "Hz", "a whole number for a rate")

    with pytest.raises(TypeError, match=r"Whole\.rate"):
        rules_of(Whole)
