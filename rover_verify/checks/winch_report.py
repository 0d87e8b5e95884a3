"""`mother_rover winch report`: one page on the winch's tracking and load detection.

winch_node and the simulator fly in one process, with errors of the sensors: the descent that the
requirements ask for, and descents drawn at random. Or the descent is flown by processes over DDS
and recorded; or it is one that was recorded earlier.
"""

from __future__ import annotations

import argparse
import base64
import html
import io
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tqdm import tqdm

from msg_schemas.number_arguments import seed, whole_number
from msg_schemas.phases import WinchMode
from rover_bags.files.store import BagError
from rover_verify.checks import CheckBatch, winch_bag
from rover_verify.checks import winch as checks
from rover_verify.checks.winch_record import WinchRecord, record_of_bag

_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#868e96"
_DPI = 110
_STYLE = """
body{margin:0;background:#f5f6f8;color:#1d2430;font:15px/1.5 system-ui,"DejaVu Sans",sans-serif}
main{max-width:1160px;margin:0 auto;padding:28px 20px 60px}
img{width:100%;background:#fff;border:1px solid #e3e6ec;border-radius:10px}
table{border-collapse:collapse;background:#fff;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:right;padding:7px 12px;border:1px solid #e3e6ec}
th:first-child,td:first-child{text-align:left} th{color:#667085;font-weight:600}
.wrong{color:#c62a2f;font-weight:700} p{max-width:75ch}
"""


def draw_descent(record: WinchRecord, begin: float, end: float, title: str) -> Figure:
    """Length, its error, rate, tension and torque between two times [s]."""
    time = record["time"]
    part = (time >= begin) & (time <= end)
    column = {name: values[part] for name, values in record.columns.items()}
    time = time[part]
    figure = Figure(figsize=(11.5, 10.0), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True, height_ratios=(3, 2, 2, 2, 2))
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    _lines(axes[0], time, "paid out [m]", reference=column["reference"], drum=column["length"])
    axes[0].invert_yaxis()
    error = 1e3 * (column["length"] - column["reference"])
    _lines(axes[1], time, "drum less\nreference [mm]", drum=error)
    rates = {"reference": column["reference_rate"], "drum": column["rate"]}
    _lines(axes[2], time, "payout rate [m/s]", **rates)
    _lines(axes[3], time, "tension at\nthe fairlead [N]", drum=column["tension"])
    _lines(axes[4], time, "motor [N m]", drum=column["torque"])
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.06), ncols=2, frameon=False)
    shown = [(at, mode) for at, mode in record.modes if begin <= at <= end]
    for at, _ in shown:
        for axis in axes:
            axis.axvline(at, color=_GREY, linewidth=0.8, linestyle=":")
    for at, text in _labels(shown, 0.06 * (end - begin)):
        axes[0].annotate(
            text, (at, 1.0), xycoords=("data", "axes fraction"), fontsize=8,
            color="#495057", xytext=(2, 2), textcoords="offset points",
        )  # fmt: skip
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    return figure


def _labels(marks: Sequence[tuple[float, str]], room: float) -> list[tuple[float, str]]:
    """Marks that are nearer than the room that a word takes, joined to one."""
    labels: list[tuple[float, str]] = []
    last = -math.inf
    for at, text in marks:
        if at - last < room:
            labels[-1] = (labels[-1][0], f"{labels[-1][1]}, {text}")
        else:
            labels.append((at, text))
        last = at
    return labels


def _lines(
    axis: Axes, time: NDArray[np.float64], label: str, **values: NDArray[np.float64]
) -> None:
    looks = {"reference": (_ORANGE, 2.6), "drum": (_BLUE, 1.1)}
    for name, value in values.items():
        colour, width = looks[name]
        axis.plot(time, value, color=colour, linewidth=width, label=name)
    axis.set_ylabel(label)
    axis.grid(visible=True, color="#e3e6ea", linewidth=0.8)
    axis.spines[["top", "right"]].set_visible(False)
    axis.margins(x=0.005)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def descent_drawings(record: WinchRecord) -> dict[str, Figure]:
    """The whole descent, its beginning, its stop at the bottom, and its end."""
    begun, bottom, rate = record.requests[0]
    top = record.requests[-1][1]
    turned = next(at for at, mode in record.modes if mode == WinchMode.HOLD and at > begun)
    end = float(record["time"][-1])
    title = f"{record['length'][0]:.3g} m to {bottom:g} m and back to {top:g} m at {rate:g} m/s"
    return {
        "descent": draw_descent(record, 0.0, end, title),
        "begin": draw_descent(record, begun - 0.5, begun + 6.0, "It starts"),
        "bottom": draw_descent(record, turned - 5.0, turned + 9.0, "It stops and turns back"),
        "top": draw_descent(record, end - 18.0, end, "It slows down before its end"),
    }


def metrics_of(record: WinchRecord) -> dict[str, float]:
    """What the descent is held to."""
    return {
        "Largest distance of the drum's length from its reference [m]": record.length_error(),
        "From an S-curve that does not wait for the drum [m]": record.distance_from_curve(),
        "Overshoot [m]": record.overshoot(),
        **{
            f"Tension ripple in steady payout, {direction}, RMS over mean": value
            for direction, value in record.ripple().items()
        },
    }


def render(
    drawings: Mapping[str, bytes],
    measured: Mapping[str, float],
    tally: Sequence[checks.Tally],
    seed: int,
    origin: str,
) -> str:
    """The page."""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{value:.4g}</td></tr>"
        for name, value in measured.items()
    )
    pictures = "".join(
        f'<p><img alt="{name}" src="data:image/png;base64,{base64.b64encode(data).decode()}"></p>'
        for name, data in drawings.items()
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Winch</title>'
        f"<style>{_STYLE}</style></head><body><main><h1>The winch of mother_rover</h1>"
        f"<h2>Descent</h2><p>{html.escape(origin)}</p>"
        f"<table><tr><th>measured</th><th></th></tr>{rows}</table>"
        f"{pictures}{_tally_table(tally, seed)}</main></body></html>\n"
    )


def _tally_table(tally: Sequence[checks.Tally], seed: int) -> str:
    if not tally:
        return ""
    head = (
        "descents with ...", "descents", "hard stops", "touches of the wall", "snags",
        "touchdown missed", "false", "snag missed", "false", "slack false",
    )  # fmt: skip
    body = ""
    for line in tally:
        counts = (line.descents, line.hard_stops, line.touches, line.snags)
        wrong = (
            line.touchdowns_missed, line.touchdowns_false, line.snags_missed, line.snags_false,
            line.slack_false,
        )  # fmt: skip
        body += f"<tr><td>{html.escape(line.name)}</td>"
        body += "".join(f"<td>{count}</td>" for count in counts)
        body += "".join(f"<td{' class=wrong' * bool(n)}>{n}</td>" for n in wrong) + "</tr>"
    return (
        f"<h2>Load monitoring</h2><p>Descents drawn at random (seed {seed}) in legs of "
        "lowering and raising, ended smoothly or by a hard stop, along a wall, sometimes caught "
        "under a lip, in the end at 0.1 m/s to the floor. The winch knows neither payload nor "
        "friction nor its load cell's errors. Each line counts the descents that had to bear what "
        "it names; every descent ends in one touchdown.</p><table><tr>"
        + "".join(f"<th>{name}</th>" for name in head)
        + f"</tr>{body}</table>"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Report how the winch follows its setpoints and detects its load: the descent of the "
        "requirements to 45 m and back, and descents drawn at random, as one page with plots."
    )
    parser.epilog = "Exit codes: 0 reported, 1 no descent, 2 the folder cannot be written."
    add = parser.add_argument
    add("--runs", type=whole_number(0), default=20, metavar="N",
        help="number of random descents, 0 = none (default: %(default)d)")  # fmt: skip
    add("--seed", type=seed, default=1, metavar="N", help="random seed (default: %(default)d)")
    add("--out", type=Path, default=Path("out/winch"), metavar="DIR",
        help="folder of the report (default: %(default)s)")  # fmt: skip
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--nodes",
        action="store_true",
        help="run the descent with the nodes in lockstep, and record it",
    )
    source.add_argument("--bag", type=Path, help="report a recorded descent")


def run(options: argparse.Namespace) -> int:
    """Simulate, draw and write; return 1 without a descent, 2 if the folder cannot be written."""
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        options.usage_error(f"--out {options.out}: cannot be written: {error.strerror}")
    try:
        record, origin = _record(options)
    except (BagError, RuntimeError) as error:
        print(f"mother_rover winch report: {error}", file=sys.stderr)
        return 1
    pictures = {name: _png(figure) for name, figure in descent_drawings(record).items()}
    measured = metrics_of(record)
    print(origin)
    for name, value in measured.items():
        print(f"{name}: {value:.4g}")
    with tqdm(total=options.runs, unit="descent", leave=False, disable=not options.runs) as bar:

        def progress(done: int, _total: int) -> None:
            bar.n = done
            bar.refresh()

        batch = CheckBatch(options.runs, options.seed, options.out, progress)
        tally = checks.tally(checks.trials(batch)) if options.runs else []
    for name, data in pictures.items():
        (options.out / f"{name}.png").write_bytes(data)
    content = {
        "seed": options.seed,
        "origin": origin,
        "descent": measured,
        "judgement": [line._asdict() for line in tally],
    }
    (options.out / "winch.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    page = options.out / "index.html"
    text = render(pictures, measured, tally, options.seed, origin)
    page.write_text(text, encoding="utf-8")
    if tally:
        print(f"Load monitoring, seed {options.seed}:")
        print(checks.as_table(tally))
    print(f"Written: {page}")
    return 0


def _record(options: argparse.Namespace) -> tuple[WinchRecord, str]:
    """The descent that is reported, and where it comes from."""
    if options.bag is not None:
        record, _ = record_of_bag(options.bag)
        return record, f"The descent in {options.bag}."
    if options.nodes:
        recorded = winch_bag.recorded_descent(options.out, options.seed)
        return recorded.record, f"The nodes' descent: {recorded}."
    return checks.descent(options.seed), f"The winch's node in one process, seed {options.seed}."
