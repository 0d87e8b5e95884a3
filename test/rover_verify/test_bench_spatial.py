"""The bench of the spatial plant: its rows say what they must, and the numbers can be."""

from __future__ import annotations

import pytest

from rover_verify.bench import bench_spatial

KEYS = {"case", "n", "rtf", "error_m", "peer", "peer_rtf", "peer_error_m", "ratio"}


def test_a_rest_on_rubble_is_measured(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bench_spatial, "ELEMENTS", (20, 40))
    rows = bench_spatial.measure([bench_spatial.RESTING], 1, lambda _text: None)
    assert [row["n"] for row in rows] == [20, 40]
    for row in rows:
        assert row.keys() >= KEYS
        for name in ("rtf", "rtf_in_one_call", "iterations_per_step", "core_peak_gflops"):
            value = row[name]
            assert isinstance(value, float)
            assert value > 0.0
    assert "resting on rubble" in bench_spatial.table(rows)
