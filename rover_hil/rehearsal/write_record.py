"""The record of a rehearsal as JSON, JUnit XML and an HTML page."""

from __future__ import annotations

import hashlib
import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rover_hil.rehearsal.expectation_result import ExpectationResult, InterfaceRule, Result
from rover_hil.rehearsal.procedure_result import ProcedureResult, ProcedureStepResult
from rover_hil.rehearsal.record_page import page

UNTESTED = "no step of this procedure tests it"
_RUN_KEYS = frozenset({"process", "host"})
"""Keys of a node's configuration that describe its process, not its settings."""


def write_record(procedure_result: ProcedureResult, folder: Path) -> list[Path]:
    """Write ``record.json``, ``junit.xml`` and ``record.html``; returns their paths."""
    mapping = as_mapping(procedure_result)
    texts = {
        "record.json": json.dumps(mapping, indent=2) + "\n",
        "junit.xml": as_junit(procedure_result, mapping),
        "record.html": page(mapping),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", errors="replace")
    return [folder / name for name in texts]


def configuration_digest(configurations: Mapping[str, Mapping[str, Any]]) -> str:
    """SHA-256 of all nodes' settings; the same settings give the same digest."""
    settings = {
        node: {key: value for key, value in content.items() if key not in _RUN_KEYS}
        for node, content in configurations.items()
    }
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def as_mapping(procedure_result: ProcedureResult) -> dict[str, Any]:
    """The whole record as JSON values."""
    loaded = procedure_result.loaded
    return {
        "procedure": loaded.name,
        "about": loaded.procedure.about,
        "result": procedure_result.result.value,
        "completed": procedure_result.completed,
        "run": {
            **procedure_result.about,
            "procedure SHA-256": loaded.digest,
            "configuration SHA-256": configuration_digest(procedure_result.configurations),
        },
        "bag": {"path": procedure_result.bag, "recorder": procedure_result.bag_note},
        "rules": [
            {
                "rule": rule.value,
                "about": rule.about,
                "result": procedure_result.rule_result(rule).value,
                "steps": [step.name for step in procedure_result.steps_of(rule)],
                "reason": "" if procedure_result.steps_of(rule) else UNTESTED,
            }
            for rule in InterfaceRule
        ],
        "steps": [_step(step, procedure_result.bag) for step in procedure_result.steps],
        "devices": [dict(each) for each in procedure_result.devices],
        "configurations": {
            node: dict(each) for node, each in procedure_result.configurations.items()
        },
    }


def _step(step: ProcedureStepResult, bag: str) -> dict[str, Any]:
    return {
        "name": step.name,
        "title": step.title,
        "rule": step.rule.value,
        "result": step.result.value,
        "reason": step.reason,
        "invalid_attempts": list(step.invalid_attempts),
        "duration": (step.wall_end_ns - step.wall_begin_ns) * 1e-9,
        "logged": [_time_of_day(step.wall_begin_ns), _time_of_day(step.wall_end_ns)],
        "results": [_result(result, bag) for result in step.results],
    }


def _result(result: ExpectationResult, bag: str) -> dict[str, Any]:
    return {
        "result": result.result.value,
        "description": result.description,
        "expected": result.expected,
        "measured": result.measured,
        "bag": {
            "path": bag,
            "topics": list(result.topics),
            "stamps": [result.begin_ns / 1e9, result.end_ns / 1e9],
        },
    }


def _time_of_day(time_ns: int) -> str:
    if not time_ns:
        return ""
    return datetime.fromtimestamp(time_ns * 1e-9, UTC).isoformat(timespec="milliseconds")


# ---------------------------------------------------------------------------------------- JUnit XML


def as_junit(procedure_result: ProcedureResult, mapping: Mapping[str, Any]) -> str:
    """The record as JUnit XML: a suite for each rule, a case for each step."""
    name = procedure_result.loaded.name
    root = ET.Element("testsuites", name=f"rehearsal {name}")
    sums = {"tests": 0, "failures": 0, "errors": 0, "skipped": 0}
    total = 0.0
    for rule in InterfaceRule:
        steps = procedure_result.steps_of(rule)
        suite = ET.SubElement(root, "testsuite", name=f"{name}.{rule.value}")
        properties = ET.SubElement(suite, "properties")
        for key, value in {**mapping["run"], "bag": procedure_result.bag}.items():
            ET.SubElement(properties, "property", name=_printable(key), value=_printable(value))
        counts = dict.fromkeys(sums, 0)
        spent = 0.0
        for step in steps:
            duration = (step.wall_end_ns - step.wall_begin_ns) * 1e-9
            case = ET.SubElement(
                suite, "testcase", classname=f"{name}.{rule.value}", name=step.name,
                time=f"{duration:.3f}",
            )  # fmt: skip
            _add_outcome(case, step)
            counts["tests"] += 1
            counts["failures"] += step.result is Result.FAIL
            counts["skipped"] += step.result is Result.NOT_RUN
            spent += duration
        if not steps:
            case = ET.SubElement(
                suite, "testcase", classname=f"{name}.{rule.value}", name=rule.value, time="0"
            )
            ET.SubElement(case, "skipped", message=f"NOT RUN: {UNTESTED}")
            counts["tests"] = counts["skipped"] = 1
        _sum_up(suite, counts, spent)
        suite.set("timestamp", str(procedure_result.about.get("began", "")))
        for key, count in counts.items():
            sums[key] += count
        total += spent
    _sum_up(root, sums, total)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _sum_up(element: ET.Element, counts: Mapping[str, int], spent: float) -> None:
    for key, count in counts.items():
        element.set(key, str(count))
    element.set("time", f"{spent:.3f}")


def _add_outcome(case: ET.Element, step: ProcedureStepResult) -> None:
    failed = [each for each in step.results if each.result is Result.FAIL]
    if step.result is Result.NOT_RUN:
        reason = step.reason or "nothing was evaluated"
        ET.SubElement(case, "skipped", message=_printable(f"NOT RUN: {reason}"))
    elif failed:
        first = failed[0]
        failure = ET.SubElement(
            case, "failure", type=step.rule.value,
            message=_printable(
                f"{first.description}: {first.measured}, expected: {first.expected}"
            ),
        )  # fmt: skip
        failure.text = _printable("\n".join(_line(each) for each in failed))
    output = ET.SubElement(case, "system-out")
    output.text = _printable("\n".join([step.title, *(_line(each) for each in step.results)]))


def _line(result: ExpectationResult) -> str:
    where = ", ".join(result.topics)
    span = f"{result.begin_ns * 1e-9:.3f} to {result.end_ns * 1e-9:.3f} s"
    return (
        f"{result.result.value}: {result.description}: {result.measured} "
        f"(expected: {result.expected}; bag: {where}, stamps {span})"
    )


def _printable(text: object) -> str:
    """Text with characters that XML 1.0 cannot hold replaced by ?."""
    return "".join(
        char if char in "\t\n" or (char >= " " and not "\ud800" <= char <= "\udfff") else "?"
        for char in str(text)
    )
