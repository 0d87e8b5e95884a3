"""The record of a rehearsal as one self-contained HTML page, to be read, printed and signed."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_STYLE = """
:root { --ink:#1b2430; --dim:#5d6877; --line:#dfe3ea; --ground:#f4f6f8; --paper:#fff }
* { box-sizing:border-box }
body { margin:0; background:var(--ground); color:var(--ink);
  font:14.5px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif }
main { max-width:1180px; margin:0 auto; padding:26px 22px 60px }
h1 { margin:0; font-size:25px; line-height:1.2 } h2 { margin:34px 0 10px; font-size:18px }
p { margin:6px 0; max-width:80ch } .dim { color:var(--dim) }
header { display:flex; justify-content:space-between; align-items:flex-start; gap:24px }
.stamp { border:3px solid var(--colour); color:var(--colour); border-radius:8px; font-weight:800;
  font-size:24px; letter-spacing:.06em; padding:6px 18px; white-space:nowrap; background:#fff }
.facts { display:grid; grid-template-columns:repeat(auto-fill,minmax(250px,1fr)); gap:1px;
  background:var(--line); border:1px solid var(--line); margin:18px 0 }
.facts div { background:var(--paper); padding:7px 12px; overflow-wrap:anywhere }
.facts span { display:block; color:var(--dim); font-size:12px }
.facts .wide { grid-column:1/-1 }
table { width:100%; border-collapse:collapse; background:var(--paper);
  border:1px solid var(--line) }
th,td { text-align:left; vertical-align:top; padding:6px 10px; border-top:1px solid var(--line);
  overflow-wrap:anywhere }
th { background:#eef1f5; color:var(--dim); font-weight:600; font-size:12.5px; border-top:0 }
td.num { font-variant-numeric:tabular-nums }
.v { display:inline-block; min-width:66px; text-align:center; padding:1px 8px; border-radius:4px;
  font-size:12px; font-weight:700; color:#fff; background:var(--colour); white-space:nowrap }
.PASS { --colour:#1a7544 } .FAIL { --colour:#bd2027 } .NOT-RUN { --colour:#8a6a00 }
.trouble { border-left:5px solid #bd2027; background:#fdeeee; padding:9px 14px; margin:14px 0 }
.open { border-left:5px solid #8a6a00; background:#fdf6e3; padding:9px 14px; margin:14px 0 }
.trouble ul,.open ul { margin:4px 0; padding-left:20px }
.step { background:var(--paper); border:1px solid var(--line); border-left:5px solid var(--colour);
  margin:12px 0; break-inside:avoid }
.step > div { padding:9px 12px; display:flex; gap:12px; align-items:baseline }
.step b { font-size:15px } .step .name { color:var(--dim); font-size:12.5px; margin-left:auto;
  white-space:nowrap }
.step p { padding:0 12px 8px; margin:0 } .step table { border:0 }
.step th:nth-child(1) { width:92px } .step th:nth-child(2) { width:30% }
.step th:nth-child(3) { width:24% } .step th:nth-child(5) { width:19% }
.step td:nth-child(5) { color:var(--dim); font-size:12.5px }
.bad td:nth-child(4) { color:#bd2027; font-weight:600 }
a { color:inherit } code,pre { font:12px/1.45 ui-monospace,"DejaVu Sans Mono",monospace }
pre { background:var(--paper); border:1px solid var(--line); padding:10px; overflow:auto;
  white-space:pre-wrap; overflow-wrap:anywhere; max-height:340px }
details { margin:8px 0 } summary { cursor:pointer }
.sign { display:grid; grid-template-columns:1fr 1fr 1fr; gap:26px; margin-top:14px }
.sign div { background:var(--paper); border:1px solid var(--line); padding:10px 14px 12px;
  break-inside:avoid }
.sign b { display:block; margin-bottom:4px } .sign i { display:block; font-style:normal;
  color:var(--dim); font-size:12px; border-top:1px solid #98a2b0; margin-top:36px; padding-top:3px }
.boxes { margin:14px 0 0 } .boxes span { margin-right:26px }
@media print { body { background:#fff; font-size:11.5px } main { padding:0; max-width:none }
  details { display:none } * { print-color-adjust:exact; -webkit-print-color-adjust:exact } }
@media (max-width:760px) { .sign { grid-template-columns:1fr } header { flex-direction:column } }
"""
_FIRST = ("operator", "machine", "began", "ended", "contract version", "package version")
_WIDE = ("procedure", "procedure SHA-256", "configuration SHA-256")


def page(record: Mapping[str, Any]) -> str:
    """The page of a record made by `write_record.as_mapping`."""
    name, result = record["procedure"], record["result"]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Rehearsal record: {_text(name)}, {_text(result)}</title>"
        f"<style>{_STYLE}</style></head><body><main>"
        f"<header><div><h1>Rehearsal record: {_text(name)}</h1>"
        f'<p class="dim">{_text(record["about"])}</p></div>'
        f'<div class="stamp {_kind(result)}">{_text(result)}</div></header>'
        f"{_facts(record)}{_summary(record)}{_rules(record['rules'])}"
        f"<h2>Steps</h2>{''.join(_step(step) for step in record['steps'])}"
        f"{_devices(record['devices'])}{_configurations(record['configurations'])}"
        f"{_sign_off(record)}</main></body></html>\n"
    )


def _facts(record: Mapping[str, Any]) -> str:
    run: Mapping[str, str] = record["run"]
    bag = record["bag"]
    order = [*_FIRST, *(key for key in run if key not in {*_FIRST, *_WIDE})]
    cells = [_fact(key, run.get(key, "")) for key in order]
    recorded = f"{bag['path'] or 'none'} ({bag['recorder']})"
    cells += [_fact("bag, beside this page", recorded, "wide")]
    cells += [_fact(key, run.get(key, ""), "wide") for key in _WIDE]
    return f'<div class="facts">{"".join(cells)}</div>'


def _fact(key: str, value: str, kind: str = "") -> str:
    shown = _text(value) if value else '<span class="dim">not given</span>'
    return f'<div class="{kind}"><span>{_text(key)}</span>{shown}</div>'


def _summary(record: Mapping[str, Any]) -> str:
    """Failed and not run steps, with their reasons."""
    parts = []
    if not record["completed"]:
        parts.append('<div class="open">This rehearsal was not completed.</div>')
    for result, kind, words in (
        ("FAIL", "trouble", "Failed"),
        ("NOT RUN", "open", "Not run"),
    ):
        steps = [step for step in record["steps"] if step["result"] == result]
        items = [
            f'<li><a href="#{_text(step["name"])}">{_text(step["title"])}</a>: '
            f"{_text(step['reason'] or _first_failure(step))}</li>"
            for step in steps
        ]
        items += [
            f"<li>Rule {_words(rule['rule'])}: {_text(rule['reason'])}</li>"
            for rule in record["rules"]
            if result == "NOT RUN" and not rule["steps"]
        ]
        if items:
            parts.append(f'<div class="{kind}">{words}:<ul>{"".join(items)}</ul></div>')
    return "".join(parts)


def _first_failure(step: Mapping[str, Any]) -> str:
    failed = [each for each in step["results"] if each["result"] == "FAIL"]
    more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
    return (
        f"{failed[0]['description']}: {failed[0]['measured']}{more}"
        if failed
        else "nothing was evaluated"
    )


def _rules(rules: Iterable[Mapping[str, Any]]) -> str:
    body = "".join(
        f"<tr><td>{_badge(rule['result'])}</td><td><b>{_words(rule['rule'])}</b></td>"
        f"<td>{_text(rule['about'])}</td><td>{_links(rule)}</td></tr>"
        for rule in rules
    )
    return (
        "<h2>Interface rules of the contract</h2><table><tr><th style='width:92px'>result</th>"
        "<th style='width:110px'>rule</th><th>requirement</th>"
        f"<th style='width:40%'>tested by</th></tr>{body}</table>"
    )


def _links(rule: Mapping[str, Any]) -> str:
    if not rule["steps"]:
        return f'<span class="dim">{_text(rule["reason"])}</span>'
    return ", ".join(
        f'<a href="#{_text(name)}">{_text(name.replace("_", " "))}</a>' for name in rule["steps"]
    )


def _step(step: Mapping[str, Any]) -> str:
    notes = [f"Not run: {step['reason']}"] if step["reason"] else []
    notes += [
        f"Attempt {number} is invalid: {why}"
        for number, why in enumerate(step["invalid_attempts"], 1)
    ]
    begin, end = step["logged"]
    if begin:
        notes.append(f"Log time in the bag: {begin} to {end[11:]}.")
    body = "".join(_result(each) for each in step["results"])
    table = (
        "<table><tr><th>result</th><th>quantity</th><th>expected</th><th>measured</th>"
        f"<th>in the bag: topic, stamps [s]</th></tr>{body}</table>"
    )
    return (
        f'<section class="step {_kind(step["result"])}" id="{_text(step["name"])}">'
        f"<div>{_badge(step['result'])}<b>{_text(step['title'])}</b>"
        f'<span class="name">{_words(step["rule"])} &middot; {_text(step["name"])}</span></div>'
        + "".join(f'<p class="dim">{_text(note)}</p>' for note in notes)
        + (table if body else "")
        + "</section>"
    )


def _result(result: Mapping[str, Any]) -> str:
    bag = result["bag"]
    begin, end = bag["stamps"]
    where = "<br>".join(_text(topic) for topic in bag["topics"])
    bad = ' class="bad"' if result["result"] == "FAIL" else ""
    return (
        f"<tr{bad}><td>{_badge(result['result'])}</td><td>{_text(result['description'])}</td>"
        f"<td>{_text(result['expected'])}</td>"
        f'<td class="num">{_text(result["measured"])}</td>'
        f'<td class="num">{where}<br>{begin:.3f} to {end:.3f}</td></tr>'
    )


def _devices(devices: Sequence[Mapping[str, str]]) -> str:
    if not devices:
        return ""
    body = "".join(
        f"<tr><td>{_text(each['name'])}</td><td>{_text(each['state'])}</td><td>"
        + _values({key: each[key] for key in each if key not in {"name", "state"}})
        + "</td></tr>"
        for each in devices
    )
    return (
        "<h2>Link and devices after the last step</h2><table><tr>"
        "<th style='width:110px'>device</th>"
        f"<th style='width:190px'>state</th><th>values</th></tr>{body}</table>"
    )


def _values(values: Mapping[str, str]) -> str:
    return ", ".join(f"{_text(key)} {_text(_short(text))}" for key, text in values.items() if text)


def _short(text: str) -> str:
    try:
        return f"{float(text):.4g}" if "." in text else text
    except ValueError:
        return text


def _configurations(configurations: Mapping[str, Mapping[str, Any]]) -> str:
    if not configurations:
        return ""
    parts = "".join(
        f"<details><summary>{_text(node)}</summary>"
        f"<pre>{_text(json.dumps(content, indent=1, sort_keys=True))}</pre></details>"
        for node, content in configurations.items()
    )
    return f"<h2>Configuration of the nodes</h2>{parts}"


def _sign_off(record: Mapping[str, Any]) -> str:
    operator = record["run"].get("operator", "")
    lines = "<i>name</i><i>signature</i><i>date</i>"
    conducted_by = f"<b>Conducted by</b>{_text(operator) or '&nbsp;'}<i>signature</i><i>date</i>"
    return (
        "<h2>Sign-off</h2><p>The undersigned have read this record. A rule with the result NOT RUN "
        'is not verified.</p><p class="boxes"><span>&#9744; accepted</span>'
        "<span>&#9744; accepted with "
        "the exceptions noted</span><span>&#9744; rejected</span></p>"
        f'<div class="sign"><div>{conducted_by}</div><div><b>Witnessed by</b>{lines}</div>'
        f"<div><b>For the hardware team</b>{lines}</div></div>"
    )


def _badge(result: str) -> str:
    return f'<span class="v {_kind(result)}">{_text(result)}</span>'


def _kind(result: str) -> str:
    return result.replace(" ", "-")


def _words(name: str) -> str:
    return _text(name.replace("_", " "))


def _text(value: object) -> str:
    return html.escape(str(value))
