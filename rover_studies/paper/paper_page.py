"""Report of the paper's study: one self-contained HTML page, and CSV tables."""

from __future__ import annotations

import csv
import html
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from rover_studies.paper.paper_claims import ClaimResult, Verdict, World
from rover_studies.paper.paper_curves import SCATTER, Attribution, Convergence, Curves
from rover_studies.paper.paper_drawings import (
    convergence_plot,
    dose_response,
    paper_figure,
    scatter_map,
)
from rover_studies.paper.paper_plan import (
    CASES,
    FIGURES,
    SLACK_PERTURBATION,
    THRESHOLD,
    UNRELAXED,
    PaperFigure,
)

_STYLE: Final = """
:root { color-scheme: light; --ink:#212529; --soft:#5c636a; --line:#dee2e6; --tint:#f6f7f9 }
* { box-sizing:border-box }
body { margin:0; color:var(--ink); background:#fff;
  font:15px/1.5 system-ui,'Segoe UI',Roboto,'Helvetica Neue','DejaVu Sans',sans-serif }
main { max-width:1180px; margin:0 auto; padding:28px 24px 64px }
h1 { font-size:25px; margin:0 0 4px } h2 { font-size:19px; margin:40px 0 10px; padding-top:16px;
  border-top:1px solid var(--line) } h3 { font-size:15px; margin:20px 0 6px }
p,li { max-width:82ch } .soft { color:var(--soft) }
.answer { border-left:5px solid #18794e; background:#eef7f1; padding:10px 16px; margin:14px 0 }
.answer.open { border-color:#8a5a00; background:#fff8e6 }
figure { margin:12px 0 } figure svg { display:block; width:100%; height:auto }
.scroll { overflow-x:auto } table { border-collapse:collapse; width:100%; font-size:13.5px;
  font-variant-numeric:tabular-nums }
th,td { padding:5px 8px; border-bottom:1px solid var(--line); text-align:left; vertical-align:top }
th { color:var(--soft); border-bottom:2px solid #adb5bd; vertical-align:bottom }
td.n { text-align:right; white-space:nowrap }
.mark { display:inline-block; padding:1px 9px; border-radius:9px; font-size:12.5px; font-weight:700;
  color:#fff; white-space:nowrap }
.holds { background:#18794e } .partly { background:#2b6cb0 } .artefact { background:#a50026 }
.not { background:#5f6b7c }
.yes { background:#dff0e5; text-align:center } .no { background:#f1f3f5; text-align:center;
  color:#868e96 } .undecided { background:#fff3cd; text-align:center }
details { margin:6px 0 } summary { cursor:pointer; color:var(--soft) }
"""


def page(
    curves: Curves,
    attribution: Attribution,
    verdicts: Sequence[Verdict],
    convergences: Sequence[Convergence],
    about: str,
) -> str:
    """Return the report as HTML.

    Args:
        curves: of the study.
        attribution: of the scatter.
        verdicts: on the claims.
        convergences: of the curves.
        about: one sentence about the runs.
    """
    perturbed = {key: curve for key, curve in curves.items() if np.isfinite(curve.response).any()}
    parts = [
        "<h1>Reproduction of the source paper's tethered jump</h1>",
        f'<p class="soft">{_safe(about)}</p>',
        _answer(attribution),
        "<h2>Verdicts</h2>",
        (
            "<p>All combinations that the paper's text permits are simulated: geometry (-H: rover"
            " 2.2 m below the root; -K, +K: chord of 0.99 of the length, rover below or above),"
            " initial shape of the tether, and mesh. A claim is physical if it holds for a tether"
            " in static equilibrium on the finest mesh.</p>"
        ),
        _verdict_table(verdicts),
        "<h2>Cause of the scatter</h2>",
        (
            f"<p>Each jump of figures 13 and 14 is simulated twice, the second time with the slack"
            f" value changed by {SLACK_PERTURBATION:g}. If that changes the landing attitude by"
            f" more than {np.degrees(SCATTER):.0f} deg, the point is scatter: not a function of"
            " the slack value.</p>"
        ),
        _condition_list(attribution),
        _figure(scatter_map(perturbed)) if perturbed else "",
        _share_table(attribution),
        _figure(dose_response(perturbed)) if perturbed else "",
        (
            "<p>The tether's cubic elements cannot represent the catenary with unit tangents at"
            " the nodes: between the nodes they are stretched, with an energy that increases with"
            " the stiffness. This energy is an artefact of the mesh; static equilibrium or a finer"
            " mesh removes it.</p>"
        ),
    ]
    parts += [
        _paper_section(paper, curves, verdicts)
        for paper in FIGURES
        if all(any(key.case == case for key in curves) for case in paper.cases)
    ]
    parts += [
        "<h2>Convergence and energy balance</h2>",
        _figure(convergence_plot(convergences)) if _has_meshes(convergences) else "",
        (
            "<p>Dashed lines that do not decrease are due to the scatter, which does not converge."
            " Energy: largest residual of the energy balance over the energy involved. Step:"
            " change by half the time step.</p>"
        ),
        _convergence_table(convergences),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Study of the tethered jump</title><style>{_STYLE}</style></head>"
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )


def _has_meshes(found: Sequence[Convergence]) -> bool:
    """Return whether there are several meshes."""
    return len({one.key.elements for one in found}) > 1


def _safe(text: object) -> str:
    return html.escape(str(text))


def _figure(svg: str) -> str:
    return f"<figure>{svg}</figure>"


def conclusion(attribution: Attribution) -> str:
    """Return the cause of the scatter as a sentence."""
    if attribution.mesh_is_the_cause:
        return (
            f"The scatter beyond a slack value of {THRESHOLD:g} is not a property of the tethered"
            " jump. Its cause is a tether that is unrelaxed at the start, on a coarse mesh."
        )
    failed = sum(not holds for _, holds in attribution.conditions)
    return (
        f"These runs do not show the cause of the scatter beyond a slack value of {THRESHOLD:g}:"
        f" {failed} of {len(attribution.conditions)} conditions are not met."
    )


def _answer(attribution: Attribution) -> str:
    kind = "answer" if attribution.mesh_is_the_cause else "answer open"
    return f'<div class="{kind}"><b>{_safe(conclusion(attribution))}</b></div>'


def _condition_list(attribution: Attribution) -> str:
    items = "".join(
        f"<li>{_safe(words)} <b>({'yes' if holds else 'no'})</b></li>"
        for words, holds in attribution.conditions
    )
    return f"<ol>{items}</ol>"


def _kind(verdict: Verdict) -> tuple[str, str]:
    if verdict.everywhere:
        return "holds", "holds"
    if verdict.physics:
        return "partly", "in part"
    return ("artefact", "artefact") if verdict.artefact else ("not", "not reproduced")


def _verdict_table(verdicts: Sequence[Verdict]) -> str:
    rows = []
    for verdict in verdicts:
        kind, mark = _kind(verdict)
        claim = verdict.claim
        rows.append(
            f"<tr><td>{claim.figure}</td><td>{_safe(claim.statement)}"
            f'<div class="soft">Test: {_safe(claim.test)}.</div></td>'
            f'<td><span class="mark {kind}">{mark}</span></td>'
            f"<td>{_safe(verdict.summary)}</td></tr>"
        )
    return _table(("figure", "the paper's claim", "", "verdict"), rows)


def _table(head: Sequence[str], rows: Iterable[str]) -> str:
    heads = "".join(f"<th>{_safe(text)}</th>" for text in head)
    return (
        f'<div class="scroll"><table><thead><tr>{heads}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _share_table(attribution: Attribution) -> str:
    rows = []
    for share in attribution.shares:
        onsets = ", ".join(f"{name}: {value:.3g}" for name, value in share.onsets.items())
        shape = "unrelaxed catenary" if share.shape == UNRELAXED else "static equilibrium"
        rows.append(
            f'<tr><td>{shape}</td><td class="n">{share.elements}</td>'
            f'<td class="n">{share.below} of {share.points_below}</td>'
            f'<td class="n">{share.scattered} of {share.points}</td><td>{_safe(onsets)}</td></tr>'
        )
    head = (
        "start",
        "n",
        f"scatter up to {THRESHOLD:g}",
        f"scatter beyond {THRESHOLD:g}",
        "onset",
    )
    return _table(head, rows)


def _paper_section(paper: PaperFigure, curves: Curves, verdicts: Sequence[Verdict]) -> str:
    drawn = "".join(_figure(svg) for svg in paper_figure(paper, curves))
    claims = [v for v in verdicts if v.claim.figure == str(paper.number)]
    paragraphs = "".join(
        f"<p><b>{_safe(v.claim.statement)}</b> {_safe(v.summary[:1].upper() + v.summary[1:])}.</p>"
        f"<details><summary>in every world</summary>{_worlds(v.results)}</details>"
        for v in claims
    )
    return f"<h2>Figure {paper.number}</h2>{paragraphs}{drawn}"


def _worlds(results: Mapping[World, ClaimResult]) -> str:
    rows = []
    for world, found in results.items():
        kind, word = {
            True: ("yes", "holds"),
            False: ("no", "does not"),
            None: ("undecided", "undecided"),
        }[found.holds]
        rows.append(
            f"<tr><td>{world.geometry}</td><td>{world.shape}</td>"
            f'<td class="n">{world.elements}</td><td class="{kind}">{word}</td>'
            f"<td>{_safe(found.measured)}</td></tr>"
        )
    return _table(("geometry", "start", "n", "", "measured"), rows)


def _convergence_table(found: Sequence[Convergence]) -> str:
    rows = []
    for one in found:
        cells = [
            *one.height, *one.turn, one.step_height, one.step_turn, one.drift, one.stored,
        ]  # fmt: skip
        shown = "".join(f'<td class="n">{_number(value)}</td>' for value in cells)
        rows.append(
            f"<tr><td>{_safe(CASES[one.key.case].label)}</td><td>{one.key.geometry}</td>"
            f'<td>{one.key.shape}</td><td class="n">{one.key.elements}</td>{shown}</tr>'
        )
    head = (
        "case", "geometry", "start", "n", "height error, median [m]", "largest [m]",
        "attitude error, median [rad]", "largest [rad]", "step, height [m]", "step, attitude [rad]",
        "energy [-]", "stretch at start / jump [-]",
    )  # fmt: skip
    return f"<details open><summary>{len(rows)} curves</summary>{_table(head, rows)}</details>"


def _number(value: float) -> str:
    return "" if not np.isfinite(value) else f"{value:.1e}"


# --- tables ---------------------------------------------------------------------------------------


def write_tables(
    folder: Path,
    curves: Curves,
    attribution: Attribution,
    verdicts: Sequence[Verdict],
    convergences: Sequence[Convergence],
) -> list[Path]:
    """Write CSV files of every figure of the paper, and of verdicts, scatter and convergence."""
    written = []
    for paper in FIGURES:
        rows = [
            row
            for key, curve in curves.items()
            if key.case in paper.cases
            for row in zip(
                [CASES[key.case].label] * len(curve.slack), [key.geometry] * len(curve.slack),
                [key.shape] * len(curve.slack), [key.elements] * len(curve.slack),
                curve.slack, curve.height, curve.turn, curve.response, curve.stored, curve.drift,
                curve.halved_height, curve.halved_turn, strict=True,
            )
        ]  # fmt: skip
        head = (
            "case", "geometry", "initial_shape", "elements", "slack", "jump_height_m",
            "attitude_variation_rad", "response_to_perturbation_rad", "initial_axial_energy_J",
            "energy_drift_J", "half_step_jump_height_m", "half_step_attitude_variation_rad",
        )  # fmt: skip
        if rows:
            written.append(_csv(folder / f"figure_{paper.number}.csv", head, rows))
    worlds = [
        (v.claim.figure, v.claim.name, *world, _yes_no(found.holds), found.measured, v.summary)
        for v in verdicts
        for world, found in v.results.items()
    ]
    claims_head = ("figure", "claim", "geometry", "initial_shape", "elements", "holds", "measured",
            "verdict")  # fmt: skip
    written.append(_csv(folder / "verdicts.csv", claims_head, worlds))
    shares = [
        (s.shape, s.elements, s.points_below, s.below, s.points, s.scattered,
         " ".join(f"{name}={value:g}" for name, value in s.onsets.items()))
        for s in attribution.shares
    ]  # fmt: skip
    scatter_head = ("initial_shape", "elements", "points_up_to_threshold",
            "scattered_up_to_threshold",
            "points_beyond", "scattered_beyond", "onset_slack")  # fmt: skip
    written.append(_csv(folder / "scatter.csv", scatter_head, shares))
    rows = [
        (*one.key, *one.height, *one.turn, one.step_height, one.step_turn, one.drift, one.stored)
        for one in convergences
    ]
    convergence_head = ("case", "geometry", "initial_shape", "elements", "height_error_median_m",
            "height_error_max_m", "attitude_error_median_rad", "attitude_error_max_rad",
            "half_step_height_m", "half_step_attitude_rad", "energy_residual_ratio",
            "initial_stretch_ratio")  # fmt: skip
    written.append(_csv(folder / "convergence.csv", convergence_head, rows))
    return written


def _yes_no(holds: bool | None) -> str:
    return "undecided" if holds is None else "yes" if holds else "no"


def _csv(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(head)
        for row in rows:
            writer.writerow(["" if isinstance(v, float) and not np.isfinite(v) else v for v in row])
    return path
