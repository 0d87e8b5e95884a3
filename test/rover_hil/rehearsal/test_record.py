"""The record: every result with its measurement and place, in JSON, JUnit XML and on a page."""

from __future__ import annotations

import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from msg_schemas import topics
from rover_hil.rehearsal.expectation_result import ExpectationResult, InterfaceRule, Result
from rover_hil.rehearsal.procedure import load_procedure
from rover_hil.rehearsal.procedure_result import ProcedureResult, ProcedureStepResult
from rover_hil.rehearsal.write_record import (
    UNTESTED,
    as_junit,
    as_mapping,
    configuration_digest,
    write_record,
)

SECOND = 1_000_000_000
ODD = "it is '<b>\x00&\ud800'"


def result(result: Result, measured: str = "200 Hz") -> ExpectationResult:
    return ExpectationResult(
        result, "rate of the winch", "190 to 210 Hz", measured, (topics.WINCH_STATE,),
        12 * SECOND, 15 * SECOND,
    )  # fmt: skip


def step(
    name: str, rule: InterfaceRule, *results: ExpectationResult, reason: str = ""
) -> ProcedureStepResult:
    wall = 1_700_000_000 * SECOND
    return ProcedureStepResult(
        name, f"the title of {name}", rule, reason, results, (), 12 * SECOND, 15 * SECOND,
        wall, wall + 3 * SECOND,
    )  # fmt: skip


@pytest.fixture
def outcome() -> ProcedureResult:
    return ProcedureResult(
        load_procedure("interface_check"),
        (
            step("good", InterfaceRule.RATE, result(Result.PASS)),
            step("bad", InterfaceRule.RATE, result(Result.PASS), result(Result.FAIL, ODD)),
            step("undone", InterfaceRule.WATCHDOG, reason="no subscriber"),
            step("fine", InterfaceRule.LATENCY, result(Result.PASS)),
        ),
        True,
        {"operator": "A. Name & Co", "began": "2026-01-02T03:04:05+00:00"},
        ({"name": "winch", "state": "switched on", "clock_offset": "0.00123456"},),
        {"/hil_bridge": {"node": "/hil_bridge", "parameters": {"link": "x"}, "process": 7}},
        "bag",
        "99 messages",
    )


def test_a_rule_is_as_good_as_its_worst_step(outcome: ProcedureResult):
    rules = {each["rule"]: each for each in as_mapping(outcome)["rules"]}
    assert set(rules) == set(InterfaceRule)
    assert rules["rate"]["result"] == "FAIL"
    assert rules["latency"]["result"] == "PASS"
    assert rules["watchdog"]["result"] == rules["restart"]["result"] == "NOT RUN"
    assert rules["restart"]["reason"] == UNTESTED
    assert outcome.result is Result.FAIL


def test_an_incomplete_procedure_does_not_pass(outcome: ProcedureResult):
    fine = tuple(each for each in outcome.steps if each.result is Result.PASS)
    assert replace(outcome, steps=fine).result is Result.PASS
    assert replace(outcome, steps=fine, completed=False).result is Result.NOT_RUN
    undone = (*fine, step("undone", InterfaceRule.LATENCY, reason="x"))
    assert replace(outcome, steps=undone).result is Result.NOT_RUN
    assert step("empty", InterfaceRule.LATENCY).result is Result.NOT_RUN


def test_every_result_has_its_place_in_the_bag(outcome: ProcedureResult):
    for each in as_mapping(outcome)["steps"]:
        for found in each["results"]:
            assert found["bag"] == {
                "path": "bag",
                "topics": [topics.WINCH_STATE],
                "stamps": [12.0, 15.0],
            }


def test_junitparser_counts_the_same(outcome: ProcedureResult, tmp_path: Path):
    path = tmp_path / "junit.xml"
    path.write_text(as_junit(outcome, as_mapping(outcome)), encoding="utf-8")
    reader = pytest.importorskip("junitparser")
    read = reader.JUnitXml.fromfile(str(path))
    stated = (read.tests, read.failures, read.errors, read.skipped)
    cases = {case.name: case for suite in read for case in suite}
    results = {name: [type(each) for each in case.result] for name, case in cases.items()}
    assert results["good"] == results["fine"] == []
    assert results["bad"] == [reader.Failure]
    assert results["undone"] == [reader.Skipped]
    untested = set(InterfaceRule) - {
        InterfaceRule.RATE,
        InterfaceRule.WATCHDOG,
        InterfaceRule.LATENCY,
    }
    assert all(results[rule.value] == [reader.Skipped] for rule in untested)
    assert not any(reader.Error in each for each in results.values())
    read.update_statistics()
    assert stated == (read.tests, read.failures, read.errors, read.skipped)
    assert stated == (4 + len(untested), 1, 0, 1 + len(untested))
    assert cases["bad"].classname == "interface_check.rate"
    assert cases["bad"].time == pytest.approx(3.0)
    assert "expected: 190 to 210 Hz" in cases["bad"].result[0].message


class Page(HTMLParser):
    """Texts and links of a page, and whether every element is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag not in {"meta", "br"}:
            self.open.append(tag)
        self.ids |= {given["id"] or ""} if "id" in given else set()
        self.links += [given["href"] or ""] if "href" in given else []
        self.loads += [given["src"] or ""] if "src" in given else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_is_self_contained_and_complete(outcome: ProcedureResult, tmp_path: Path):
    write_record(outcome, tmp_path)
    page = Page((tmp_path / "record.html").read_text(encoding="utf-8", errors="replace"))
    assert not page.open
    assert not page.loads
    assert page.links
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert {each.name for each in outcome.steps} <= page.ids
    for text in (
        "A. Name & Co",
        "Sign-off",
        "Witnessed by",
        "no subscriber",
        UNTESTED,
        "99 messages",
    ):
        assert text in page.text
    assert json.loads((tmp_path / "record.json").read_text(encoding="utf-8"))["result"] == "FAIL"


def test_equal_settings_have_equal_digests_in_any_process():
    one = {"/a": {"parameters": {"x": 1}, "process": 1, "host": "here"}}
    other = {"/a": {"process": 2, "host": "there", "parameters": {"x": 1}}}
    changed = {"/a": {"parameters": {"x": 2}, "process": 1, "host": "here"}}
    assert configuration_digest(one) == configuration_digest(other)
    assert configuration_digest(one) != configuration_digest(changed)
