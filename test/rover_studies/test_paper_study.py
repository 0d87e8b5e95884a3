"""The paper's whole study: its conclusions follow from the values."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from rover_cli.command_line import main
from rover_studies.paper.paper_claims import evaluate_claims
from rover_studies.paper.paper_curves import SCATTER, Curve, Key, attribution, convergence
from rover_studies.paper.paper_page import page
from rover_studies.paper.paper_plan import (
    CASES,
    GEOMETRIES,
    HEAVY,
    LIGHT,
    RELAXED,
    SHAPES,
    SLACK_PERTURBATION,
    SOFT,
    UNRELAXED,
    WHOLE,
    Extent,
    case_of,
    even_slacks,
    plans,
)
from rover_studies.paper.whole_study import evaluate, make_runs

SLACKS = np.array(even_slacks(0.25))
MESHES = (5, 10, 20)


def curve(
    height: float = 0.33, *, scattered_from: float = np.inf, stored: float = 1e-6, turn: float = 0.0
) -> Curve:
    """A flat curve, with scatter from a slack value on."""
    wild = scattered_from <= SLACKS
    generator = np.random.default_rng(1)
    noise = generator.normal(0.0, 1.0, (4, len(SLACKS))) * wild
    flat = np.full(len(SLACKS), 1.0)
    return Curve(
        slack=SLACKS,
        height=height * flat + 0.1 * np.abs(noise[0]),
        turn=turn * SLACKS + noise[1],
        stored=np.where(wild, 100.0, stored),
        released=30.0,
        drift=1e-9 * flat,
        response=np.where(wild, 50.0 * SCATTER, 1e-6),
        halved_height=height * flat + 0.1 * np.abs(noise[2]),
        halved_turn=turn * SLACKS + noise[3],
    )


def world_of(**onsets: float) -> dict[Key, Curve]:
    """Curves of figures 13 and 14, with scatter from the onset of `<shape>_<elements>`."""
    return {
        Key(case, geometry, shape, elements): curve(
            scattered_from=onsets.get(f"{shape}_{elements}", np.inf)
        )
        for case in (HEAVY, LIGHT)
        for geometry in GEOMETRIES
        for shape in SHAPES
        for elements in MESHES
    }


class TestAttribution:
    def test_scatter_of_the_unrelaxed_coarse_mesh_is_found(self):
        found = attribution(world_of(catenary_5=1.25, catenary_10=2.0))
        assert found.mesh_is_the_cause, found.conditions
        coarse = next(s for s in found.shares if (s.shape, s.elements) == (UNRELAXED, 5))
        assert set(coarse.onsets.values()) == {1.25}
        assert coarse.scattered == coarse.points
        assert found.separation == pytest.approx(1.0)

    @pytest.mark.parametrize(
        ("onsets", "which"),
        [
            ({}, 0),  # no scatter
            ({"catenary_5": 1.25, "catenary_10": 2.0, "static_5": 1.25}, 1),
            ({"catenary_5": 1.25, "catenary_10": 2.0, "catenary_20": 2.5}, 2),
            ({"catenary_5": 2.0, "catenary_10": 2.0}, 3),  # the tether's own threshold
        ],
    )
    def test_other_worlds_give_other_conclusions(self, onsets: dict[str, float], which: int):
        found = attribution(world_of(**onsets))
        assert not found.mesh_is_the_cause
        assert not found.conditions[which][1], found.conditions

    def test_scatter_that_half_the_step_removes_is_due_to_the_integrator(self):
        curves = world_of(catenary_5=1.25, catenary_10=2.0)
        for key, one in curves.items():
            calm = np.zeros(len(SLACKS))
            curves[key] = Curve(**{**vars(one), "halved_turn": calm})
        assert not attribution(curves).conditions[-1][1]


class TestVerdicts:
    def test_verdicts_follow_from_the_worlds(self):
        found = {
            v.claim.name: v for v in evaluate_claims(world_of(catenary_5=1.75, catenary_10=2.0))
        }
        scatter = found["scatter beyond 1.5"]
        assert scatter.artefact
        assert "unrelaxed tether, n = 5, 10" in scatter.summary
        found = {v.claim.name: v for v in evaluate_claims(world_of(static_20=1.75))}
        assert found["scatter beyond 1.5"].summary.startswith("holds")
        assert not found["scatter beyond 1.5"].artefact
        assert {v.claim.name for v in evaluate_claims(world_of())} == {
            "height beyond 1.5", "scatter beyond 1.5", "lighter Body 2",
        }  # fmt: skip

    def test_a_claim_that_holds_in_one_geometry_names_it(self):
        curves = {
            Key(SOFT, geometry, shape, 5): curve(turn=0.3 if geometry == "+K" else 0.0)
            for geometry in GEOMETRIES
            for shape in SHAPES
        }
        found = {v.claim.name: v.summary for v in evaluate_claims(curves)}
        assert found == {
            "soft: height": "holds",
            "soft: attitude": "holds in geometry -H, -K only",
        }


def test_the_plans_have_every_world_of_every_figure():
    sweeps = plans(WHOLE)
    jumps = sweeps["jumps"]
    assert jumps.count == len(CASES) * 3 * 2 * 4 * len(WHOLE.slacks)
    rows = [jumps.row(jumps.run(number)) for number in range(0, jumps.count, 31)]
    assert {case_of(row) for row in rows} == set(CASES)
    ratios = {float(str(row["rover.m2"])) / float(str(row["rover.m1"])) for row in rows}
    assert {round(ratio, 6) for ratio in ratios} >= {0.003, 0.004, 0.058}
    perturbed = sweeps["perturbed"]
    assert perturbed.row(perturbed.run(0))["start.slack"] == pytest.approx(
        WHOLE.slacks[0] + SLACK_PERTURBATION
    )


@pytest.mark.slow
def test_a_small_study_from_runs_to_report(tmp_path: Path):
    extent = Extent((0.5, 0.75, 2.0, 2.5, 3.0, 3.5), (5, 40), (HEAVY,), ("-H",))
    rows = make_runs(extent, tmp_path / "runs", workers=1, show_progress=False)
    cause, found = evaluate(rows, tmp_path)
    shares = {(s.shape, s.elements): s.scattered for s in cause.shares}
    assert shares[RELAXED, 5] == shares[RELAXED, 40] == shares[UNRELAXED, 40] == 0
    assert shares[UNRELAXED, 5] >= 3
    # Heights of scattered jumps depend on the machine; the scatter itself does not.
    assert {v.claim.name: v.artefact for v in found}["scatter beyond 1.5"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") >= 5
    assert "http" not in page.replace("http://www.w3.org", "").replace("https://www.w3.org", "")
    with (tmp_path / "figure_13.csv").open(encoding="utf-8") as stream:
        points = list(csv.DictReader(stream))
    assert len(points) == 24
    assert all(0.2 < float(point["jump_height_m"]) < 0.6 for point in points)
    summary = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert summary["landed"] == summary["runs"] == sum(len(table) for table in rows.values())
    again = make_runs(extent, tmp_path / "runs", workers=1, show_progress=False)
    assert again == rows


def test_convergence_is_against_the_finest_mesh():
    curves = {Key(HEAVY, "-H", RELAXED, n): curve(0.33 + 0.1 / n**2) for n in (5, 10, 20)}
    off = [one.height[1] for one in convergence(curves)]
    assert off == pytest.approx([0.1 / 25 - 0.1 / 400, 0.1 / 100 - 0.1 / 400, 0.0])


@pytest.mark.parametrize("meshes", [(5,), (5, 20)])
def test_a_study_of_one_mesh_has_a_page_without_convergence(meshes: tuple[int, ...]):
    curves = {
        key: one
        for key, one in world_of().items()
        if key.elements in meshes and (key.case, key.geometry) == (HEAVY, "-H")
    }
    text = page(
        curves, attribution(curves), evaluate_claims(curves), convergence(curves), "made up"
    )
    assert ("Largest difference from n = 20" in text) is (len(meshes) > 1)


def test_bad_options_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    with pytest.raises(SystemExit, match="2"):
        main(["study", "all", "--workers", "0"])
    assert "--workers: '0' should be a whole number from 1" in capsys.readouterr().err
    (tmp_path / "plain").write_text("a file", encoding="utf-8")
    assert main(["study", "all", "--quick", "--out", str(tmp_path / "plain")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
