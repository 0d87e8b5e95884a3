"""The record of a rehearsal as files: for machines (JSON, JUnit XML) and for people (a page)."""

from __future__ import annotations

import hashlib
import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rover_hil.rehearsal.finding import ABOUT_RULES, Finding, Rule, Verdict
from rover_hil.rehearsal.outcome import Outcome, StepOutcome
from rover_hil.rehearsal.record_page import page

UNTESTED = "no step of this procedure tests it"
_OF_THE_RUN = frozenset({"process", "host"})
"""What a node's configuration says of its run, not of its settings."""


def write_record(outcome: Outcome, folder: Path) -> list[Path]:
    """Write ``record.json``, ``junit.xml`` and ``record.html``; returns their paths."""
    mapping = as_mapping(outcome)
    texts = {
        "record.json": json.dumps(mapping, indent=2) + "\n",
        "junit.xml": as_junit(outcome, mapping),
        "record.html": page(mapping),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", errors="replace")
    return [folder / name for name in texts]


def configuration_digest(configurations: Mapping[str, Mapping[str, Any]]) -> str:
    """SHA-256 of all nodes' settings; the same settings give the same digest."""
    settings = {
        node: {key: value for key, value in content.items() if key not in _OF_THE_RUN}
        for node, content in configurations.items()
    }
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def as_mapping(outcome: Outcome) -> dict[str, Any]:
    """The whole record as JSON values."""
    written = outcome.written
    return {
        "procedure": written.name,
        "about": written.procedure.about,
        "verdict": outcome.verdict.value,
        "completed": outcome.completed,
        "run": {
            **outcome.about,
            "procedure SHA-256": written.digest,
            "configuration SHA-256": configuration_digest(outcome.configurations),
        },
        "bag": {"path": outcome.bag, "recorder": outcome.bag_note},
        "rules": [
            {
                "rule": rule.value,
                "about": ABOUT_RULES[rule],
                "verdict": outcome.rule_verdict(rule).value,
                "steps": [step.name for step in outcome.of_rule(rule)],
                "reason": "" if outcome.of_rule(rule) else UNTESTED,
            }
            for rule in Rule
        ],
        "steps": [_step(step, outcome.bag) for step in outcome.steps],
        "machine": [dict(each) for each in outcome.machine],
        "configurations": {node: dict(each) for node, each in outcome.configurations.items()},
    }


def _step(step: StepOutcome, bag: str) -> dict[str, Any]:
    return {
        "name": step.name,
        "title": step.title,
        "rule": step.rule.value,
        "verdict": step.verdict.value,
        "reason": step.reason,
        "disturbances": list(step.disturbances),
        "duration": (step.wall_end_ns - step.wall_begin_ns) * 1e-9,
        "logged": [_time_of_day(step.wall_begin_ns), _time_of_day(step.wall_end_ns)],
        "findings": [_finding(finding, bag) for finding in step.findings],
    }


def _finding(finding: Finding, bag: str) -> dict[str, Any]:
    return {
        "verdict": finding.verdict.value,
        "what": finding.what,
        "required": finding.required,
        "measured": finding.measured,
        "bag": {
            "path": bag,
            "topics": list(finding.topics),
            "stamps": [finding.begin_ns / 1e9, finding.end_ns / 1e9],
        },
    }


def _time_of_day(time_ns: int) -> str:
    if not time_ns:
        return ""
    return datetime.fromtimestamp(time_ns * 1e-9, UTC).isoformat(timespec="milliseconds")


# ---------------------------------------------------------------------------------------- JUnit XML


def as_junit(outcome: Outcome, mapping: Mapping[str, Any]) -> str:
    """The record as JUnit XML: a suite for each rule, a case for each step."""
    name = outcome.written.name
    root = ET.Element("testsuites", name=f"rehearsal {name}")
    sums = {"tests": 0, "failures": 0, "errors": 0, "skipped": 0}
    total = 0.0
    for rule in Rule:
        steps = outcome.of_rule(rule)
        suite = ET.SubElement(root, "testsuite", name=f"{name}.{rule.value}")
        properties = ET.SubElement(suite, "properties")
        for key, value in {**mapping["run"], "bag": outcome.bag}.items():
            ET.SubElement(properties, "property", name=_printable(key), value=_printable(value))
        counts = dict.fromkeys(sums, 0)
        spent = 0.0
        for step in steps:
            duration = (step.wall_end_ns - step.wall_begin_ns) * 1e-9
            case = ET.SubElement(
                suite, "testcase", classname=f"{name}.{rule.value}", name=step.name,
                time=f"{duration:.3f}",
            )  # fmt: skip
            _judge_case(case, step)
            counts["tests"] += 1
            counts["failures"] += step.verdict is Verdict.FAIL
            counts["skipped"] += step.verdict is Verdict.NOT_RUN
            spent += duration
        if not steps:
            case = ET.SubElement(
                suite, "testcase", classname=f"{name}.{rule.value}", name=rule.value, time="0"
            )
            ET.SubElement(case, "skipped", message=f"NOT RUN: {UNTESTED}")
            counts["tests"] = counts["skipped"] = 1
        _sum_up(suite, counts, spent)
        suite.set("timestamp", str(outcome.about.get("began", "")))
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


def _judge_case(case: ET.Element, step: StepOutcome) -> None:
    failed = [each for each in step.findings if each.verdict is Verdict.FAIL]
    if step.verdict is Verdict.NOT_RUN:
        reason = step.reason or "nothing was judged"
        ET.SubElement(case, "skipped", message=_printable(f"NOT RUN: {reason}"))
    elif failed:
        first = failed[0]
        failure = ET.SubElement(
            case, "failure", type=step.rule.value,
            message=_printable(f"{first.what}: {first.measured}, required: {first.required}"),
        )  # fmt: skip
        failure.text = _printable("\n".join(_line(each) for each in failed))
    told = ET.SubElement(case, "system-out")
    told.text = _printable("\n".join([step.title, *(_line(each) for each in step.findings)]))


def _line(finding: Finding) -> str:
    where = ", ".join(finding.topics)
    span = f"{finding.begin_ns * 1e-9:.3f} to {finding.end_ns * 1e-9:.3f} s"
    return (
        f"{finding.verdict.value}: {finding.what}: {finding.measured} "
        f"(required: {finding.required}; bag: {where}, stamps {span})"
    )


def _printable(text: object) -> str:
    """What XML 1.0 can hold."""
    return "".join(
        char if char in "\t\n" or (char >= " " and not "\ud800" <= char <= "\udfff") else "?"
        for char in str(text)
    )
