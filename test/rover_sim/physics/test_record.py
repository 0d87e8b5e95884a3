from typing import Any, NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import checked, inner
from rover_sim.physics.numerics.record import Record, store


class Inside(NamedTuple):
    factor: float
    enabled: bool
    place: tuple[float, float, float]


class Outside(NamedTuple):
    given: Any
    inside: Inside
    number: int
    result: Any


@checked
def _fill(value: Outside, buffer: Any) -> None:
    store(value, buffer)


@inner
def _height(inside: Inside) -> float:
    return inside.factor * inside.place[2] if inside.enabled else -1.0


@checked
def _fill_rows(record: Outside, times: float) -> float:
    for k in range(record.given.shape[0]):
        record.result[1, k] = record.given[k] * record.inside.factor
    return float(_height(record.inside) * times + record.number)


def make(enabled: bool) -> Outside:
    inside = Inside(2.0, enabled, (1.0, 2.0, 3.0))
    return Outside(np.arange(4.0), inside, 7, np.zeros((2, 4)))


def test_a_kernel_reads_fields_and_writes_elements_of_a_record() -> None:
    values = make(True)
    record = Record(values, _fill)
    assert _fill_rows(record, 10.0) == 67.0
    np.testing.assert_array_equal(values.result, [[0.0] * 4, [0.0, 2.0, 4.0, 6.0]])
    values.given[1] = -5.0
    assert _fill_rows(record, 0.0) == 7.0
    assert values.result[1, 1] == -10.0


def test_records_of_equal_types_share_a_compiled_kernel() -> None:
    first, second = Record(make(True), _fill), Record(make(False), _fill)
    assert _fill_rows(first, 1.0) == 13.0
    before = len(_fill_rows.overloads)
    assert _fill_rows(second, 1.0) == 6.0
    assert len(_fill_rows.overloads) == before


def test_a_kernel_compiles_for_the_type_of_a_field() -> None:
    record = Record(make(True), _fill)
    inside = record.field("inside")
    _height.compile((inside._numba_type_,))
    assert record.field("given") is record.value.given
